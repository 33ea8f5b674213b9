//! Board time and its arithmetic.
//!
//! All times of the board are ticks of one 48 MHz timer (TIM2), extended to
//! 64 bits. An instant ([`Ticks`]) and a distance ([`TickDelta`]) are different
//! types, and neither is a number: adding two instants does not compile.
//! Times finer than a tick are in [`crate::edges`].
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

#[cfg(test)]
mod tests {
    use super::*;

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
