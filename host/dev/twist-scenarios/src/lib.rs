//! A seeded generator of simulated twists, for tests, bench and study.
//!
//! **Everything made here is simulated.** One motion (a sum of random sines per
//! axis under an envelope, at rest before and after) is seen by two gyroscopes,
//! each through its own rotation, scale, bias, low-pass filter, noise,
//! quantisation and clock. The ground truth is returned beside the recordings, and the
//! same [`TwistSpec`] and seed give the same recordings on every machine.
//!
//! Noise and quantisation are those of the recordings at rest in
//! `host/sync/twist-sync-python/python/twist_sync/example`: 1.4 mrad/s (an MPU-9150) and 1.15 mrad/s (a phone's gyroscope).

use nalgebra::{Rotation3, Unit, Vector3};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use twist_sync::interpolant::{Uneven, Uniform, Vec3};
use twist_sync::{GyroTrack, Options};

use grip::{Held, rise};

mod families;
mod grip;
mod scenarios;
mod views;

pub use families::{Family, families};
pub use grip::Grip;
pub use scenarios::{REAL_STRENGTH, Scenario, scenarios};
pub use views::RealMotion;

/// Motion of the rig.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Motion {
    /// A twist by hand about changing axes, with a peak rate in this range, rad/s.
    Twist(f64, f64),
    /// A twist about one fixed axis, with a peak rate in this range, rad/s.
    SingleAxis(f64, f64),
    /// A twist with these peaks about the three axes, rad/s.
    Axes([f64; 3]),
    /// Carrying around and slow panning, with a peak rate in this range, rad/s.
    Natural(f64, f64),
    /// A vehicle: turns of up to this many rad/s below 2 Hz, with vibration of this many rad/s
    /// and a frequency in this range, Hz.
    Vehicle(f64, f64, (f64, f64)),
    /// Short pushes of 30 to 80 ms, with this peak rate in rad/s.
    Taps(f64),
    /// Rest on a table.
    Still,
}

/// Properties of one simulated gyroscope.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sensor {
    /// Samples in one second of its own clock.
    pub rate_hz: f64,
    /// Rms of the white noise of a sample, rad/s.
    pub noise: f64,
    /// Least significant bit, rad/s; 0 for no quantisation.
    pub lsb: f64,
    /// −3 dB frequency of its two-pole low-pass in Hz, if it has one.
    pub filter_hz: Option<f64>,
    /// Damping ratio of the low-pass: 1 for two equal poles, 1/√2 for Butterworth.
    pub filter_damping: f64,
    /// End of the range, rad/s, if it can clip.
    pub range: Option<f64>,
    /// Rms of the deviation of the sampling instants from the regular grid, seconds. The stamps
    /// follow it.
    pub jitter_s: f64,
    /// Height and period of a zero-mean sawtooth error of the stamps, seconds.
    pub sawtooth_s: Option<(f64, f64)>,
    /// Longest period of the sawtooth, seconds: each recording draws its own, from the period on.
    /// 0 for the same period in all.
    pub longest_sawtooth_s: f64,
    /// Rms and correlation time of a wander of the stamps, seconds.
    pub wander_s: Option<(f64, f64)>,
    /// Step to which the stamps are truncated, seconds; 0 for none.
    pub resolution_s: f64,
    /// Factor of the noise about z.
    pub noisy_z: f64,
    /// Lateness of the content about x, y and z, seconds.
    pub axes_late_s: Vec3,
    /// Share of the samples that are lost, in bursts of 1 to 20.
    pub lost: f64,
    /// True for copies and displaced samples like those of phones.
    pub faulty: bool,
    /// Period of those faults in samples.
    pub faulty_period: f64,
    /// Lead of the content of the sample after a displaced one, seconds.
    pub faulty_next_s: f64,
}

/// Specification of a pair of recordings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TwistSpec {
    /// Motion of the rig.
    pub motion: Motion,
    /// Length of each recording, seconds.
    pub duration_s: f64,
    /// Rest before and after a twist, seconds.
    pub rest_s: f64,
    /// Start of recording b after that of a, seconds.
    pub b_starts_s: f64,
    /// True if gyroscope b sees an unrelated motion.
    pub unrelated: bool,
    /// Grip of the two gyroscopes.
    pub grip: Grip,
    /// Largest magnitude of the clocks' skew, ppm; the skew is drawn uniformly.
    pub skew_ppm: f64,
    /// Gyroscope a.
    pub a: Sensor,
    /// Gyroscope b.
    pub b: Sensor,
}

/// An MPU-9150 at 500 Hz.
pub const SENSOR_A: Sensor = Sensor {
    rate_hz: 500.0,
    noise: 1.4e-3,
    lsb: 1.332e-4,
    filter_hz: None,
    filter_damping: 1.0,
    range: None,
    jitter_s: 0.0,
    sawtooth_s: None,
    longest_sawtooth_s: 0.0,
    wander_s: None,
    resolution_s: 0.0,
    noisy_z: 1.0,
    axes_late_s: [0.0; 3],
    lost: 0.0,
    faulty: false,
    faulty_period: 10.0,
    faulty_next_s: 0.0,
};

/// A phone's gyroscope at about 500 Hz.
pub const SENSOR_B: Sensor = Sensor {
    rate_hz: 500.06,
    noise: 1.15e-3,
    lsb: 3.787e-5,
    ..SENSOR_A
};

impl Sensor {
    /// Returns the stamp of a time, truncated to the sensor's resolution.
    fn stamp(&self, t: f64) -> f64 {
        if self.resolution_s > 0.0 {
            (t / self.resolution_s).floor() * self.resolution_s
        } else {
            t
        }
    }
}

impl Default for TwistSpec {
    /// The base scenario: 9 s, 2 to 4 rad/s about changing axes.
    fn default() -> Self {
        Self {
            motion: Motion::Twist(2.0, 4.0),
            duration_s: 9.0,
            rest_s: 1.0,
            b_starts_s: 0.3,
            unrelated: false,
            grip: Grip::Firm,
            skew_ppm: 20.0,
            a: SENSOR_A,
            b: SENSOR_B,
        }
    }
}

/// Returns the options with everything that a user knows about the two sensors: the delays of
/// their filters, and the jump of a sawtooth whose period is so long that a twist may not show it.
#[must_use]
pub fn options(spec: &TwistSpec) -> Options {
    let is_long = |sawtooth: &(f64, f64)| sawtooth.1 > 3.0;
    Options {
        a_delay_s: filter_delay_s(&spec.a),
        b_delay_s: filter_delay_s(&spec.b),
        b_jump_s: spec.b.sawtooth_s.filter(is_long).map_or(0.0, |s| s.0),
        ..Options::default()
    }
}

/// Delay of the two-pole filter at low frequency, seconds.
fn filter_delay_s(sensor: &Sensor) -> f64 {
    let delay = |hz| 2.0 * sensor.filter_damping / natural_frequency(hz, sensor.filter_damping);
    sensor.filter_hz.map_or(0.0, delay)
}

/// Natural frequency, rad/s, of a two-pole low-pass with −3 dB at `hz`.
fn natural_frequency(hz: f64, damping: f64) -> f64 {
    let half = 1.0 - 2.0 * damping * damping;
    std::f64::consts::TAU * hz / (half + (half * half + 1.0).sqrt()).sqrt()
}

/// Filters a signal by `ω₀² / (s² + 2ζω₀s + ω₀²)`, whose −3 dB frequency is `hz`; or, for
/// a mount (`carried`) with its resonance at `hz`, by `(2ζω₀s + ω₀²) / (s² + 2ζω₀s + ω₀²)`.
///
/// Trapezoidal rule in steps of 0.1 ms: at 60 Hz exact to 10⁻⁴, at the motion's few Hz
/// to 10⁻⁶.
fn second_order(
    input: &dyn Fn(f64) -> Vector3<f64>,
    hz: f64,
    damping: f64,
    carried: bool,
    from: f64,
    to: f64,
) -> Option<Uniform> {
    let step = 1e-4;
    let natural = if carried {
        std::f64::consts::TAU * hz
    } else {
        natural_frequency(hz, damping)
    };
    let (stiff, loss) = (natural * natural, 2.0 * damping * natural);
    let through = if carried { loss } else { 0.0 };
    let half = 0.5 * step;
    let steps = ((to - from) / step) as usize;
    let mut before = input(from);
    let (mut x, mut v) = (before, before * (loss - through));
    let mut nodes: Vec<Vec3> = Vec::with_capacity(steps / 5 + 1);
    for k in 0..steps {
        let now = input(from + k as f64 * step);
        let both = before + now;
        let force = (both - x) * (half * stiff) + v;
        let next = (x + (both * through - x * loss + v + force) * half)
            / (1.0 + half * loss + half * half * stiff);
        v = force - next * (half * stiff);
        x = next;
        before = now;
        if k % 5 == 0 {
            nodes.push(x.into());
        }
    }
    Uniform::new(from, 5.0 * step, nodes)
}

/// The ground truth of clock b against clock a: a skew that walks at random.
#[derive(Debug, Clone, PartialEq)]
pub struct ClockPath {
    /// Accumulated difference, b − a, at whole seconds from the start.
    drift: Vec<f64>,
    /// Skew at the same times.
    skew: Vec<f64>,
}

impl ClockPath {
    /// Creates a path of `length_s` seconds with a skew of `skew` at the start that walks by
    /// `wander` rms in a minute (dimensionless, see [`twist_sync::Wander`]). The accumulated
    /// difference is zero at `zero_s`.
    #[must_use]
    pub fn new(seed: u64, skew: f64, wander: f64, length_s: f64, zero_s: f64) -> Self {
        let mut rng = Pcg64::seed_from_u64(seed ^ 0x5eed_c10c);
        let seconds = length_s.max(1.0).ceil() as usize + 2;
        let mut out = Self {
            drift: vec![0.0],
            skew: vec![skew],
        };
        for k in 1..seconds {
            let step: f64 = StandardNormal.sample(&mut rng);
            let before = out.skew[k - 1];
            let now = before + wander * step / 60.0_f64.sqrt();
            out.skew.push(now);
            out.drift.push(out.drift[k - 1] + 0.5 * (before + now));
        }
        let at_zero = out.drift_at(zero_s);
        for d in &mut out.drift {
            *d -= at_zero;
        }
        out
    }

    /// Returns the accumulated difference b − a at `t`, both in seconds; `t` counts from the
    /// start.
    #[must_use]
    pub fn drift_at(&self, t: f64) -> f64 {
        let last = self.drift.len() - 2;
        let k = (t.max(0.0) as usize).min(last);
        let x = t - k as f64;
        // The skew is linear between whole seconds.
        let slope = self.skew[k + 1] - self.skew[k];
        self.drift[k] + self.skew[k] * x + 0.5 * slope * x * x
    }

    /// Returns the skew at `t` seconds from the start.
    #[must_use]
    pub fn skew_at(&self, t: f64) -> f64 {
        let last = self.skew.len() - 2;
        let k = (t.max(0.0) as usize).min(last);
        self.skew[k] + (self.skew[k + 1] - self.skew[k]) * (t - k as f64)
    }
}

/// A simulated pair of recordings with its ground truth.
#[derive(Debug, Clone)]
pub struct Twist {
    /// Recording a.
    pub a: GyroTrack,
    /// Recording b.
    pub b: GyroTrack,
    /// True skew in the middle of the recordings.
    pub skew: f64,
    /// Reading of clock a at the start of the clocks' path, seconds.
    pub boot_s: f64,
    /// True b − a where the path is zero, seconds.
    pub offset_s: f64,
    /// Path of the clocks.
    pub path: ClockPath,
    /// Stretches (from, to) in which the two are not one body, in seconds of clock a.
    pub loose_s: Vec<(f64, f64)>,
}

impl Twist {
    /// Returns the true offset (b − a) at a time of clock a, both in seconds.
    #[must_use]
    pub fn offset_at(&self, a_s: f64) -> f64 {
        self.offset_s + self.path.drift_at(a_s - self.boot_s)
    }
}

/// Sum of sines under an envelope.
struct Rates {
    /// Per axis: amplitude, angular frequency, phase.
    parts: [Vec<(f64, f64, f64)>; 3],
    rest_s: f64,
    end_s: f64,
    scale: f64,
    axis: Option<Vector3<f64>>,
    /// Vibration: amplitude and axis, angular frequency, phase.
    vibration: Vec<(Vector3<f64>, f64, f64)>,
    /// Pushes: rate at the peak, instant of the peak, 1-sigma of the duration in seconds.
    taps: Vec<(Vector3<f64>, f64, f64)>,
}

impl Rates {
    fn new(rng: &mut Pcg64, motion: Motion, rest_s: f64, end_s: f64) -> Self {
        let (low, high, slowest, fastest, rest_s) = match motion {
            Motion::Twist(low, high) | Motion::SingleAxis(low, high) => {
                (low, high, 0.5, 3.5, rest_s)
            }
            Motion::Axes(_) => (1.0, 1.0, 0.5, 3.5, rest_s),
            Motion::Natural(low, high) => (low, high, 0.05, 1.5, 0.0),
            Motion::Vehicle(peak, ..) => (peak, peak, 0.05, 2.0, 0.0),
            Motion::Still | Motion::Taps(_) => (0.0, 0.0, 0.5, 3.5, 0.0),
        };
        let parts = std::array::from_fn(|_| {
            (0..6)
                .map(|_| {
                    let frequency = rng.random_range(slowest..fastest);
                    (
                        rng.random_range(0.3..1.0) / (0.5 + frequency),
                        std::f64::consts::TAU * frequency,
                        rng.random_range(0.0..std::f64::consts::TAU),
                    )
                })
                .collect()
        });
        let axis = matches!(motion, Motion::SingleAxis(..)).then(|| direction(rng));
        let mut out = Self {
            parts,
            rest_s,
            end_s,
            scale: 1.0,
            axis,
            vibration: Vec::new(),
            taps: Vec::new(),
        };
        if let Motion::Taps(peak) = motion {
            let mut at = rest_s;
            while at < end_s - rest_s {
                let size = direction(rng) * (peak * rng.random_range(0.4..1.0));
                out.taps.push((size, at, rng.random_range(0.012..0.03)));
                at += rng.random_range(0.25..1.2);
            }
            return out;
        }
        if let Motion::Axes(peaks) = motion {
            for (axis, peak) in peaks.into_iter().enumerate() {
                let at = |k| out.at(end_s * f64::from(k) / 2000.0)[axis].abs();
                let highest = (0..2000).map(at).fold(1e-9, f64::max);
                for (amplitude, ..) in &mut out.parts[axis] {
                    *amplitude *= peak / highest;
                }
            }
            return out;
        }
        let highest = (0..2000)
            .map(|k| out.at(end_s * f64::from(k) / 2000.0).norm())
            .fold(1e-9, f64::max);
        let peak = if high > low {
            rng.random_range(low..high)
        } else {
            low
        };
        out.scale = peak / highest;
        if let Motion::Vehicle(_, amplitude, (low, high)) = motion {
            // Neighbouring tones beat like a narrow band of noise.
            let centre = rng.random_range(low..high);
            let tone = |_| {
                let hz = centre + rng.random_range(-1.5..1.5);
                let turn = std::f64::consts::TAU;
                let phase = rng.random_range(0.0..turn);
                (
                    direction(rng) * (amplitude / 8.0_f64.sqrt()),
                    turn * hz,
                    phase,
                )
            };
            out.vibration = (0..8).map(tone).collect();
        }
        out
    }

    fn at(&self, t: f64) -> Vector3<f64> {
        let envelope = if self.rest_s > 0.0 {
            rise((t - self.rest_s) / 0.5) * rise((self.end_s - self.rest_s - t) / 0.5)
        } else {
            1.0
        };
        let sum = |axis: usize| {
            self.parts[axis]
                .iter()
                .map(|(a, w, p)| a * (w * t + p).sin())
                .sum::<f64>()
        };
        let v = match self.axis {
            Some(axis) => axis * sum(0),
            None => Vector3::new(sum(0), sum(1), sum(2)),
        };
        let mut v = v * (self.scale * envelope);
        for (size, w, phase) in &self.vibration {
            v += size * (w * t + phase).sin();
        }
        for (size, at, lasts) in &self.taps {
            let x = (t - at) / lasts;
            if x.abs() < 6.0 {
                // A turn and most of the way back.
                v += size * ((-0.5 * x * x).exp() - 0.4 * (-0.125 * (x - 1.5) * (x - 1.5)).exp());
            }
        }
        v
    }
}

fn direction(rng: &mut Pcg64) -> Vector3<f64> {
    let v: Vector3<f64> = Vector3::from_fn(|_, _| StandardNormal.sample(rng));
    Unit::new_normalize(v).into_inner()
}

/// Draws a rotation about any axis by up to half a turn.
fn rotation(rng: &mut Pcg64) -> Rotation3<f64> {
    let axis = Unit::new_normalize(direction(rng));
    Rotation3::from_axis_angle(&axis, rng.random_range(0.0..std::f64::consts::PI))
}

/// Signal after a sensor's filter, as a function of true time.
struct Seen<'a> {
    rate: &'a dyn Fn(f64) -> Vector3<f64>,
    filtered: Option<Uniform>,
}

impl<'a> Seen<'a> {
    fn new(rate: &'a dyn Fn(f64) -> Vector3<f64>, sensor: &Sensor, from: f64, to: f64) -> Self {
        let (from, to) = (from - 0.1, to + 0.1);
        let filtered = sensor
            .filter_hz
            .and_then(|hz| second_order(rate, hz, sensor.filter_damping, false, from, to));
        Self { rate, filtered }
    }

    fn at(&self, t: f64) -> Vector3<f64> {
        self.filtered
            .as_ref()
            .map_or_else(|| (self.rate)(t), |s| s.value(t).into())
    }
}

/// Samples one sensor: returns stamps in true time, and rates.
fn record(
    rng: &mut Pcg64,
    sensor: &Sensor,
    seen: &Seen,
    rotation: &Rotation3<f64>,
    start_s: f64,
    duration_s: f64,
) -> (Vec<f64>, Vec<Vec3>) {
    let step = 1.0 / sensor.rate_hz;
    let first = start_s + rng.random_range(0.0..step);
    let bias = direction(rng) * 0.01;
    let scale = Vector3::from_fn(|_, _| 1.0 + rng.random_range(-0.005..0.005));
    let class = rng.random_range(0..10_usize);
    let phase = rng.random_range(0.0..1.0);
    // A separate generator, so that these effects do not change the draws of other sensors.
    let mut own = Pcg64::seed_from_u64(class as u64 + (phase * 1e15) as u64);
    let mut wander = 0.0;
    let sawtooth = sensor.sawtooth_s.map(|(height, period)| {
        let longest = sensor.longest_sawtooth_s.max(period);
        (height, period + (longest - period) * own.random::<f64>())
    });
    let quantise = |x: f64| {
        if sensor.lsb > 0.0 {
            (x / sensor.lsb).round() * sensor.lsb
        } else {
            x
        }
    };
    let mut times = Vec::new();
    let mut rates: Vec<Vec3> = Vec::new();
    let mut lost = 0_usize;
    let samples = (duration_s * sensor.rate_hz) as usize;
    for k in 0..samples {
        let jitter: f64 = StandardNormal.sample(rng);
        let sampled = first + k as f64 * step + sensor.jitter_s * jitter;
        let mut content = sampled;
        let mut stamp = sampled;
        let mut copied = false;
        if sensor.faulty {
            let place = (k as f64 - class as f64).rem_euclid(sensor.faulty_period);
            if place < 1.0 {
                copied = rng.random_bool(0.55);
                content -= 1e-3 + rng.random_range(-1e-4..1e-4);
            } else if place < 2.0 {
                content -= sensor.faulty_next_s;
            }
            if rng.random_bool(0.001) {
                stamp += 0.7e-3;
            }
        }
        if let Some((height, period)) = sawtooth {
            let x: f64 = (k as f64 * step / period + phase).fract();
            stamp += height * (0.5 - x);
        }
        if let Some((rms, memory)) = sensor.wander_s {
            let kept = if k == 0 { 0.0 } else { (-step / memory).exp() };
            let new: f64 = StandardNormal.sample(&mut own);
            wander = kept * wander + rms * (1.0 - kept * kept).sqrt() * new;
            stamp += wander;
        }
        let mut noise: Vector3<f64> = Vector3::from_fn(|_, _| StandardNormal.sample(rng));
        noise.z *= sensor.noisy_z;
        let axis = |axis: usize| (rotation * seen.at(content - sensor.axes_late_s[axis]))[axis];
        let turned = if sensor.axes_late_s == [0.0; 3] {
            rotation * seen.at(content)
        } else {
            Vector3::from_fn(|row, _| axis(row))
        };
        let clean = turned.component_mul(&scale) + bias;
        let mut value: Vec3 = (clean + noise * sensor.noise).into();
        for x in &mut value {
            if let Some(range) = sensor.range {
                *x = x.clamp(-range, range);
            }
            *x = quantise(*x);
        }
        if copied && let Some(&before) = rates.last() {
            value = before;
        }
        if lost > 0 {
            lost -= 1;
            continue;
        }
        if sensor.lost > 0.0 && rng.random_bool((sensor.lost / 10.0).min(1.0)) {
            lost = rng.random_range(0..20);
            continue;
        }
        times.push(stamp);
        rates.push(value);
    }
    (times, rates)
}

/// Generates the pair of recordings of one seed.
#[must_use]
pub fn twist(spec: &TwistSpec, seed: u64) -> Twist {
    let mut rng = Pcg64::seed_from_u64(seed ^ 0x0a11_c10c);
    let skew = 1e-6 * spec.skew_ppm * rng.random_range(-1.0..=1.0);
    let length_s = spec.duration_s + spec.b_starts_s.max(0.0);
    let path = ClockPath::new(seed, skew, 0.0, length_s, 0.5 * length_s);
    twist_on(spec, seed, &path, 0.0)
}

/// Generates a pair of recordings on given clocks, starting `start_s` into their path.
///
/// The clocks' boot times depend on `seed / 1000` only: seeds 1000·n to
/// 1000·n + 999 on one path are recordings of one session.
#[must_use]
pub fn twist_on(spec: &TwistSpec, seed: u64, path: &ClockPath, start_s: f64) -> Twist {
    let mut session = Pcg64::seed_from_u64((seed / 1000) ^ 0xb007);
    // Hours since boot, different for the two.
    let a_boot: f64 = session.random_range(10.0..5000.0);
    let offset_s: f64 = session.random_range(-4000.0..1e6);
    let mut rng = Pcg64::seed_from_u64(seed);
    let end = spec.duration_s + spec.b_starts_s.max(0.0);
    let moving_until = moving_until(spec);
    let rates = Rates::new(&mut rng, spec.motion, spec.rest_s, moving_until);
    let other = Rates::new(&mut rng, spec.motion, spec.rest_s, moving_until);
    let turn = rotation(&mut rng);
    let identity = Rotation3::identity();

    let moving = (spec.rest_s, moving_until - spec.rest_s);
    let held = Held::new(spec.grip, seed, &rates, &other, moving);
    let of_a = |t: f64| rates.at(t);
    let seen = Seen::new(&of_a, &spec.a, 0.0, end);
    let (a_t, a_w) = record(&mut rng, &spec.a, &seen, &identity, 0.0, spec.duration_s);
    let of_b = |t: f64| {
        if spec.unrelated {
            other.at(t)
        } else {
            held.at(t)
        }
    };
    let seen = Seen::new(&of_b, &spec.b, 0.0, end);
    let (b_t, b_w) = record(
        &mut rng,
        &spec.b,
        &seen,
        &turn,
        spec.b_starts_s,
        spec.duration_s,
    );

    // Clock a is true time plus its boot; clock b follows the path.
    let stamp = |t: &f64| spec.a.stamp(t + start_s) + a_boot;
    let a_s: Vec<f64> = a_t.iter().map(stamp).collect();
    Twist {
        a: GyroTrack::from_seconds(&a_s, a_w),
        b: on_path(
            &spec.b,
            a_boot + start_s + offset_s,
            path,
            start_s,
            (&b_t, b_w),
        ),
        skew: path.skew_at(start_s + 0.5 * end),
        boot_s: a_boot,
        offset_s,
        path: path.clone(),
        loose_s: held
            .stretches
            .iter()
            .map(|(from, to)| (from + start_s + a_boot, to + start_s + a_boot))
            .collect(),
    }
}

/// Stamps a recording in true time by a clock that reads `zero_s` when true time
/// is zero, `start_s` into the path.
fn on_path(
    sensor: &Sensor,
    zero_s: f64,
    path: &ClockPath,
    start_s: f64,
    (t, w): (&[f64], Vec<Vec3>),
) -> GyroTrack {
    let at = |t: f64| sensor.stamp(t + path.drift_at(start_s + t));
    let first = at(t.first().copied().unwrap_or(0.0));
    GyroTrack {
        epoch_s: zero_s + first,
        t: t.iter().map(|&t| at(t) - first).collect(),
        w,
    }
}

/// End of the motion, seconds: that of the recording that ends first, unless the overlap is
/// partial on purpose.
fn moving_until(spec: &TwistSpec) -> f64 {
    if spec.b_starts_s > 1.0 {
        spec.duration_s + spec.b_starts_s
    } else {
        spec.duration_s
    }
}

/// Replaces the content of the chosen samples of a recording by that of `by_s` seconds earlier.
pub fn displace(track: &mut GyroTrack, by_s: f64, chosen: impl Fn(usize) -> bool) {
    let recorded = track.w.clone();
    if let Some(rates) = Uneven::new(&track.t, &recorded) {
        for k in (3..track.t.len().saturating_sub(3)).filter(|&k| chosen(k)) {
            track.w[k] = rates.value(track.t[k] - by_s);
        }
    }
}

/// Root of the mean square; 0 of no values.
pub fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| {
        (sum + value * value, count + 1.0)
    });
    f64::sqrt(sum / f64::max(count, 1.0))
}

/// Reads a CSV table with a header line, times in s and rates about x, y and z in rad/s.
///
/// # Errors
///
/// Fails if the file cannot be read, or is not such a table.
pub fn read_csv(path: &std::path::Path) -> std::io::Result<GyroTrack> {
    let wrong = || std::io::Error::new(std::io::ErrorKind::InvalidData, "not a table t, x, y, z");
    let mut times = Vec::new();
    let mut rates = Vec::new();
    for line in std::fs::read_to_string(path)?.lines().skip(1) {
        let row: Result<Vec<f64>, _> = line.split(',').map(str::parse).collect();
        let [t, x, y, z] = row
            .ok()
            .and_then(|row| row.try_into().ok())
            .ok_or_else(wrong)?;
        times.push(t);
        rates.push([x, y, z]);
    }
    Ok(GyroTrack::from_seconds(&times, rates))
}
