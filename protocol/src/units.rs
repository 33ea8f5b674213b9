//! Board time and its arithmetic.
//!
//! All times of the board are ticks of one 48 MHz timer (TIM2), extended to
//! 64 bits. An instant ([`Ticks`]) and a distance ([`TickDelta`]) are different
//! types, and neither is a number: adding two instants does not compile.
//! Periods are finer than a tick ([`Period`], Q32.32), so a train of edges is
//! the floor of an exact sum and never drifts from rounding.
//!
//! 64-bit ticks overflow after 12,000 years; the arithmetic saturates there
//! rather than wraps, so that no byte from a wire can make it panic.

use core::fmt;
use core::ops::{Add, Sub};

use serde::{Deserialize, Serialize};

/// Ticks in a second: the rate of TIM2 (APB1 timer clock, 2 × 24 MHz).
pub const TICK_HZ: u32 = 48_000_000;

/// An instant of board time: ticks of [`TICK_HZ`] since the board's reset.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Ticks(pub u64);

/// A signed distance between two instants of board time, in ticks.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TickDelta(pub i64);

impl Ticks {
    /// The instant of reset.
    pub const ZERO: Self = Self(0);

    /// `self + delta`, or `None` where the result is before reset or beyond 64 bits.
    #[must_use]
    pub const fn checked_add(self, delta: TickDelta) -> Option<Self> {
        match self.0.checked_add_signed(delta.0) {
            Some(ticks) => Some(Self(ticks)),
            None => None,
        }
    }

    /// Nanoseconds since reset, rounded to nearest: `ticks · 125 / 6`.
    ///
    /// Saturates at `u64::MAX`, which is reached after 584 years.
    #[must_use]
    pub const fn as_nanos(self) -> u64 {
        let nanos = (self.0 as u128 * 125 + 3) / 6;
        if nanos > u64::MAX as u128 {
            u64::MAX
        } else {
            nanos as u64
        }
    }

    /// Seconds since reset. For display and for math relative to a near
    /// reference; f64 holds single ticks up to six years.
    #[must_use]
    pub fn as_secs_f64(self) -> f64 {
        self.0 as f64 / f64::from(TICK_HZ)
    }
}

impl TickDelta {
    /// No distance.
    pub const ZERO: Self = Self(0);

    /// A distance of whole microseconds, 48 ticks each.
    #[must_use]
    pub const fn from_micros(micros: u32) -> Self {
        Self(micros as i64 * (TICK_HZ / 1_000_000) as i64)
    }

    /// Seconds, signed.
    #[must_use]
    pub fn as_secs_f64(self) -> f64 {
        self.0 as f64 / f64::from(TICK_HZ)
    }

    /// The distance without its sign, in ticks.
    #[must_use]
    pub const fn unsigned_abs(self) -> u64 {
        self.0.unsigned_abs()
    }
}

impl Add<TickDelta> for Ticks {
    type Output = Self;

    fn add(self, delta: TickDelta) -> Self {
        Self(self.0.saturating_add_signed(delta.0))
    }
}

impl Sub<TickDelta> for Ticks {
    type Output = Self;

    fn sub(self, delta: TickDelta) -> Self {
        Self(self.0.saturating_add_signed(delta.0.saturating_neg()))
    }
}

impl Sub for Ticks {
    type Output = TickDelta;

    fn sub(self, earlier: Self) -> TickDelta {
        let wide = i128::from(self.0) - i128::from(earlier.0);
        TickDelta(wide.clamp(i128::from(i64::MIN), i128::from(i64::MAX)) as i64)
    }
}

impl Add for TickDelta {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self(self.0.saturating_add(other.0))
    }
}

impl Sub for TickDelta {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        Self(self.0.saturating_sub(other.0))
    }
}

impl fmt::Display for Ticks {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ticks", self.0)
    }
}

impl fmt::Display for TickDelta {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:+} ticks", self.0)
    }
}

/// A period in ticks with 32 fraction bits (Q32.32): resolution 4.9 attoseconds.
///
/// The raw value is `ticks · 2³²`. Edge `k` of a train that starts at tick `s`
/// is [`Period::edge`]`(s, k)` = floor(s + k · period), computed exactly.
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

    /// A period of whole ticks.
    #[must_use]
    pub const fn from_ticks(ticks: u32) -> Self {
        Self((ticks as u64) << 32)
    }

    /// The period of `nanos` · 10⁻⁹ s given as picoseconds, rounded to nearest.
    ///
    /// `None` if it does not fit (2³² ticks, 89 s). Integer arithmetic only:
    /// `raw = ps · 48·10⁶ · 2³² / 10¹²  = ps · 6 · 2³² / 125,000`.
    #[must_use]
    pub const fn from_picos(picos: u64) -> Option<Self> {
        let raw = ((picos as u128 * 6) << 32) + 62_500;
        let raw = raw / 125_000;
        if raw > u64::MAX as u128 {
            None
        } else {
            Some(Self(raw as u64))
        }
    }

    /// The whole ticks of the period.
    #[must_use]
    pub const fn ticks(self) -> u32 {
        (self.0 >> 32) as u32
    }

    /// The fraction of a tick, in 2⁻³² ticks.
    #[must_use]
    pub const fn fraction(self) -> u32 {
        self.0 as u32
    }

    /// The period in seconds (display and fits; not for edges).
    #[must_use]
    pub fn as_secs_f64(self) -> f64 {
        self.0 as f64 / 4_294_967_296.0 / f64::from(TICK_HZ)
    }

    /// Whether the board accepts it: [`Period::MIN`] ..= [`Period::MAX`].
    #[must_use]
    pub const fn in_bounds(self) -> bool {
        self.0 >= Self::MIN.0 && self.0 <= Self::MAX.0
    }

    /// Edge `k` of the train through `start`: floor(start + k · period), for
    /// `k` of either sign. Saturates at tick 0 and at 2⁶⁴ − 1.
    #[must_use]
    pub fn edge(self, start: Ticks, k: i64) -> Ticks {
        // |k · period| < 2¹²⁷ and start · 2³² < 2⁹⁶: the sum fits in i128
        // except at the very ends of k, where saturation gives the same result.
        let offset = (k as i128).saturating_mul(self.0 as i128);
        let sum = ((start.0 as i128) << 32).saturating_add(offset);
        Ticks((sum >> 32).clamp(0, u64::MAX.into()) as u64)
    }

    /// How far `at` lies off the nearest edge of the train through `anchor`, in
    /// ticks; late is positive. 0 for every [`Period::edge`]`(anchor, k)`, of any
    /// `k`; half way between two edges counts as late.
    ///
    /// Exact at any distance from `anchor`. Edges before reset and beyond 64 bits
    /// count too. A train of period 0 has one edge, `anchor`.
    #[must_use]
    pub fn phase_error(self, anchor: Ticks, at: Ticks) -> TickDelta {
        self.phase_error_of(anchor, 0, at)
    }

    /// The same where an edge lies a fraction of a tick, in 2⁻³² ticks, after the start of
    /// tick `anchor`.
    #[must_use]
    pub fn phase_error_of(self, anchor: Ticks, fraction: u32, at: Ticks) -> TickDelta {
        let period = i128::from(self.0);
        let apart = ((i128::from(at.0) - i128::from(anchor.0)) << 32) - i128::from(fraction);
        let Some(beyond) = apart.checked_rem_euclid(period) else {
            return at - anchor;
        };
        // The last edge is the floor of `at − beyond`, the next one that of
        // `at − beyond + period`.
        let late = (beyond + 0xFFFF_FFFF) >> 32;
        let early = (period - beyond) >> 32;
        TickDelta(if late <= early { late } else { -early } as i64)
    }
}

impl fmt::Display for Period {
    /// Nanoseconds with picosecond digits: `33330652.540 ns`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let picos = (u128::from(self.0) * 125_000 / 6 + (1 << 31)) >> 32;
        write!(f, "{}.{:03} ns", picos / 1000, picos % 1000)
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
    fn a_period_keeps_its_fraction_over_a_million_edges() {
        // 33,330,652.540 ns = 1,599,871.32192 ticks.
        let period = Period::from_picos(33_330_652_540).unwrap();
        assert_eq!(period.ticks(), 1_599_871);
        let exact = 1_599_871.321_92_f64 * 1e6;
        let edge = period.edge(Ticks(0), 1_000_000);
        assert!((edge.0 as f64 - exact).abs() <= 1.0, "{edge}");
    }

    #[test]
    fn edges_go_backwards_by_floor_too() {
        let half = Period((1 << 32) | (1 << 31));
        assert_eq!(half.edge(Ticks(10), 1), Ticks(11));
        assert_eq!(half.edge(Ticks(10), -1), Ticks(8));
        assert_eq!(half.edge(Ticks(10), -100), Ticks(0));
        assert_eq!(
            Period(u64::MAX).edge(Ticks(u64::MAX), i64::MAX),
            Ticks(u64::MAX)
        );
        assert_eq!(Period(u64::MAX).edge(Ticks(0), i64::MIN), Ticks(0));
    }

    #[test]
    fn any_period_and_any_instants_have_a_phase_error() {
        let last = Ticks(u64::MAX);
        for period in [Period(0), Period(1), Period::MIN, Period(u64::MAX)] {
            assert_eq!(period.phase_error(last, last), TickDelta::ZERO);
            for (anchor, at) in [(Ticks::ZERO, last), (last, Ticks::ZERO)] {
                let off = period.phase_error(anchor, at).unsigned_abs();
                assert!(period == Period(0) || off <= u64::from(period.ticks()).div_ceil(2));
            }
        }
        assert_eq!(Period(0).phase_error(Ticks(7), Ticks(5)), TickDelta(-2));
        // The edge at −90 is no edge of the board's, and is not near either.
        let period = Period::from_ticks(100);
        assert_eq!(period.phase_error(Ticks(10), Ticks(0)), TickDelta(-10));
    }

    #[test]
    fn arithmetic_saturates_at_the_ends() {
        assert_eq!(Ticks(0) - TickDelta(1), Ticks(0));
        assert_eq!(Ticks(u64::MAX) + TickDelta(1), Ticks(u64::MAX));
        assert_eq!(Ticks(u64::MAX) - Ticks(0), TickDelta(i64::MAX));
        assert_eq!(Ticks(0) - Ticks(u64::MAX), TickDelta(i64::MIN));
    }

    #[test]
    fn microseconds_are_whole_ticks() {
        assert_eq!(
            TickDelta::from_micros(1_000_000),
            Ticks(TICK_HZ.into()) - Ticks::ZERO
        );
        assert_eq!(TickDelta::from_micros(u32::MAX), TickDelta(206_158_430_160));
    }

    #[test]
    fn nanoseconds_round_to_nearest() {
        assert_eq!(Ticks(1).as_nanos(), 21);
        assert_eq!(Ticks(48_000_000).as_nanos(), 1_000_000_000);
        assert_eq!(Ticks(u64::MAX).as_nanos(), u64::MAX);
    }
}
