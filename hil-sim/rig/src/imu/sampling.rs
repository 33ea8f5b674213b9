//! When the sensor samples, and what it measures then.

use std::sync::Arc;

use super::SimImuConfig;
use super::config::DEGREES;
use super::log::Values;
use super::map::{Measuring, SignalPath, Source};
use crate::clocks::oscillator::{BoardTime, Oscillator, OscillatorConfig};
use crate::motion::inertial_channel::{Channel, quantise};
use crate::motion::{Motion, MotionView, STANDARD_GRAVITY};
use crate::random::{Random, Seed, Stream};
use stm32f4_sim::clock::{Clock, Rate};
use stm32f4_sim::time::{SimDuration, SimTime, UNITS_PER_SECOND};

/// Range around 19.2 MHz in which the PLL locks, in ppm. Not documented.
const LOCK_RANGE_PPM: u32 = 10_000;

/// From a new clock until the PLL has settled: 1 ms typical, 10 ms at most.
const PLL_SETTLING: SimDuration = SimDuration::from_millis(10);

/// From the end of sleep until the gyroscope's first sample: 30 ms typical.
const WAKE_UP: SimDuration = SimDuration::from_millis(30);

/// The clock that the sensor's internal samples run on.
#[derive(Clone, Debug)]
enum SampleClock {
    /// Exact in board time: internal sample `n` is edge `n` of this clock.
    External(Clock),
    /// Exact in the time of the sensor's own oscillator.
    Own {
        oscillator: Oscillator,
        rate: Rate,
        /// Tick of the oscillator's counter that is internal sample 0.
        first: u64,
    },
    /// Counted edges.
    Edges(Edges),
}

/// Counts the edges of a clock of 31 to 50 kHz (ICM-42688-P data sheet, 3.7).
#[derive(Clone, Copy, Debug)]
struct Edges {
    /// Number of them in one internal sample.
    every: u64,
    /// They count from here on.
    ready: SimTime,
    last: Option<SimTime>,
    seen: u64,
}

impl Edges {
    const SHORTEST: SimDuration = SimDuration::from_nanos(20_000);
    const LONGEST: SimDuration = SimDuration::from_nanos(32_259);

    /// A rising edge at `at`; returns whether that is an internal sample's.
    fn count(&mut self, at: SimTime) -> bool {
        let last = self.last.replace(at);
        let in_range = last.is_some_and(|last| {
            let length = at - last;
            (Self::SHORTEST..=Self::LONGEST).contains(&length)
        });
        if !in_range {
            self.seen = 0;
        }
        if at < self.ready || !in_range {
            return false;
        }
        self.seen += 1;
        self.seen.is_multiple_of(self.every)
    }
}

/// Source and rate that a sample clock was made for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Origin {
    source: Source,
    reference: Option<Rate>,
    gyro_hz: u64,
}

/// The sensor's analogue part and its sample clock.
#[derive(Debug)]
pub(super) struct Sampling {
    motion: MotionView,
    board: BoardTime,
    gyro: Channel,
    accel: Channel,
    path: SignalPath,
    pll: Oscillator,
    internal: Oscillator,
    clock: Option<SampleClock>,
    origin: Option<Origin>,
    awake_since: Option<SimTime>,
    /// Number of the internal sample that is registered next.
    tick: u64,
    next: Option<SimTime>,
    count: u64,
    last: Values,
    last_accel_tick: Option<u64>,
    powered_since: SimTime,
    temperature_noise: Random,
    settings: SimImuConfig,
}

impl Sampling {
    pub(super) fn new(
        config: &SimImuConfig,
        path: SignalPath,
        motion: Arc<Motion>,
        board: BoardTime,
        seed: Seed,
    ) -> Self {
        let channel = |config, low_pass, hz: u64, stream| {
            Channel::new(config, low_pass, 1.0 / hz as f64, seed.stream(stream))
        };
        let own = |config| Oscillator::new(config, seed.stream(Stream::ImuClock));
        Self {
            motion: MotionView::new(motion),
            board,
            gyro: channel(config.gyro, path.gyro, path.gyro_hz, Stream::ImuGyro),
            accel: channel(config.accel, path.accel, path.accel_hz, Stream::ImuAccel),
            path,
            pll: own(config.own_clock),
            internal: own(OscillatorConfig {
                rate_ppm: config.internal_ppm,
                ..config.own_clock
            }),
            clock: None,
            origin: None,
            awake_since: None,
            tick: 0,
            next: None,
            count: 0,
            last: Values::default(),
            last_accel_tick: None,
            powered_since: SimTime::ZERO,
            temperature_noise: seed.stream(Stream::ImuTemperature),
            settings: *config,
        }
    }

    /// When the next sample is registered.
    pub(super) fn next(&self) -> Option<SimTime> {
        self.next
    }

    /// Samples registered so far.
    pub(super) fn count(&self) -> u64 {
        self.count
    }

    /// No clock until it is configured again.
    pub(super) fn stop(&mut self) {
        self.clock = None;
        self.origin = None;
        self.awake_since = None;
        self.next = None;
        self.last = Values::default();
    }

    /// Power came at `at`: the die is cold.
    pub(super) fn cold_start(&mut self, at: SimTime) {
        self.powered_since = at;
    }

    /// Sensor registers are cleared (SIG_COND_RESET).
    pub(super) fn clear(&mut self) {
        self.last = Values::default();
        self.last_accel_tick = None;
    }

    /// Chooses the sample clock from the registers and the clock on CLKIN.
    /// Nothing happens if nothing changed.
    pub(super) fn configure(&mut self, at: SimTime, measuring: &Measuring, clock_in: Option<Rate>) {
        let path = measuring.path;
        if path != self.path {
            self.path = path;
            self.gyro.set_filter(path.gyro, 1.0 / path.gyro_hz as f64);
            self.accel
                .set_filter(path.accel, 1.0 / path.accel_hz as f64);
            self.last_accel_tick = None;
        }
        if !measuring.awake {
            self.clock = None;
            self.origin = None;
            self.awake_since = None;
            self.next = None;
            return;
        }
        let woke = *self.awake_since.get_or_insert(at);
        let source = measuring.source;
        let reference = match source {
            Source::Reference(nominal) => {
                clock_in.filter(|rate| locks(*rate, nominal, LOCK_RANGE_PPM))
            }
            _ => None,
        };
        let origin = Origin {
            source,
            reference,
            gyro_hz: path.gyro_hz,
        };
        if self.origin == Some(origin) {
            return;
        }
        self.origin = Some(origin);
        let ready = (at + PLL_SETTLING).max(woke + WAKE_UP);
        let rate = Rate::hz(path.gyro_hz);
        self.clock = match source {
            Source::Stopped => None,
            Source::Reference(nominal) => reference.map(|reference| {
                // The first internal sample falls on an edge of the reference.
                let edges = Clock::new(reference, at, 0);
                let first = edges.time_of(edges.edge_at(ready) + 1);
                let samples = reference.scaled(1, nominal / path.gyro_hz);
                SampleClock::External(Clock::new(samples, first, 0))
            }),
            Source::Edges(every) => Some(SampleClock::Edges(Edges {
                every,
                ready,
                last: None,
                seen: 0,
            })),
            Source::Pll => Some(self.own_clock(&self.pll, rate, ready)),
            Source::Internal => Some(self.own_clock(&self.internal, rate, ready)),
        };
        self.gyro.restart();
        self.accel.restart();
        self.last_accel_tick = None;
        self.tick = 0;
        self.schedule();
    }

    fn own_clock(&self, oscillator: &Oscillator, rate: Rate, ready: SimTime) -> SampleClock {
        SampleClock::Own {
            oscillator: oscillator.clone(),
            rate,
            first: oscillator.ticks_at(self.board.true_at(ready), rate) + 1,
        }
    }

    /// A rising edge at the CLKIN of those that count them. The sample that it is the
    /// clock of is due at once.
    pub(super) fn clock_edge(&mut self, at: SimTime) {
        if let Some(SampleClock::Edges(edges)) = &mut self.clock
            && edges.count(at)
        {
            self.next = Some(at);
        }
    }

    fn schedule(&mut self) {
        self.next = match &self.clock {
            None | Some(SampleClock::Edges(_)) => None,
            Some(SampleClock::External(clock)) => Some(self.data_ready(clock)),
            Some(SampleClock::Own {
                oscillator,
                rate,
                first,
            }) => {
                let at = oscillator.when_ticks(first + self.tick, *rate);
                Some(self.board.board_at(at))
            }
        }
        .filter(|t| *t != SimTime::NEVER);
    }

    /// When the next sample of an external clock is registered.
    fn data_ready(&self, clock: &Clock) -> SimTime {
        let at = clock.time_of(self.tick);
        let since = (at - clock.time_of(0)).as_secs_f64();
        let late = self.settings.data_ready.late(since);
        SimTime::from_units(at.units().saturating_add_signed(late))
    }

    /// True length of an internal sample of the gyroscope, in seconds.
    fn tick_length(&self) -> f64 {
        match &self.clock {
            Some(SampleClock::External(clock)) => {
                let units = clock.time_of(1) - clock.time_of(0);
                units.units() as f64 / UNITS_PER_SECOND as f64
            }
            _ => 1.0 / self.path.gyro_hz as f64,
        }
    }

    /// Measures at `at` and moves on to the next sample.
    pub(super) fn take(&mut self, at: SimTime, measuring: &Measuring) -> Values {
        let now = self.board.true_at(at).as_secs_f64();
        let length = self.tick_length();
        let per_rad = measuring.gyro_counts_per_dps * DEGREES;
        let rate = self
            .gyro
            .sample(now, self.tick, length, |t| self.motion.angular_rate(t));
        let warmed = self.self_heating(at);
        for (axis, rate) in rate.into_iter().enumerate() {
            let rate = rate + self.settings.gyro_drift[axis] * warmed;
            if !measuring.gyro_off[axis] {
                self.last.gyro[axis] = quantise(rate, per_rad);
            }
        }
        // An MPU's accelerometer has 1 kHz: at 8 kHz its value stays for 8 samples.
        let ratio = self.path.gyro_hz / self.path.accel_hz;
        let accel_tick = self.tick / ratio;
        if self.last_accel_tick != Some(accel_tick) {
            self.last_accel_tick = Some(accel_tick);
            let since = (self.tick % ratio) as f64 * length;
            let per_unit = measuring.accel_counts_per_g / STANDARD_GRAVITY;
            let force = self
                .accel
                .sample(now - since, accel_tick, length * ratio as f64, |t| {
                    self.motion.specific_force(t)
                });
            for (axis, force) in force.into_iter().enumerate() {
                if !measuring.accel_off[axis] {
                    self.last.accel[axis] = quantise(force, per_unit);
                }
            }
        }
        if let Some((per_degree, at_zero)) = measuring.thermometer {
            self.last.temperature = quantise(self.temperature(at) - at_zero, per_degree);
        }
        self.tick += measuring.divider;
        self.count += 1;
        self.schedule();
        self.last
    }

    /// By how many °C the die is warmer than at power-on.
    fn self_heating(&self, at: SimTime) -> f64 {
        let on = (at - self.powered_since).as_secs_f64();
        self.settings.self_heating_c * (1.0 - libm::exp(-on / self.settings.warm_up_s))
    }

    /// Die temperature in °C: ambient, self-heating since power-on, noise.
    fn temperature(&mut self, at: SimTime) -> f64 {
        let heating = self.self_heating(at);
        let s = &self.settings;
        s.temperature_c + heating + s.temperature_noise_c * self.temperature_noise.normal()
    }
}

/// True if the PLL for `nominal_hz` locks to `rate`.
fn locks(rate: Rate, nominal_hz: u64, range_ppm: u32) -> bool {
    let (num, den) = rate.fraction();
    let nominal = u128::from(den) * u128::from(nominal_hz);
    u128::from(num).abs_diff(nominal) * 1_000_000 <= nominal * u128::from(range_ppm)
}
