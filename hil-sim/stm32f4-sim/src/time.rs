//! Virtual time of the simulated board.
//!
//! All of the board's time is counted by its crystal: a second of [`SimTime`] is as
//! many periods of it as its frequency says, independent of a true second. How fast it
//! runs against true time is decided where the board is wired up, so no rounding
//! of a rate error can ever reach the board's clocks. The internal oscillator runs
//! exactly at its nominal rate in that time.
//!
//! The unit is 1/66,528,000,000,000 s (about 15 fs). It is chosen so that
//! every clock that matters is a whole number of units: crystals of 8, 16 and 25 MHz, 96 and
//! 168 MHz core clocks, the 48 MHz timers, 19.2 MHz, the
//! 32 kHz low-speed oscillator, 90 kHz, one microsecond and one
//! nanosecond. A clock that is not (an odd PLL factor) is rounded per edge,
//! never cumulatively, because [`crate::clock::Clock`] counts from an anchor.
//! 64 bits hold 77 hours.

use core::fmt;
use core::ops::{Add, AddAssign, Sub};

/// Units of [`SimTime`] in one second: 2^14 · 3^3 · 5^9 · 7 · 11.
pub const UNITS_PER_SECOND: u64 = 66_528_000_000_000;

/// Units of [`SimTime`] in one nanosecond.
pub const UNITS_PER_NANO: u64 = UNITS_PER_SECOND / 1_000_000_000;

/// A point in the board's virtual time, counted from power-on.
#[derive(
    Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, serde::Serialize, serde::Deserialize,
)]
pub struct SimTime(u64);

/// A length of the board's virtual time.
#[derive(
    Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, serde::Serialize, serde::Deserialize,
)]
pub struct SimDuration(u64);

impl SimTime {
    /// Power-on.
    pub const ZERO: SimTime = SimTime(0);
    /// Later than anything that happens.
    pub const NEVER: SimTime = SimTime(u64::MAX);

    /// The time `units` after power-on (see [`UNITS_PER_SECOND`]).
    #[must_use]
    pub const fn from_units(units: u64) -> Self {
        Self(units)
    }

    /// Units since power-on (see [`UNITS_PER_SECOND`]).
    #[must_use]
    pub const fn units(self) -> u64 {
        self.0
    }

    /// The time `nanos` after power-on; exact. Saturates after 77 hours.
    #[must_use]
    pub const fn from_nanos(nanos: u64) -> Self {
        Self(nanos.saturating_mul(UNITS_PER_NANO))
    }

    /// Whole nanoseconds since power-on, rounded down.
    #[must_use]
    pub const fn as_nanos(self) -> u64 {
        self.0 / UNITS_PER_NANO
    }

    /// Whole microseconds since power-on, rounded down.
    #[must_use]
    pub const fn as_micros(self) -> u64 {
        self.0 / (UNITS_PER_NANO * 1000)
    }

    /// Seconds since power-on, for display and plots only.
    #[must_use]
    pub fn as_secs_f64(self) -> f64 {
        self.0 as f64 / UNITS_PER_SECOND as f64
    }

    /// Time passed since `earlier`; zero if `earlier` is later.
    #[must_use]
    pub const fn since(self, earlier: SimTime) -> SimDuration {
        SimDuration(self.0.saturating_sub(earlier.0))
    }

    /// This time plus `d`, or [`SimTime::NEVER`].
    #[must_use]
    pub const fn saturating_add(self, d: SimDuration) -> Self {
        Self(self.0.saturating_add(d.0))
    }
}

impl SimDuration {
    /// No time at all.
    pub const ZERO: SimDuration = SimDuration(0);
    /// Longer than any run.
    pub const MAX: SimDuration = SimDuration(u64::MAX);

    /// `units` of time (see [`UNITS_PER_SECOND`]).
    #[must_use]
    pub const fn from_units(units: u64) -> Self {
        Self(units)
    }

    /// Length in units (see [`UNITS_PER_SECOND`]).
    #[must_use]
    pub const fn units(self) -> u64 {
        self.0
    }

    /// `nanos` nanoseconds; exact. Saturates after 77 hours.
    #[must_use]
    pub const fn from_nanos(nanos: u64) -> Self {
        Self(nanos.saturating_mul(UNITS_PER_NANO))
    }

    /// `micros` microseconds; exact.
    #[must_use]
    pub const fn from_micros(micros: u64) -> Self {
        Self::from_nanos(micros.saturating_mul(1_000))
    }

    /// `millis` milliseconds; exact.
    #[must_use]
    pub const fn from_millis(millis: u64) -> Self {
        Self::from_nanos(millis.saturating_mul(1_000_000))
    }

    /// `secs` seconds; exact.
    #[must_use]
    pub const fn from_secs(secs: u64) -> Self {
        Self::from_nanos(secs.saturating_mul(1_000_000_000))
    }

    /// `seconds` rounded down to a unit; for command lines and noise models.
    /// Negative and not-a-number count as zero.
    #[must_use]
    pub fn from_secs_f64(seconds: f64) -> Self {
        // `as` saturates and maps NaN to zero.
        Self((seconds * UNITS_PER_SECOND as f64) as u64)
    }

    /// Whole nanoseconds, rounded down.
    #[must_use]
    pub const fn as_nanos(self) -> u64 {
        self.0 / UNITS_PER_NANO
    }

    /// Seconds, for display and plots only.
    #[must_use]
    pub fn as_secs_f64(self) -> f64 {
        self.0 as f64 / UNITS_PER_SECOND as f64
    }

    /// `self` times `n`, saturating.
    #[must_use]
    pub const fn saturating_mul(self, n: u64) -> Self {
        Self(self.0.saturating_mul(n))
    }
}

impl Add<SimDuration> for SimTime {
    type Output = SimTime;
    fn add(self, d: SimDuration) -> SimTime {
        self.saturating_add(d)
    }
}

impl AddAssign<SimDuration> for SimTime {
    fn add_assign(&mut self, d: SimDuration) {
        *self = *self + d;
    }
}

impl Sub<SimTime> for SimTime {
    type Output = SimDuration;
    /// Zero if `earlier` is later, like [`SimTime::since`].
    fn sub(self, earlier: SimTime) -> SimDuration {
        self.since(earlier)
    }
}

impl Add for SimDuration {
    type Output = SimDuration;
    fn add(self, other: SimDuration) -> SimDuration {
        SimDuration(self.0.saturating_add(other.0))
    }
}

impl fmt::Display for SimTime {
    /// Seconds with six digits, as log lines show them.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let micros = self.as_micros();
        write!(f, "{}.{:06}", micros / 1_000_000, micros % 1_000_000)
    }
}

impl fmt::Debug for SimTime {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self} s ({} units)", self.0)
    }
}

impl fmt::Debug for SimDuration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ns ({} units)", self.as_nanos(), self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_clocks_that_matter_are_whole_units() {
        let mhz = [8, 16, 24, 25, 48, 96, 168, 192, 1_000].map(|mhz| 1_000_000 * mhz);
        for hz in mhz.into_iter().chain([19_200_000, 90_000, 32_000]) {
            assert_eq!(UNITS_PER_SECOND % hz, 0, "{hz} Hz");
        }
    }

    #[test]
    fn nanoseconds_are_exact() {
        let t = SimTime::from_nanos(1_234_567_890);
        assert_eq!(t.as_nanos(), 1_234_567_890);
        assert_eq!(t.to_string(), "1.234567");
        assert_eq!(
            t + SimDuration::from_micros(1) - t,
            SimDuration::from_nanos(1000)
        );
    }
}
