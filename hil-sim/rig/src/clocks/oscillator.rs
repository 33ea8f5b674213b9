//! Free-running clocks of the rig against true time.
//!
//! [`TrueTime`] is the time of an ideal clock that no part of the rig has. An
//! [`Oscillator`] turns it into the time that one part of the rig counts: with
//! an offset, a rate error, and a frequency that wanders as a random walk.
//! [`BoardTime`] is the oscillator whose count *is* the board's
//! [`SimTime`]: the board's crystal is right by definition on the board, and
//! wrong against true time like every other.
//!
//! All conversions are exact integer arithmetic in units of 15 fs
//! ([`UNITS_PER_SECOND`]), monotonic and without accumulated rounding: the
//! frequency is constant within each second of true time, and the count at
//! every whole second is an integer. Going from a count to the true time gives
//! the *earliest* time at which the clock shows it, so
//! `elapsed_at(when_elapsed(n)) >= n` and one unit earlier it is less.
//!
//! The wander: after every second the fractional frequency takes a normal step
//! of the configured standard deviation (random-walk frequency modulation).
//! Its Allan deviation is `wander · sqrt(tau / 3)`; a plain quartz on a desk
//! was measured at about 1e-9 at 10 s and 2e-7 at 10,000 s (time-nuts list,
//! November 2015), which is a wander of 0.5e-9 to 3.5e-9 per square root of a
//! second. Limits: no white or flicker noise (its time error over a second
//! is picoseconds for any quartz).
//!
//! The warming ([`Warming`]): from power-on on the frequency moves to another one, fast at
//! first and then ever more slowly, as the temperature of a rig does.

use std::sync::{Arc, Mutex};

use serde::{Deserialize, Serialize};

use crate::random::Random;
use stm32f4_sim::clock::Rate;
use stm32f4_sim::shared::lock;
use stm32f4_sim::time::{SimTime, UNITS_PER_NANO, UNITS_PER_SECOND};

/// True time since power-on of the rig, in units of [`UNITS_PER_SECOND`].
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub struct TrueTime(u64);

impl TrueTime {
    /// Power-on of the rig.
    pub const ZERO: TrueTime = TrueTime(0);
    /// Later than anything that happens.
    pub const NEVER: TrueTime = TrueTime(u64::MAX);

    /// The time `units` after power-on.
    #[must_use]
    pub const fn from_units(units: u64) -> Self {
        Self(units)
    }

    /// Units since power-on.
    #[must_use]
    pub const fn units(self) -> u64 {
        self.0
    }

    /// `nanos` after power-on; exact. Saturates after 77 hours.
    #[must_use]
    pub const fn from_nanos(nanos: u64) -> Self {
        Self(nanos.saturating_mul(UNITS_PER_NANO))
    }

    /// Whole nanoseconds, rounded down.
    #[must_use]
    pub const fn as_nanos(self) -> u64 {
        self.0 / UNITS_PER_NANO
    }

    /// Seconds; good to 60 ps after 77 hours. For motion and display.
    #[must_use]
    pub fn as_secs_f64(self) -> f64 {
        self.0 as f64 / UNITS_PER_SECOND as f64
    }
}

/// Behaviour of an oscillator.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OscillatorConfig {
    /// Reading of the clock at power-on of the rig, in its nanoseconds.
    pub offset_ns: i64,
    /// Fractional frequency error at power-on, in parts per million. Positive
    /// runs fast. Held within ±100,000.
    pub rate_ppm: f64,
    /// Standard deviation of the fractional frequency's change in one second
    /// (not in ppm). 0 is a constant rate.
    pub wander: f64,
    /// Change of the frequency as the rig warms up.
    pub warming: Warming,
}

/// Change of a frequency after power-on, as its crystal warms up: exponential.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Warming {
    /// Change of the fractional frequency in the first ten minutes, in parts per million.
    pub ppm: f64,
    /// Time constant, in seconds.
    pub time_s: f64,
    /// Change by a step of the temperature, in parts per million.
    pub step_ppm: f64,
    /// When the temperature steps, in seconds after power-on.
    pub step_at_s: f64,
    /// Time constant with which the crystal follows, in seconds.
    pub step_time_s: f64,
}

impl Warming {
    /// The time in which the frequency changes by [`Warming::ppm`], in seconds.
    pub const SPAN_S: f64 = 600.0;

    /// Returns the fractional frequency at a time after power-on, in seconds, less that at power-on.
    fn fraction(&self, since_s: f64) -> f64 {
        let share = |time_s: f64| -libm::expm1(-time_s / self.time_s);
        let step = -libm::expm1(-(since_s - self.step_at_s).max(0.0) / self.step_time_s);
        let fraction = self.ppm * 1e-6 * share(since_s) / share(Self::SPAN_S);
        let fraction = fraction + self.step_ppm * 1e-6 * step;
        if fraction.is_finite() { fraction } else { 0.0 }
    }
}

impl Default for Warming {
    /// None.
    fn default() -> Self {
        Self {
            ppm: 0.0,
            time_s: Self::SPAN_S,
            step_ppm: 0.0,
            step_at_s: 150.0,
            step_time_s: 30.0,
        }
    }
}

/// Largest fractional frequency error: ten percent.
const MAX_FRACTION: f64 = 0.1;

/// A free-running clock. Clones share the same wander.
#[derive(Clone, Debug)]
pub struct Oscillator {
    config: OscillatorConfig,
    track: Arc<Mutex<Track>>,
}

/// The part of a clock's history that was needed so far.
#[derive(Debug)]
struct Track {
    /// Elapsed local units at each whole second of true time; at least two entries.
    at_second: Vec<u64>,
    /// Fractional frequency in the last second of `at_second`, but for the warming.
    fraction: f64,
    wander: f64,
    warming: Warming,
    random: Random,
}

impl Track {
    fn extend(&mut self) {
        if self.wander > 0.0 && self.at_second.len() > 1 {
            self.fraction += self.wander * self.random.normal();
            self.fraction = self.fraction.clamp(-MAX_FRACTION, MAX_FRACTION);
        }
        // In the middle of the second.
        let warmed = self.warming.fraction(self.at_second.len() as f64 - 0.5);
        let fraction = (self.fraction + warmed).clamp(-MAX_FRACTION, MAX_FRACTION);
        let excess = (fraction * UNITS_PER_SECOND as f64).round() as i64;
        let length = UNITS_PER_SECOND.saturating_add_signed(excess);
        let last = self.at_second.last().copied().unwrap_or(0);
        self.at_second.push(last.saturating_add(length));
    }

    /// Local units at the beginning and length of second `k`.
    fn second(&mut self, k: usize) -> (u64, u64) {
        while self.at_second.len() < k + 2 {
            self.extend();
        }
        let base = self.at_second[k];
        (base, self.at_second[k + 1] - base)
    }

    /// The second in which the clock reaches `local`.
    fn find(&mut self, local: u64) -> usize {
        while self.at_second.last().is_none_or(|&last| last <= local) {
            self.extend();
        }
        self.at_second.partition_point(|&at| at <= local) - 1
    }
}

/// Longest time that is converted: 70 hours. Bounds the history's memory.
const HORIZON: u64 = 70 * 3600 * UNITS_PER_SECOND;

impl Oscillator {
    /// An oscillator of the given kind; its wander is drawn from `random`.
    #[must_use]
    pub fn new(config: OscillatorConfig, random: Random) -> Self {
        Self {
            config,
            track: Arc::new(Mutex::new(Track {
                at_second: vec![0],
                fraction: config.rate_ppm * 1e-6,
                wander: config.wander,
                warming: config.warming,
                random,
            })),
        }
    }

    /// Its configuration.
    #[must_use]
    pub fn config(&self) -> OscillatorConfig {
        self.config
    }

    /// Units that the clock has counted at `at` since power-on, without its offset.
    /// The count stands still after 70 hours of true time.
    #[must_use]
    pub fn elapsed_at(&self, at: TrueTime) -> u64 {
        let at = at.0.min(HORIZON);
        let (second, within) = (at / UNITS_PER_SECOND, at % UNITS_PER_SECOND);
        let (base, length) = lock(&self.track).second(second as usize);
        let part = u128::from(within) * u128::from(length) / u128::from(UNITS_PER_SECOND);
        base + part as u64
    }

    /// The earliest true time at which [`Oscillator::elapsed_at`] is `local` or more;
    /// [`TrueTime::NEVER`] after 63 hours.
    #[must_use]
    pub fn when_elapsed(&self, local: u64) -> TrueTime {
        // At 10 % slow, this many units are still within the horizon.
        if local > HORIZON / 10 * 9 {
            return TrueTime::NEVER;
        }
        let mut track = lock(&self.track);
        let second = track.find(local);
        let (base, length) = track.second(second);
        let part =
            (u128::from(local - base) * u128::from(UNITS_PER_SECOND)).div_ceil(u128::from(length));
        TrueTime(second as u64 * UNITS_PER_SECOND + part as u64)
    }

    /// Reading of the clock at `at`, in its own whole nanoseconds (rounded
    /// down), with its offset.
    #[must_use]
    pub fn nanos_at(&self, at: TrueTime) -> i64 {
        let elapsed = self.elapsed_at(at) / UNITS_PER_NANO;
        self.config.offset_ns.saturating_add_unsigned(elapsed)
    }

    /// The earliest true time at which the clock reads `nanos`; `None` if it
    /// did so before power-on.
    #[must_use]
    pub fn when_nanos(&self, nanos: i64) -> Option<TrueTime> {
        let elapsed = u64::try_from(i128::from(nanos) - i128::from(self.config.offset_ns)).ok()?;
        Some(self.when_elapsed(elapsed.saturating_mul(UNITS_PER_NANO)))
    }

    /// Whole ticks of a counter of `rate` hertz (of this clock's seconds) at `at`.
    /// It counts from zero at power-on.
    #[must_use]
    pub fn ticks_at(&self, at: TrueTime, rate: Rate) -> u64 {
        let (num, den) = rate.fraction();
        let ticks = u128::from(self.elapsed_at(at)) * u128::from(num)
            / (u128::from(UNITS_PER_SECOND) * u128::from(den));
        u64::try_from(ticks).unwrap_or(u64::MAX)
    }

    /// The earliest true time at which [`Oscillator::ticks_at`] is `ticks`.
    #[must_use]
    pub(crate) fn when_ticks(&self, ticks: u64, rate: Rate) -> TrueTime {
        let (num, den) = rate.fraction();
        if num == 0 {
            return TrueTime::NEVER;
        }
        let local = u128::from(ticks)
            .saturating_mul(u128::from(UNITS_PER_SECOND) * u128::from(den))
            .div_ceil(u128::from(num));
        u64::try_from(local).map_or(TrueTime::NEVER, |local| self.when_elapsed(local))
    }

    /// Fractional frequency error in the second that contains `at`.
    #[must_use]
    pub fn fraction_at(&self, at: TrueTime) -> f64 {
        let second = at.0.min(HORIZON) / UNITS_PER_SECOND;
        let (_, length) = lock(&self.track).second(second as usize);
        length as f64 / UNITS_PER_SECOND as f64 - 1.0
    }
}

/// The board's crystal: the relation between [`SimTime`] and [`TrueTime`].
#[derive(Clone, Debug)]
pub struct BoardTime(Oscillator);

impl BoardTime {
    /// A board whose crystal behaves as `config` says; its offset is not used
    /// ([`SimTime`] is zero at power-on).
    #[must_use]
    pub fn new(config: OscillatorConfig, random: Random) -> Self {
        let config = OscillatorConfig {
            offset_ns: 0,
            ..config
        };
        Self(Oscillator::new(config, random))
    }

    /// The board's time at a true time, rounded down to a unit.
    #[must_use]
    pub fn board_at(&self, at: TrueTime) -> SimTime {
        if at == TrueTime::NEVER {
            return SimTime::NEVER;
        }
        SimTime::from_units(self.0.elapsed_at(at))
    }

    /// The earliest true time at which the board counts `at`.
    #[must_use]
    pub fn true_at(&self, at: SimTime) -> TrueTime {
        if at == SimTime::NEVER {
            return TrueTime::NEVER;
        }
        self.0.when_elapsed(at.units())
    }

    /// The oscillator itself.
    #[must_use]
    pub fn oscillator(&self) -> &Oscillator {
        &self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Seed, Stream};

    fn oscillator(rate_ppm: f64, wander: f64, offset_ns: i64) -> Oscillator {
        Oscillator::new(
            OscillatorConfig {
                offset_ns,
                rate_ppm,
                wander,
                ..OscillatorConfig::default()
            },
            Seed(11).stream(Stream::PhoneClock),
        )
    }

    #[test]
    fn a_constant_rate_error_is_exact() {
        // 50 ppm fast: in 3600 s the clock gains exactly 180 ms.
        let o = oscillator(50.0, 0.0, -7);
        let hour = TrueTime::from_nanos(3_600_000_000_000);
        assert_eq!(o.nanos_at(hour), 3_600_000_000_000 + 180_000_000 - 7);
        assert_eq!(o.when_nanos(3_600_180_000_000 - 7), Some(hour));
        assert_eq!(o.when_nanos(-8), None);
        // 300 ppm slow, in 90 kHz ticks: 90,000 · 3600 · (1 - 300e-6).
        let o = oscillator(-300.0, 0.0, 0);
        assert_eq!(o.ticks_at(hour, Rate::hz(90_000)), 323_902_800);
        assert_eq!(o.when_ticks(323_902_800, Rate::hz(90_000)), hour);
    }

    #[test]
    fn counts_and_times_are_inverse_and_monotonic_under_wander() {
        for rate in [0.0, 49.7, -49.7, 99_999.0, -99_999.0] {
            let o = oscillator(rate, 1e-6, 5_000_000_000);
            let mut random = Seed(5).stream(Stream::Test);
            let mut last = (TrueTime::ZERO, 0);
            for _ in 0..2000 {
                let step = random.bits() % (UNITS_PER_SECOND / 3);
                let t = TrueTime(last.0.0 + step);
                let n = o.elapsed_at(t);
                assert!(n >= last.1);
                let first = o.when_elapsed(n);
                assert!(first <= t);
                assert!(o.elapsed_at(first) >= n);
                if first.0 > 0 {
                    assert!(o.elapsed_at(TrueTime(first.0 - 1)) < n);
                }
                last = (t, n);
            }
        }
    }

    #[test]
    fn the_order_of_questions_does_not_change_the_answers() {
        let a = oscillator(10.0, 1e-8, 0);
        let b = oscillator(10.0, 1e-8, 0);
        let times: Vec<_> = (0..50)
            .map(|s| TrueTime::from_nanos(s * 777_777_777))
            .collect();
        let forward: Vec<_> = times.iter().map(|&t| a.elapsed_at(t)).collect();
        let mut backward: Vec<_> = times.iter().rev().map(|&t| b.elapsed_at(t)).collect();
        backward.reverse();
        assert_eq!(forward, backward);
    }

    #[test]
    fn wander_is_a_random_walk_of_the_stated_size() {
        // The change of frequency over 100 s has a standard deviation of
        // wander · sqrt(100); estimated from 400 stretches.
        let o = oscillator(0.0, 1e-9, 0);
        let at = |s: u64| o.fraction_at(TrueTime::from_nanos(s * 1_000_000_000));
        let n = 400;
        let sum: f64 = (0..n)
            .map(|k| (at((k + 1) * 100) - at(k * 100)).powi(2))
            .sum();
        let sd = (sum / n as f64).sqrt();
        assert!((0.9e-8..1.1e-8).contains(&sd), "{sd}");
    }

    #[test]
    fn a_warming_crystal_moves_as_stated_and_ever_more_slowly() {
        for (ppm, time_s) in [(1.0, 120.0), (-5.0, 300.0), (0.3, 1e6)] {
            let config = OscillatorConfig {
                warming: Warming {
                    ppm,
                    time_s,
                    ..Warming::default()
                },
                ..OscillatorConfig::default()
            };
            let o = Oscillator::new(config, Seed(1).stream(Stream::PhoneClock));
            let at = |s: u64| o.fraction_at(TrueTime::from_nanos(s * 1_000_000_000)) * 1e6;
            // A second of true time is its middle's rate.
            let per_second = (ppm / time_s).abs().max(ppm.abs() / 600.0);
            assert!((at(600) - at(0) - ppm).abs() < per_second, "{}", at(600));
            let (early, late) = (at(300) - at(0), at(600) - at(300));
            let ratio = (-300.0 / time_s).exp();
            assert!(
                (late / early - ratio).abs() < 0.02,
                "{early} {late} {ratio}"
            );
            // The count is the frequency's integral: 1 ppm over a second is 1 µs.
            let gained = o.elapsed_at(TrueTime::from_nanos(600_000_000_000)) as f64
                - 600.0 * UNITS_PER_SECOND as f64;
            let expected: f64 = (0..600).map(at).sum();
            assert!((gained / UNITS_PER_NANO as f64 * 1e-3 - expected).abs() < 0.01);
        }
        // With a time constant of zero there is no warming.
        let none = Warming {
            ppm: 1.0,
            time_s: 0.0,
            ..Warming::default()
        };
        assert!(none.fraction(0.0) == 0.0 && Warming::default().fraction(9.0) == 0.0);
        let step = Warming {
            step_ppm: 2.0,
            ..Warming::default()
        };
        assert_eq!(step.fraction(150.0), 0.0);
        assert!((step.fraction(180.0) * 1e6 - 1.264).abs() < 0.001);
    }

    #[test]
    fn the_board_counts_its_own_time() {
        let board = BoardTime::new(
            OscillatorConfig {
                offset_ns: 99,
                rate_ppm: -20.0,
                ..OscillatorConfig::default()
            },
            Seed(1).stream(Stream::BoardClock),
        );
        let t = TrueTime::from_nanos(100_000_000_000);
        assert_eq!(board.board_at(t), SimTime::from_nanos(99_998_000_000));
        assert_eq!(board.true_at(SimTime::from_nanos(99_998_000_000)), t);
        assert_eq!(board.true_at(SimTime::NEVER), TrueTime::NEVER);
    }

    #[test]
    fn absurd_inputs_stay_in_range() {
        let o = oscillator(f64::NAN, f64::INFINITY, i64::MAX);
        assert_eq!(o.nanos_at(TrueTime::NEVER), i64::MAX);
        assert_eq!(o.when_elapsed(u64::MAX), TrueTime::NEVER);
        assert_eq!(o.when_ticks(u64::MAX, Rate::hz(1)), TrueTime::NEVER);
        assert_eq!(o.when_ticks(5, Rate::hz(0)), TrueTime::NEVER);
        let slow = oscillator(-1e9, 0.0, 0);
        assert_ne!(slow.when_elapsed(HORIZON / 10 * 9), TrueTime::NEVER);
    }
}
