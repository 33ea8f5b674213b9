//! A three-axis inertial sensor: from the rig's motion to its readings.
//!
//! The same model serves the board's IMU and the phone's, gyroscopes and
//! accelerometers. In this order: rotation into the sensor's axes, low-pass with
//! a stated bandwidth and group delay, noise (white, through the same low-pass),
//! scale error, bias with a random walk. Quantisation is a function of its own
//! ([`quantise`]).
//!
//! # The low-pass
//!
//! Data sheets state two numbers for a low-pass: its -3 dB bandwidth and its
//! delay. The model has exactly these two: a Gaussian kernel of the stated
//! bandwidth, shifted by the stated delay. Its group delay is the same at all
//! frequencies, which makes it a ground truth to measure against. The true filters'
//! shape is not documented; it cannot be a plain causal one, as the table of
//! the MPU-9150 shows (at 5 Hz a single pole would already delay by 31.8 ms,
//! the table says 18.6 ms). With the slow settings the kernel therefore reaches
//! into the future of the motion, which a simulated motion allows.
//!
//! The signal is sampled at [`TAPS`] points of the kernel, whose response is a
//! Gaussian up to ten times the bandwidth. The noise is drawn once for each
//! internal sample of the sensor and filtered there, so that samples that lie
//! closer than the filter's memory have correlated noise, as real ones do.

use std::collections::VecDeque;

use nalgebra::{Rotation3, Vector3};

use crate::random::Random;

/// Bandwidth and delay of a low-pass, as a data sheet states them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LowPass {
    /// Frequency at which the response is -3 dB (a factor of `sqrt(1/2)`), in Hz.
    pub bandwidth_hz: f64,
    /// Group delay, in seconds.
    pub delay_s: f64,
}

/// Half the number of points at which the kernel samples the signal.
const HALF: i32 = 6;
/// Points at which the kernel samples the signal: 13, out to three standard
/// deviations.
pub const TAPS: usize = 2 * HALF as usize + 1;
/// Spacing of these points, in standard deviations of the kernel.
const TAP_DISTANCE: f64 = 0.5;
/// Standard deviation of the kernel times its -3 dB frequency. For a whole
/// Gaussian `exp(-2 (pi sigma f)^2) = sqrt(1/2)` gives `sqrt(ln 2) / (2 pi)` =
/// 0.132505; truncated at three standard deviations it is this (solved for
/// these [`TAPS`]; a test measures it).
const SIGMA_TIMES_BANDWIDTH: f64 = 0.132_970_264;

/// Imperfections of a sensor's three axes, in the sensor's unit of measure
/// (rad/s for a gyroscope, m/s² for an accelerometer).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChannelConfig {
    /// Turns a vector given in the rig's axes into the sensor's axes.
    pub rotation: Rotation3<f64>,
    /// Fraction by which each axis reads too much.
    pub scale_error: [f64; 3],
    /// Reading at rest, at power-on.
    pub bias: [f64; 3],
    /// Random walk of the bias, in units per square root of a second.
    pub bias_walk: f64,
    /// White noise, in units per square root of a hertz (one-sided density).
    pub noise_density: f64,
}

impl ChannelConfig {
    /// A perfect sensor along the rig's axes.
    #[must_use]
    pub fn ideal() -> Self {
        Self {
            rotation: Rotation3::identity(),
            scale_error: [0.0; 3],
            bias: [0.0; 3],
            bias_walk: 0.0,
            noise_density: 0.0,
        }
    }
}

/// A three-axis sensor.
#[derive(Clone, Debug)]
pub struct Channel {
    config: ChannelConfig,
    low_pass: LowPass,
    /// Nominal distance of internal samples, in seconds.
    tick_s: f64,
    weights: [f64; TAPS],
    noise: Noise,
    bias: [f64; 3],
    last_tick: Option<u64>,
    random: Random,
}

/// White noise on the internal samples, and the kernel on them.
#[derive(Clone, Debug)]
struct Noise {
    kernel: Vec<f64>,
    /// Standard deviation of one internal sample.
    sigma: f64,
    /// The newest internal samples, the last of which is number `end - 1`.
    window: VecDeque<[f64; 3]>,
    end: u64,
}

impl Channel {
    /// Creates a sensor with internal samples every `tick_s` seconds, whose random numbers come
    /// from `random`.
    #[must_use]
    pub fn new(config: ChannelConfig, low_pass: LowPass, tick_s: f64, random: Random) -> Self {
        let mut channel = Self {
            config,
            low_pass,
            tick_s,
            weights: tap_weights(),
            noise: Noise {
                kernel: Vec::new(),
                sigma: 0.0,
                window: VecDeque::new(),
                end: 0,
            },
            bias: config.bias,
            last_tick: None,
            random,
        };
        channel.set_filter(low_pass, tick_s);
        channel
    }

    /// Changes the low-pass and the distance of internal samples. Numbering of
    /// internal samples may begin again.
    pub(crate) fn set_filter(&mut self, low_pass: LowPass, tick_s: f64) {
        self.low_pass = low_pass;
        self.tick_s = tick_s;
        let sigma_ticks = SIGMA_TIMES_BANDWIDTH / low_pass.bandwidth_hz / tick_s;
        let reach = (3.0 * sigma_ticks).ceil().clamp(0.0, 4000.0) as i32;
        let kernel: Vec<f64> = (-reach..=reach)
            .map(|k| gaussian(f64::from(k) / sigma_ticks.max(1e-9)))
            .collect();
        let sum: f64 = kernel.iter().sum();
        self.noise.kernel = kernel.into_iter().map(|w| w / sum).collect();
        // One-sided density d on samples of rate 1/tick: variance d²/(2·tick).
        self.noise.sigma = self.config.noise_density * (0.5 / tick_s).sqrt();
        self.restart();
    }

    /// Forgets the numbering of internal samples (the sensor was off).
    pub fn restart(&mut self) {
        self.noise.window.clear();
        self.noise.end = 0;
        self.last_tick = None;
    }

    /// The sensor's reading at true time `at` (seconds), which is its internal
    /// sample number `tick`. `tick_s` is the distance of internal samples as it
    /// truly is: with a clock that runs fast, the filter is faster too.
    /// `signal` gives the rig's motion, in the rig's axes, at any true time.
    ///
    /// Ticks must not go back, except after [`Channel::restart`].
    pub fn sample(
        &mut self,
        at: f64,
        tick: u64,
        tick_s: f64,
        mut signal: impl FnMut(f64) -> [f64; 3],
    ) -> [f64; 3] {
        let stretch = tick_s / self.tick_s;
        let step = TAP_DISTANCE * SIGMA_TIMES_BANDWIDTH / self.low_pass.bandwidth_hz * stretch;
        let middle = at - self.low_pass.delay_s * stretch;
        let mut sum = Vector3::zeros();
        for (k, weight) in (-HALF..=HALF).zip(self.weights) {
            sum += Vector3::from(signal(middle + f64::from(k) * step)) * weight;
        }
        let turned = self.config.rotation * sum;
        let noise = self.noise.at(tick, &mut self.random);
        if self.config.bias_walk > 0.0 {
            let ticks = tick.saturating_sub(self.last_tick.unwrap_or(tick));
            let size = self.config.bias_walk * (ticks as f64 * tick_s).sqrt();
            for (bias, step) in self.bias.iter_mut().zip(self.random.normal3()) {
                *bias += size * step;
            }
        }
        self.last_tick = Some(tick);
        [0, 1, 2]
            .map(|i| (turned[i] + noise[i]) * (1.0 + self.config.scale_error[i]) + self.bias[i])
    }
}

impl Noise {
    /// Filtered noise at internal sample `tick`.
    fn at(&mut self, tick: u64, random: &mut Random) -> [f64; 3] {
        if self.sigma <= 0.0 {
            return [0.0; 3];
        }
        let length = self.kernel.len();
        let end = tick + length as u64;
        // Samples that no kernel will use are not drawn.
        let missing = end.saturating_sub(self.end).min(length as u64);
        for _ in 0..missing {
            self.window.push_back(random.normal3());
        }
        self.end = self.end.max(end);
        while self.window.len() > length {
            self.window.pop_front();
        }
        let mut sum = [0.0; 3];
        for (weight, sample) in self.kernel.iter().zip(&self.window) {
            for axis in 0..3 {
                sum[axis] += weight * sample[axis];
            }
        }
        sum.map(|s| s * self.sigma)
    }
}

/// Returns a Gaussian of standard deviation one, not normalised.
fn gaussian(x: f64) -> f64 {
    libm::exp(-0.5 * x * x)
}

/// Weights of the points at which the kernel samples the signal; their sum is one.
fn tap_weights() -> [f64; TAPS] {
    let mut weights = [0.0; TAPS];
    for (k, weight) in (-HALF..=HALF).zip(&mut weights) {
        *weight = gaussian(f64::from(k) * TAP_DISTANCE);
    }
    let sum: f64 = weights.iter().sum();
    weights.map(|w| w / sum)
}

/// The nearest count of a converter of 16 bits with `per_unit` counts a unit;
/// halves go away from zero, values beyond the ends stay at the ends.
#[must_use]
pub fn quantise(value: f64, per_unit: f64) -> i16 {
    // `as` saturates and maps NaN to zero.
    (value * per_unit).round() as i16
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Seed, Stream};
    use core::f64::consts::{FRAC_1_SQRT_2, TAU};

    const PASS: LowPass = LowPass {
        bandwidth_hz: 188.0,
        delay_s: 1.9e-3,
    };

    fn channel(config: ChannelConfig, low_pass: LowPass) -> Channel {
        Channel::new(config, low_pass, 1e-3, Seed(1).stream(Stream::ImuGyro))
    }

    /// Amplitude and phase delay (seconds) of the response to a sine.
    fn response(low_pass: LowPass, hz: f64) -> (f64, f64) {
        let mut c = channel(ChannelConfig::ideal(), low_pass);
        let signal = |t: f64| [(TAU * hz * t).sin(), 0.0, 0.0];
        // Correlate over whole periods with the sine and cosine.
        let n = 4000u64;
        let step = 20.0 / hz / n as f64;
        let (mut s, mut q) = (0.0, 0.0);
        for k in 0..n {
            let t = 10.0 + k as f64 * step;
            let y = c.sample(t, k, 1e-3, signal)[0];
            s += y * (TAU * hz * t).sin();
            q += y * (TAU * hz * t).cos();
        }
        let amplitude = 2.0 * s.hypot(q) / n as f64;
        let delay = (-q).atan2(s) / (TAU * hz);
        (amplitude, delay)
    }

    #[test]
    fn bandwidth_and_delay_are_the_stated_ones() {
        for (bandwidth_hz, delay_s) in [(188.0, 1.9e-3), (5.0, 18.6e-3), (256.0, 0.98e-3)] {
            let pass = LowPass {
                bandwidth_hz,
                delay_s,
            };
            let (amplitude, _) = response(pass, bandwidth_hz);
            assert!((amplitude - FRAC_1_SQRT_2).abs() < 1e-4, "{amplitude}");
            for fraction in [0.01, 0.1, 0.3, 0.9] {
                let (_, delay) = response(pass, fraction * bandwidth_hz);
                assert!((delay - delay_s).abs() < 1e-9, "{delay}");
            }
            let (low, _) = response(pass, 0.01 * bandwidth_hz);
            assert!((low - 1.0).abs() < 1e-3);
            for times in [3.0, 5.0, 10.0] {
                let (high, _) = response(pass, times * bandwidth_hz);
                assert!(high < 0.06, "{times}: {high}");
            }
        }
    }

    #[test]
    fn noise_has_the_stated_density_and_the_filters_bandwidth() {
        let density = 1e-4;
        let config = ChannelConfig {
            noise_density: density,
            ..ChannelConfig::ideal()
        };
        for bandwidth_hz in [188.0, 20.0] {
            let mut c = channel(
                config,
                LowPass {
                    bandwidth_hz,
                    ..PASS
                },
            );
            let n = 40_000u64;
            let mut sum = 0.0;
            let (mut last, mut neighbours) = (0.0, 0.0);
            for k in 0..n {
                let x = c.sample(k as f64 * 1e-3, k, 1e-3, |_| [0.0; 3])[2];
                sum += x * x;
                neighbours += x * last;
                last = x;
            }
            // Noise bandwidth of a Gaussian low-pass: 1.064 times its -3 dB
            // frequency (sqrt(pi / ln 2) / 2).
            let expected = density * (1.0645 * bandwidth_hz).sqrt();
            let measured = (sum / n as f64).sqrt();
            assert!(
                (measured / expected - 1.0).abs() < 0.06,
                "{measured} {expected}"
            );
            // A slow filter makes neighbouring samples alike.
            let correlation = neighbours / sum;
            assert_eq!(correlation > 0.9, bandwidth_hz < 50.0, "{correlation}");
        }
    }

    #[test]
    fn skipping_internal_samples_keeps_the_noise_as_large() {
        let config = ChannelConfig {
            noise_density: 1e-4,
            ..ChannelConfig::ideal()
        };
        let rms = |stride: u64| {
            let mut c = channel(config, PASS);
            let n = 20_000;
            let sum: f64 = (0..n)
                .map(|k| c.sample(0.0, k * stride, 1e-3, |_| [0.0; 3])[0].powi(2))
                .sum();
            (sum / n as f64).sqrt()
        };
        assert!((rms(2) / rms(1) - 1.0).abs() < 0.05);
        assert!((rms(100) / rms(1) - 1.0).abs() < 0.05);
    }

    #[test]
    fn rotation_scale_and_bias_come_in_order() {
        let config = ChannelConfig {
            // A quarter turn about z: the rig's x is the sensor's y.
            rotation: Rotation3::from_axis_angle(&Vector3::z_axis(), TAU / 4.0),
            scale_error: [0.0, 0.01, 0.0],
            bias: [0.1, 0.2, 0.3],
            ..ChannelConfig::ideal()
        };
        let y = channel(config, PASS).sample(0.0, 0, 1e-3, |_| [2.0, 0.0, 1.0]);
        for (axis, expected) in [0.1, 2.0 * 1.01 + 0.2, 1.3].into_iter().enumerate() {
            assert!((y[axis] - expected).abs() < 1e-12, "{y:?}");
        }
    }

    #[test]
    fn a_fast_clock_makes_a_fast_filter() {
        let mut c = channel(ChannelConfig::ideal(), PASS);
        // A ramp shows the delay directly.
        let slow = c.sample(1.0, 0, 1e-3, |t| [t, 0.0, 0.0])[0];
        let fast = c.sample(1.0, 1, 0.5e-3, |t| [t, 0.0, 0.0])[0];
        assert!((slow - (1.0 - 1.9e-3)).abs() < 1e-12);
        assert!((fast - (1.0 - 0.95e-3)).abs() < 1e-12);
    }

    #[test]
    fn bias_walks_with_the_root_of_time() {
        let config = ChannelConfig {
            bias_walk: 1e-3,
            ..ChannelConfig::ideal()
        };
        let n = 300;
        let mut sum = 0.0;
        for seed in 0..n {
            let mut c = Channel::new(config, PASS, 1e-3, Seed(seed).stream(Stream::ImuGyro));
            for k in 0..100 {
                c.sample(0.0, k * 1000, 1e-3, |_| [0.0; 3]);
            }
            sum += c.bias[0].powi(2);
        }
        let measured = (sum / n as f64).sqrt();
        assert!(
            (measured / (1e-3 * 99f64.sqrt()) - 1.0).abs() < 0.15,
            "{measured}"
        );
    }
}
