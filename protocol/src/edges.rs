//! Exact times of trigger edges.
//!
//! The hardware makes an edge at a whole tick, but a train's [`Period`] has a fraction of a
//! tick. Every edge therefore has an exact [`EdgeTime`], of which the hardware makes the floor.
//! Edge `k` of an [`EdgeGrid`] is `anchor + k · period` without rounding, so a train has at
//! most one tick of jitter and never drifts.

use core::fmt;
use core::ops::Add;

use serde::{Deserialize, Serialize};

use crate::units::{TICK_HZ, TickDelta, Ticks};

/// Fraction bits of [`Period`] and [`EdgeTime`].
const FRACTION_BITS: u32 = 32;

/// 2⁻³² ticks in a tick.
const PER_TICK: f64 = (1_u64 << FRACTION_BITS) as f64;

/// A period in ticks with 32 fraction bits (Q32.32): resolution 4.9 attoseconds.
///
/// The raw value is `ticks · 2³²`.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Period(pub u64);

impl Period {
    /// The shortest period that the board accepts: 1 ms.
    pub const MIN: Self = Self::from_ticks(TICK_HZ / 1_000);
    /// The longest period that the board accepts: 1 s.
    pub const MAX: Self = Self::from_ticks(TICK_HZ);

    /// Creates a period of whole ticks.
    #[must_use]
    pub const fn from_ticks(ticks: u32) -> Self {
        Self((ticks as u64) << FRACTION_BITS)
    }

    /// Creates a period from a number of ticks, rounded to the nearest 2⁻³² ticks.
    ///
    /// Saturates at 0 and below 2³² ticks; not a number becomes 0.
    #[must_use]
    pub fn from_ticks_f64(ticks: f64) -> Self {
        let raw = ticks * PER_TICK;
        let floor = raw as u64;
        let is_above_half = raw - floor as f64 >= 0.5;
        Self(floor.saturating_add(is_above_half.into()))
    }

    /// Creates a period from picoseconds, rounded to the nearest 2⁻³² ticks.
    ///
    /// Returns `None` if it does not fit (2³² ticks, 89 s). Integer arithmetic only:
    /// `raw = ps · 48·10⁶ · 2³² / 10¹² = ps · 6 · 2³² / 125,000`.
    #[must_use]
    pub const fn from_picos(picos: u64) -> Option<Self> {
        let raw = ((picos as u128 * 6) << FRACTION_BITS) + 62_500;
        let raw = raw / 125_000;
        if raw > u64::MAX as u128 {
            None
        } else {
            Some(Self(raw as u64))
        }
    }

    /// Returns the whole ticks of the period.
    #[must_use]
    pub const fn ticks(self) -> u32 {
        (self.0 >> FRACTION_BITS) as u32
    }

    /// Returns the fraction of a tick, in 2⁻³² ticks.
    #[must_use]
    pub const fn fraction(self) -> u32 {
        self.0 as u32
    }

    /// Returns the period in ticks, as near as a double comes: exact up to 2²¹ ticks.
    #[must_use]
    pub fn as_ticks_f64(self) -> f64 {
        self.0 as f64 / PER_TICK
    }

    /// Returns the period in seconds, for display and fits.
    #[must_use]
    pub fn as_secs_f64(self) -> f64 {
        self.as_ticks_f64() / f64::from(TICK_HZ)
    }

    /// Returns true if the board accepts the period: [`Period::MIN`] to [`Period::MAX`].
    #[must_use]
    pub const fn in_bounds(self) -> bool {
        self.0 >= Self::MIN.0 && self.0 <= Self::MAX.0
    }
}

impl fmt::Display for Period {
    /// Nanoseconds with picosecond digits: `33330652.540 ns`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let picos = (u128::from(self.0) * 125_000 / 6 + (1 << 31)) >> FRACTION_BITS;
        write!(f, "{}.{:03} ns", picos / 1000, picos % 1000)
    }
}

/// The exact time of an edge, in ticks with 32 fraction bits (Q64.32).
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct EdgeTime {
    /// The tick at which the hardware makes the edge: the floor of its time.
    pub ticks: Ticks,
    /// Time from the start of that tick, in 2⁻³² ticks.
    pub fraction: u32,
}

impl EdgeTime {
    /// Returns the start of a tick.
    #[must_use]
    pub const fn from_ticks(ticks: Ticks) -> Self {
        Self { ticks, fraction: 0 }
    }

    /// Creates a time from 2⁻³² ticks since reset, saturating at reset and at 2⁶⁴ ticks.
    #[must_use]
    pub const fn from_raw(raw: i128) -> Self {
        let max = (1_i128 << 96) - 1;
        let raw = if raw < 0 {
            0
        } else if raw > max {
            max
        } else {
            raw
        };
        Self {
            ticks: Ticks((raw >> FRACTION_BITS) as u64),
            fraction: raw as u32,
        }
    }

    /// Returns the time since reset in 2⁻³² ticks: from 0 to 2⁹⁶ − 1.
    #[must_use]
    pub const fn raw(self) -> i128 {
        ((self.ticks.0 as i128) << FRACTION_BITS) | self.fraction as i128
    }

    /// Returns the seconds since reset, for display and for math relative to a near reference.
    #[must_use]
    pub fn as_secs_f64(self) -> f64 {
        self.raw() as f64 / PER_TICK / f64::from(TICK_HZ)
    }
}

impl From<Ticks> for EdgeTime {
    fn from(ticks: Ticks) -> Self {
        Self::from_ticks(ticks)
    }
}

impl Add<Period> for EdgeTime {
    type Output = Self;

    fn add(self, period: Period) -> Self {
        Self::from_raw(self.raw() + i128::from(period.0))
    }
}

/// An endless grid of edges at one period.
///
/// It reaches to both sides of its anchor. Edges before reset and beyond 64 bits of ticks count
/// for [`EdgeGrid::phase_error`] and [`EdgeGrid::since_edge`], as if there were such times.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct EdgeGrid {
    /// Edge 0.
    pub anchor: EdgeTime,
    /// Distance of the edges.
    pub period: Period,
}

impl EdgeGrid {
    /// Creates the grid with an edge at `anchor`.
    #[must_use]
    pub fn new(anchor: impl Into<EdgeTime>, period: Period) -> Self {
        Self {
            anchor: anchor.into(),
            period,
        }
    }

    /// Returns edge `k`, saturating at reset and at 2⁶⁴ ticks.
    #[must_use]
    pub fn edge(&self, k: i64) -> EdgeTime {
        // |k · period| < 2¹²⁷ and the anchor < 2⁹⁶: the sum fits in i128 except at the very
        // ends of k, where saturation gives the same result.
        let offset = i128::from(k).saturating_mul(self.period.0.into());
        EdgeTime::from_raw(self.anchor.raw().saturating_add(offset))
    }

    /// Returns the first edge at or after `at` that is not before the anchor, with its number
    /// from the anchor.
    #[must_use]
    pub fn first_from(&self, at: impl Into<EdgeTime>) -> (u64, EdgeTime) {
        let ahead = (at.into().raw() - self.anchor.raw()).max(0).unsigned_abs();
        let count = ahead.div_ceil(u128::from(self.period.0.max(1)));
        let count = i64::try_from(count).unwrap_or(i64::MAX);
        (count.unsigned_abs(), self.edge(count))
    }

    /// Returns the time from the last edge at or before `at`, in 2⁻³² ticks; `None` if the
    /// period is 0.
    #[must_use]
    pub fn since_edge(&self, at: impl Into<EdgeTime>) -> Option<u64> {
        let apart = at.into().raw() - self.anchor.raw();
        let since = apart.checked_rem_euclid(self.period.0.into())?;
        // Less than the period.
        Some(since as u64)
    }

    /// Returns the distance of `at` from the tick of the nearest edge; late is positive.
    ///
    /// It is 0 for the tick of every [`EdgeGrid::edge`]; half way between two edges counts as
    /// late. Exact at any distance from the anchor. A grid of period 0 has one edge, the anchor.
    #[must_use]
    pub fn phase_error(&self, at: Ticks) -> TickDelta {
        let Some(since) = self.since_edge(at) else {
            return at - self.anchor.ticks;
        };
        // The last edge is made at the floor of `at − since`, the next one at that of
        // `at − since + period`.
        let late = (u128::from(since) + 0xFFFF_FFFF) >> FRACTION_BITS;
        let early = u128::from(self.period.0 - since) >> FRACTION_BITS;
        TickDelta(if late <= early {
            late as i64
        } else {
            -(early as i64)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_rates_are_whole_ticks() {
        assert_eq!(
            Period::from_picos(200_000_000_000),
            Some(Period::from_ticks(9_600_000))
        );
        assert_eq!(
            Period::from_picos(1_000_000_000),
            Some(Period::from_ticks(48_000))
        );
    }

    #[test]
    fn a_number_of_ticks_rounds_to_the_nearest_period() {
        let unit = PER_TICK.recip();
        for (ticks, raw) in [
            (-1.0, 0),
            (f64::NAN, 0),
            (0.499_999_999_999_999_94 * unit, 0),
            (0.5 * unit, 1),
            (1_600_000.0 + unit, (1_600_000 << 32) + 1),
            // From 2²⁰ ticks on a double has no halves.
            (((1_u64 << 52) + 1) as f64 * unit, (1 << 52) + 1),
            (PER_TICK, u64::MAX),
            (f64::INFINITY, u64::MAX),
        ] {
            assert_eq!(Period::from_ticks_f64(ticks), Period(raw), "{ticks}");
        }
        let period = Period((1_600_000 << 32) + 3);
        assert_eq!(Period::from_ticks_f64(period.as_ticks_f64()), period);
    }

    #[test]
    fn a_period_keeps_its_fraction_over_a_million_edges() {
        // 33,330,652.540 ns = 1,599,871.32192 ticks.
        let period = Period::from_picos(33_330_652_540).unwrap();
        assert_eq!(period.ticks(), 1_599_871);
        let exact = 1_599_871.321_92_f64 * 1e6;
        let edge = EdgeGrid::new(Ticks(0), period).edge(1_000_000).ticks;
        assert!((edge.0 as f64 - exact).abs() <= 1.0, "{edge}");
    }

    #[test]
    fn edges_go_backwards_by_floor_too() {
        let edge = |anchor, period, k| EdgeGrid::new(Ticks(anchor), Period(period)).edge(k).ticks;
        let half = (1 << 32) | (1 << 31);
        assert_eq!(edge(10, half, 1), Ticks(11));
        assert_eq!(edge(10, half, -1), Ticks(8));
        assert_eq!(edge(10, half, -100), Ticks(0));
        assert_eq!(edge(u64::MAX, u64::MAX, i64::MAX), Ticks(u64::MAX));
        assert_eq!(edge(0, u64::MAX, i64::MIN), Ticks(0));
    }

    #[test]
    fn any_period_and_any_instants_have_a_phase_error() {
        let last = Ticks(u64::MAX);
        let error = |anchor, period, at| EdgeGrid::new(anchor, period).phase_error(at);
        for period in [Period(0), Period(1), Period::MIN, Period(u64::MAX)] {
            assert_eq!(error(last, period, last), TickDelta::ZERO);
            for (anchor, at) in [(Ticks::ZERO, last), (last, Ticks::ZERO)] {
                let off = error(anchor, period, at).unsigned_abs();
                assert!(period == Period(0) || off <= u64::from(period.ticks()).div_ceil(2));
            }
        }
        assert_eq!(error(Ticks(7), Period(0), Ticks(5)), TickDelta(-2));
        // The edge at −90 is not an edge of the board's, and is not near either.
        let period = Period::from_ticks(100);
        assert_eq!(error(Ticks(10), period, Ticks(0)), TickDelta(-10));
    }
}
