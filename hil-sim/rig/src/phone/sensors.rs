//! The phone's motion sensors: streams that run from power-on, with and without a listener.
//!
//! A stream is a pure function of the phone's seed, its clock and the rig's
//! motion: sample `n` has the same value and timestamp whether it was asked for
//! alone, in a short recording or in a long one. So what a run records depends
//! on the times of its requests only. For that, noise and jitter are drawn in
//! blocks of [`BLOCK`] samples, each from a stream of random numbers of its
//! own; the blocks of a long recording are computed in parallel. The price:
//! the filtered noise of two samples on either side of a block's border is not
//! correlated, once in some seconds.

use std::sync::Arc;

use rayon::prelude::*;

use super::config::{PhoneConfig, SensorConfig, StampErrors};
use super::substream;
use crate::clocks::oscillator::Oscillator;
use crate::motion::Motion;
use crate::motion::inertial_channel::{Channel, ChannelConfig};
use crate::random::{Random, Seed, Stream};

/// Samples that share one stream of random numbers.
const BLOCK: u64 = 2048;

/// The sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Accelerometer,
    Gyroscope,
    /// This phone lacks the sensor: its file is empty.
    Magnetometer,
}

impl Kind {
    /// In the order in which the app sends them.
    pub(super) const ALL: [Self; 3] = [Self::Accelerometer, Self::Gyroscope, Self::Magnetometer];

    /// Name of the sensor in the app's files.
    pub(super) const fn suffix(self) -> &'static str {
        match self {
            Self::Accelerometer => "accel",
            Self::Gyroscope => "gyro",
            Self::Magnetometer => "magnetic",
        }
    }

    /// True if this sensor is one of those: accelerometer, gyroscope, magnetometer.
    pub(super) const fn one_of(self, [accelerometer, gyroscope, magnetometer]: [bool; 3]) -> bool {
        match self {
            Self::Accelerometer => accelerometer,
            Self::Gyroscope => gyroscope,
            Self::Magnetometer => magnetometer,
        }
    }
}

/// One sample as the app gets it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sample {
    /// Timestamp, nanoseconds of the boot clock.
    pub(super) time_ns: i64,
    /// Values, single precision as in Android.
    pub(super) values: [f32; 3],
}

/// All motion sensors of one phone.
#[derive(Debug)]
pub(super) struct Sensors {
    seed: Seed,
    accelerometer: SensorConfig,
    gyroscope: SensorConfig,
    oscillator: Oscillator,
    motion: Arc<Motion>,
}

impl Sensors {
    pub(super) fn new(config: &PhoneConfig, oscillator: Oscillator, motion: Arc<Motion>) -> Self {
        Self {
            seed: config.seed,
            accelerometer: config.accelerometer.clone(),
            gyroscope: config.gyroscope.clone(),
            oscillator,
            motion,
        }
    }

    /// The samples taken in `from_ns..to_ns` of the boot clock. (What a fault
    /// does to a timestamp does not move a sample into or out of the range.)
    pub(super) fn samples(&self, kind: Kind, from_ns: i64, to_ns: i64) -> Vec<Sample> {
        let (config, stream) = match kind {
            Kind::Accelerometer => (&self.accelerometer, Stream::PhoneAccel),
            Kind::Gyroscope => (&self.gyroscope, Stream::PhoneGyro),
            Kind::Magnetometer => return Vec::new(),
        };
        let period_ns = 1e9 / config.rate_hz;
        let zero = self.oscillator.config().offset_ns;
        let number = |ns: i64| {
            let since = ns.saturating_sub(zero).max(0) as f64;
            (since / period_ns).ceil() as u64
        };
        let (first, end) = (number(from_ns), number(to_ns));
        if end <= first {
            return Vec::new();
        }
        let walk = BiasWalk::new(config, substream(self.seed, stream, u64::MAX));
        let stamps = substream(self.seed, Stream::PhoneTimestamps, u64::MAX - kind as u64);
        let errors = Errors::new(config.stamps, stamps);
        (first / BLOCK..=(end - 1) / BLOCK)
            .into_par_iter()
            .map(|block| {
                let begin = (first.max(block * BLOCK) - block * BLOCK) as usize;
                let stop = (end.min((block + 1) * BLOCK) - block * BLOCK) as usize;
                let noise = substream(self.seed, stream, block);
                let samples = self.block(kind, config, (block, noise), stop, (&walk, &errors));
                samples.get(begin..).unwrap_or_default().to_vec()
            })
            .collect::<Vec<_>>()
            .concat()
    }

    /// The first `count` samples of a block.
    fn block(
        &self,
        kind: Kind,
        config: &SensorConfig,
        (block, noise): (u64, Random),
        count: usize,
        (walk, errors): (&BiasWalk, &Errors),
    ) -> Vec<Sample> {
        let period_ns = 1e9 / config.rate_hz;
        let period_s = 1.0 / config.rate_hz;
        let zero = self.oscillator.config().offset_ns;
        let mut stamps = substream(self.seed, Stream::PhoneTimestamps, 3 * block + kind as u64);
        let still = ChannelConfig {
            bias_walk: 0.0,
            ..config.channel
        };
        let mut channel = Channel::new(still, config.low_pass, period_s, noise);
        let (walk_from, walk_to) = walk.over(block);
        let mut out = Vec::with_capacity(count);
        for i in 0..count {
            let n = block * BLOCK + i as u64;
            let time_ns = zero.saturating_add((n as f64 * period_ns).round() as i64);
            let at = match self.oscillator.when_nanos(time_ns) {
                Some(at) => at.as_secs_f64(),
                None => 0.0,
            };
            let measured = channel.sample(at, i as u64, period_s, |t| match kind {
                Kind::Gyroscope => self.motion.angular_rate(t),
                _ => self.motion.specific_force(t),
            });
            let part = i as f64 / BLOCK as f64;
            let mut values = [0.0f32; 3];
            for (axis, value) in values.iter_mut().enumerate() {
                let walked = walk_from[axis] + part * (walk_to[axis] - walk_from[axis]);
                let steps = ((measured[axis] + walked) / config.step).round();
                *value = (steps * config.step) as f32;
            }
            let jitter = config.timestamp_jitter_ns * stamps.normal();
            // Unused, and drawn all the same: a seed keeps its timestamps.
            stamps.uniform(0.0, 1.0);
            out.push(Sample {
                time_ns: errors.stamp(time_ns, n as f64 * period_s, jitter),
                values,
            });
        }
        out
    }
}

/// Errors of timestamps as functions of the time, so that a sample's does not depend on the
/// request.
struct Errors {
    config: StampErrors,
    phase: f64,
    /// Angular frequency and phase of the sines that make the wander: with frequencies by
    /// Cauchy's distribution its correlation is exponential.
    wander: [(f64, f64); 32],
}

impl Errors {
    fn new(config: StampErrors, mut random: Random) -> Self {
        let phase = random.uniform(0.0, 1.0);
        let wander = [0; 32].map(|_| {
            let quarter = random.uniform(0.0, 0.98) * std::f64::consts::FRAC_PI_2;
            let omega = libm::tan(quarter) / config.wander_s;
            (omega, random.uniform(0.0, std::f64::consts::TAU))
        });
        Self {
            config,
            phase,
            wander,
        }
    }

    /// Stamp of a sample that is taken at `time_ns`, `since_s` after power-on.
    fn stamp(&self, time_ns: i64, since_s: f64, jitter_ns: f64) -> i64 {
        let StampErrors {
            sawtooth_ns,
            sawtooth_s,
            wander_ns,
            step_ns,
            ..
        } = self.config;
        let mut late_ns = jitter_ns;
        if sawtooth_ns != 0.0 {
            late_ns += sawtooth_ns * (0.5 - (since_s / sawtooth_s + self.phase).fract());
        }
        if wander_ns != 0.0 {
            let sines = self.wander.iter().map(|(w, p)| libm::sin(w * since_s + p));
            late_ns += wander_ns * 0.25 * sines.sum::<f64>();
        }
        let stamp_ns = time_ns.saturating_add(late_ns.round() as i64);
        let step = step_ns.round() as i64;
        if step > 1 {
            stamp_ns - stamp_ns.rem_euclid(step)
        } else {
            stamp_ns
        }
    }
}

/// The random walk of a bias, known at the borders of the blocks.
struct BiasWalk {
    step: f64,
    random: Random,
}

impl BiasWalk {
    fn new(config: &SensorConfig, random: Random) -> Self {
        Self {
            step: config.channel.bias_walk * (BLOCK as f64 / config.rate_hz).sqrt(),
            random,
        }
    }

    /// The walk at both borders of a block.
    fn over(&self, block: u64) -> ([f64; 3], [f64; 3]) {
        let mut at = [0.0; 3];
        if self.step <= 0.0 {
            return (at, at);
        }
        let mut random = self.random.clone();
        let mut before = at;
        for _ in 0..=block {
            before = at;
            for (at, step) in at.iter_mut().zip(random.normal3()) {
                *at += self.step * step;
            }
        }
        (before, at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::MotionSpec;
    use crate::motion::gesture::Gesture;

    fn sensors(edit: impl FnOnce(&mut PhoneConfig)) -> (Sensors, i64) {
        let mut config = PhoneConfig::draw(Seed(3));
        edit(&mut config);
        let oscillator = Oscillator::new(config.clock, config.seed.stream(Stream::PhoneClock));
        let spec = MotionSpec::always(Gesture::Walk);
        let motion = spec.build(config.seed.stream(Stream::Motion));
        let zero = config.clock.offset_ns;
        (Sensors::new(&config, oscillator, motion), zero)
    }

    #[test]
    fn a_sample_does_not_depend_on_the_request() {
        let (sensors, zero) = sensors(|_| ());
        for kind in [Kind::Accelerometer, Kind::Gyroscope] {
            let whole = sensors.samples(kind, zero, zero + 12_000_000_000);
            let part = sensors.samples(kind, zero + 3_000_000_000, zero + 9_000_000_000);
            let at = whole.iter().position(|s| *s == part[0]).unwrap();
            assert_eq!(&whole[at..at + part.len()], part);
            // No sample is lost or doubled where two requests meet.
            let mut two = sensors.samples(kind, zero, zero + 5_000_000_000);
            two.extend(sensors.samples(kind, zero + 5_000_000_000, zero + 12_000_000_000));
            assert_eq!(whole, two);
        }
    }

    #[test]
    fn timestamps_follow_the_rate_and_jitter() {
        let (sensors, zero) = sensors(|c| c.gyroscope.rate_hz = 495.0);
        let samples = sensors.samples(Kind::Gyroscope, zero, zero + 20_000_000_000);
        assert_eq!(samples.len(), 9900);
        let errors: Vec<f64> = samples
            .iter()
            .enumerate()
            .map(|(n, s)| (s.time_ns - zero) as f64 - n as f64 * 1e9 / 495.0)
            .collect();
        let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        assert!((900.0..1100.0).contains(&rms), "{rms}");
    }

    #[test]
    fn stamps_have_the_configured_wander_sawtooth_and_resolution() {
        let errors = |edit: fn(&mut StampErrors)| -> Vec<f64> {
            let (sensors, zero) = sensors(|c| {
                c.gyroscope.rate_hz = 500.0;
                c.gyroscope.timestamp_jitter_ns = 0.0;
                edit(&mut c.gyroscope.stamps);
            });
            let samples = sensors.samples(Kind::Gyroscope, zero, zero + 400_000_000_000);
            let at = |(n, s): (usize, &Sample)| (s.time_ns - zero) as f64 - n as f64 * 2e6;
            samples.iter().enumerate().map(at).collect()
        };
        let mean = |values: &mut dyn Iterator<Item = f64>| {
            let values: Vec<f64> = values.collect();
            values.iter().sum::<f64>() / values.len() as f64
        };
        let wander = errors(|e| (e.wander_ns, e.wander_s) = (5_000.0, 0.5));
        let power = mean(&mut wander.iter().map(|e| e * e));
        assert!((4_000.0..6_000.0).contains(&power.sqrt()), "{power}");
        // After 0.5 s, 250 samples, exp(-1) is left of it.
        let later = mean(&mut wander.windows(251).map(|w| w[0] * w[250])) / power;
        assert!((0.2..0.55).contains(&later), "{later}");
        let sawtooth = errors(|e| (e.sawtooth_ns, e.sawtooth_s) = (58_000.0, 10.0));
        let jumps: Vec<f64> = sawtooth.windows(2).map(|w| w[1] - w[0]).collect();
        assert_eq!(jumps.iter().filter(|jump| **jump > 57_000.0).count(), 40);
        assert!(mean(&mut sawtooth.into_iter()).abs() < 100.0);
        let cut = errors(|e| e.step_ns = 31_000.0);
        assert!(cut.iter().all(|e| (-31_000.0..=0.0).contains(e)));
    }

    #[test]
    fn values_are_the_motion_turned_scaled_and_quantised() {
        let (sensors, zero) = sensors(|c| {
            c.gyroscope.channel.noise_density = 0.0;
            c.gyroscope.channel.bias_walk = 0.0;
        });
        let config = &sensors.gyroscope;
        let samples = sensors.samples(Kind::Gyroscope, zero + 4_000_000_000, zero + 4_500_000_000);
        assert!(samples.len() > 240);
        for sample in samples {
            let at = sensors.oscillator.when_nanos(sample.time_ns).unwrap();
            // Low-passed at 150 Hz, the motion (below 12 Hz) is only delayed.
            let rate = sensors
                .motion
                .angular_rate(at.as_secs_f64() - config.low_pass.delay_s);
            let turned = config.channel.rotation * nalgebra::Vector3::from(rate);
            for axis in 0..3 {
                let expected = turned[axis] * (1.0 + config.channel.scale_error[axis])
                    + config.channel.bias[axis];
                let got = f64::from(sample.values[axis]);
                assert!((got - expected).abs() < 0.6 * config.step + 1e-3);
                let steps = got / config.step;
                assert!((steps - steps.round()).abs() < 1e-3);
            }
        }
    }
}
