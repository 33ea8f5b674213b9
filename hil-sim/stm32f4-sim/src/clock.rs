//! A running clock: exact conversion between [`SimTime`] and its edges.

use crate::time::{SimTime, UNITS_PER_SECOND};

/// A frequency in hertz (of board time) as an exact fraction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rate {
    num: u64,
    den: u64,
}

impl Rate {
    /// `num / den` hertz, reduced. `den` of zero counts as one.
    #[must_use]
    pub fn new(num: u64, den: u64) -> Self {
        let den = den.max(1);
        let g = gcd(num, den).max(1);
        Self {
            num: num / g,
            den: den / g,
        }
    }

    /// A whole number of hertz.
    #[must_use]
    pub fn hz(hz: u64) -> Self {
        Self::new(hz, 1)
    }

    /// This rate times `mul / div`.
    #[must_use]
    pub fn scaled(self, mul: u64, div: u64) -> Self {
        let g1 = gcd(mul, self.den).max(1);
        let g2 = gcd(self.num, div).max(1);
        Self::new(
            (self.num / g2).saturating_mul(mul / g1),
            (self.den / g1).saturating_mul(div / g2),
        )
    }

    /// Numerator and denominator of the rate in hertz.
    #[must_use]
    pub const fn fraction(self) -> (u64, u64) {
        (self.num, self.den)
    }

    /// The rate in hertz, rounded to the nearest whole one.
    #[must_use]
    pub const fn hz_rounded(self) -> u64 {
        (self.num + self.den / 2) / self.den
    }

    /// True if the clock stands still.
    #[must_use]
    pub const fn is_zero(self) -> bool {
        self.num == 0
    }
}

/// Greatest common divisor.
fn gcd(mut a: u64, mut b: u64) -> u64 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

/// A clock of a given rate, counted from an anchor.
///
/// Edge number `anchor_edge` falls exactly on `anchor_time`; edge `k` after it
/// falls on the first unit of time that is not before `k` periods. Both
/// directions are exact integer arithmetic, so `edge_at(time_of(n)) == n`.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    anchor_time: u64,
    anchor_edge: u64,
    /// Period in units as a reduced fraction; `period_num == 0` is a stopped clock.
    period_num: u64,
    period_den: u64,
}

impl Clock {
    /// A clock of `rate` whose edge `edge` falls on `at`.
    #[must_use]
    pub fn new(rate: Rate, at: SimTime, edge: u64) -> Self {
        let (num, den) = rate.fraction();
        if num == 0 {
            return Self {
                anchor_time: at.units(),
                anchor_edge: edge,
                period_num: 0,
                period_den: 1,
            };
        }
        let g = gcd(UNITS_PER_SECOND, num).max(1);
        let (mut pn, mut pd) = (UNITS_PER_SECOND / g, num / g);
        let g = gcd(den, pd).max(1);
        pn = pn.saturating_mul(den / g);
        pd /= g;
        Self {
            anchor_time: at.units(),
            anchor_edge: edge,
            period_num: pn,
            period_den: pd,
        }
    }

    /// Number of the last edge at or before `t`; the anchor's for earlier times.
    #[inline]
    #[must_use]
    pub fn edge_at(&self, t: SimTime) -> u64 {
        let dt = t.units().saturating_sub(self.anchor_time);
        if self.period_num == 0 {
            self.anchor_edge
        } else if self.period_den == 1 {
            self.anchor_edge.wrapping_add(dt / self.period_num)
        } else {
            let n = u128::from(dt) * u128::from(self.period_den) / u128::from(self.period_num);
            self.anchor_edge.wrapping_add(n as u64)
        }
    }

    /// Time of edge number `edge`; the anchor's for earlier edges and
    /// [`SimTime::NEVER`] for a stopped clock.
    #[inline]
    #[must_use]
    pub fn time_of(&self, edge: u64) -> SimTime {
        let n = edge.saturating_sub(self.anchor_edge);
        if n == 0 {
            return SimTime::from_units(self.anchor_time);
        }
        if self.period_num == 0 {
            return SimTime::NEVER;
        }
        if self.period_den == 1 {
            return match n.checked_mul(self.period_num) {
                Some(dt) => SimTime::from_units(self.anchor_time.saturating_add(dt)),
                None => SimTime::NEVER,
            };
        }
        let dt =
            (u128::from(n) * u128::from(self.period_num)).div_ceil(u128::from(self.period_den));
        u64::try_from(dt).map_or(SimTime::NEVER, |dt| {
            SimTime::from_units(self.anchor_time.saturating_add(dt))
        })
    }

    /// True if the clock stands still.
    #[inline]
    #[must_use]
    pub fn is_stopped(&self) -> bool {
        self.period_num == 0
    }

    /// The same edge count going on at another rate from `at` on.
    #[must_use]
    pub(crate) fn re_rated(&self, rate: Rate, at: SimTime) -> Self {
        let edge = self.edge_at(at);
        Self::new(rate, at, edge)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_and_times_agree_for_even_and_odd_rates() {
        for rate in [
            Rate::hz(96_000_000),
            Rate::hz(97_000_000),
            Rate::new(8_000_000 * 433, 7 * 6),
            Rate::hz(32_000),
        ] {
            let c = Clock::new(rate, SimTime::from_nanos(12_345), 7);
            for n in [7u64, 8, 9, 1000, 123_456_789, 1_000_000_000] {
                let t = c.time_of(n);
                assert_eq!(c.edge_at(t), n, "{rate:?}");
                if n > 7 {
                    assert_eq!(c.edge_at(SimTime::from_units(t.units() - 1)), n - 1);
                }
            }
        }
    }

    #[test]
    fn a_change_of_rate_keeps_the_count() {
        let c = Clock::new(Rate::hz(1_000_000), SimTime::ZERO, 0);
        let at = SimTime::from_nanos(10_000);
        let d = c.re_rated(Rate::hz(2_000_000), at);
        assert_eq!(d.edge_at(at), 10);
        assert_eq!(d.edge_at(SimTime::from_nanos(11_000)), 12);
    }

    #[test]
    fn a_stopped_clock_has_no_next_edge() {
        let c = Clock::new(Rate::hz(0), SimTime::from_nanos(5), 3);
        assert_eq!(c.edge_at(SimTime::from_nanos(500)), 3);
        assert_eq!(c.time_of(4), SimTime::NEVER);
    }
}
