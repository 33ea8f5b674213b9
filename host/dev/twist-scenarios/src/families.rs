//! Families of twists whose parameters are drawn from ranges, each with one imperfection of
//! stamps, filters, axes or motion.
//!
//! A scenario ([`crate::scenarios`]) has one value of each parameter, and an estimator can be
//! fitted to it. The ranges here are those of loggers, phones and vehicles: rates of 50 to
//! 1000 Hz that differ between the two, recordings of 6 to 20 s, skews of up to 50 ppm.

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Exp1, StandardNormal};
use rand_pcg::Pcg64;
use twist_sync::Options;

use super::{Grip, Motion, Twist, TwistSpec, options, twist};

/// A family of twists.
pub struct Family {
    /// Name of the family.
    pub name: &'static str,
    /// Least part that must be accepted.
    pub accepted: f64,
    make: fn(&mut Pcg64, &mut TwistSpec) -> Stamps,
}

impl Family {
    /// Returns the recordings of one seed, the options that a user would give, and what the
    /// offset may be larger by, in seconds, after a step of clock b. The largest
    /// 1-sigma is 20 ms, so that a sigma that is too small shows.
    #[must_use]
    pub fn twist(&self, seed: u64) -> (Twist, Options, f64) {
        let mut rng = Pcg64::seed_from_u64(seed ^ 0xfa_3117);
        let mut spec = TwistSpec {
            duration_s: rng.random_range(6.0..20.0),
            skew_ppm: 50.0,
            ..TwistSpec::default()
        };
        spec.a.rate_hz = rng.random_range(100.0..1000.0);
        spec.b.rate_hz = rng.random_range(100.0..600.0);
        let stamps = (self.make)(&mut rng, &mut spec);
        let mut twist = twist(&spec, seed);
        stamps.apply(&mut rng, &mut twist);
        let options = Options {
            sigma_limit_s: 20e-3,
            b_jump_s: 0.0,
            ..options(&spec)
        };
        let also_s = if let Stamps::Step(by_s, _) = stamps {
            by_s
        } else {
            0.0
        };
        (twist, options, also_s)
    }
}

/// Error of the stamps of b.
#[derive(Clone, Copy)]
enum Stamps {
    Right,
    /// Cut (or rounded) to multiples of a step in seconds.
    Cut(f64),
    Rounded(f64),
    /// Late by an exponential time with this mean, seconds.
    Latency(f64),
    /// Delivered in batches of so many samples; each batch has one stamp, or its stamps are
    /// spread back to the batch before. Late by an exponential time with this mean, seconds.
    Batches {
        samples: usize,
        spread: bool,
        late_s: f64,
    },
    /// White noise: normal, or of Student's t with two degrees of freedom; 1-sigma or scale in
    /// seconds.
    White(f64),
    Heavy(f64),
    /// Sawtooth of this height whose resets are this far apart, by up to this part unevenly.
    Sawtooth {
        height_s: f64,
        period_s: f64,
        uneven: f64,
    },
    /// Swing of this amplitude and period, seconds.
    Swing(f64, f64),
    /// Step by this time at this part of the recording; either side is right.
    Step(f64, f64),
}

impl Stamps {
    fn apply(self, rng: &mut Pcg64, twist: &mut Twist) {
        let absolute = twist.b.epoch_s;
        let t = &mut twist.b.t;
        let exact = t.clone();
        let normal = |rng: &mut Pcg64| -> f64 { StandardNormal.sample(rng) };
        let exponential = |rng: &mut Pcg64| -> f64 { Exp1.sample(rng) };
        let mut mean_s = 0.0;
        match self {
            Self::Right => {}
            Self::Cut(q) | Self::Rounded(q) => {
                let half = if matches!(self, Self::Rounded(_)) {
                    0.5
                } else {
                    0.0
                };
                for t in t.iter_mut() {
                    *t = ((absolute + *t) / q + half).floor() * q - absolute;
                }
            }
            Self::Latency(late_s) => {
                let mut last = f64::NEG_INFINITY;
                mean_s = late_s;
                for t in t.iter_mut() {
                    // Samples are read in their order.
                    last = (*t + late_s * exponential(rng)).max(last + 20e-6);
                    *t = last;
                }
            }
            Self::Batches {
                samples,
                spread,
                late_s,
            } => {
                let step = (exact[exact.len() - 1] - exact[0]) / (exact.len() - 1) as f64;
                let mut before = exact[0] - step;
                mean_s = late_s
                    + if spread {
                        0.0
                    } else {
                        0.5 * step * (samples - 1) as f64
                    };
                for batch in t.chunks_mut(samples) {
                    let last = batch.len() - 1;
                    let at = (batch[last] + late_s * exponential(rng)).max(before + 20e-6);
                    for (k, t) in batch.iter_mut().enumerate() {
                        let back = (last - k) as f64 / (last + 1) as f64;
                        *t = if spread {
                            at - back * (at - before)
                        } else {
                            at
                        };
                    }
                    before = at;
                }
            }
            Self::White(scale_s) | Self::Heavy(scale_s) => {
                let most = 0.3 * (exact[1] - exact[0]);
                let is_heavy = matches!(self, Self::Heavy(_));
                for t in t.iter_mut() {
                    let noise = scale_s * normal(rng);
                    let noise = if is_heavy {
                        noise / exponential(rng).sqrt()
                    } else {
                        noise
                    };
                    *t += noise.clamp(-most, most);
                }
            }
            Self::Sawtooth {
                height_s,
                period_s,
                uneven,
            } => {
                let mut from = t[0] - period_s * rng.random::<f64>();
                let mut lasts = period_s;
                for t in t.iter_mut() {
                    while *t > from + lasts {
                        from += lasts;
                        lasts = period_s * (1.0 + uneven * rng.random_range(-1.0..1.0));
                    }
                    // The drift is even; the height of a reset follows from its distance.
                    *t += height_s * (0.5 * lasts - (*t - from)) / period_s;
                }
            }
            Self::Swing(amplitude_s, period_s) => {
                let phase = rng.random_range(0.0..std::f64::consts::TAU);
                for t in t.iter_mut() {
                    *t += amplitude_s * (std::f64::consts::TAU * *t / period_s + phase).sin();
                }
            }
            Self::Step(by_s, part) => {
                let at = (part * t.len() as f64) as usize;
                t[at..].iter_mut().for_each(|t| *t += by_s);
            }
        }
        // A mean delay cannot be seen.
        t.iter_mut().for_each(|t| *t -= mean_s);
    }
}

fn log_range(rng: &mut Pcg64, low: f64, high: f64) -> f64 {
    (low.ln() + (high / low).ln() * rng.random::<f64>()).exp()
}

fn near_whole(rng: &mut Pcg64, rates_hz: &[f64], ppm: f64) -> f64 {
    let rate = rates_hz[rng.random_range(0..rates_hz.len())];
    rate * (1.0 + 1e-6 * rng.random_range(-ppm..ppm))
}

/// A sawtooth of 20 µs to this height.
fn sawtooth(rng: &mut Pcg64, height_s: f64, (low_s, high_s): (f64, f64), uneven: f64) -> Stamps {
    Stamps::Sawtooth {
        height_s: log_range(rng, 20e-6, height_s),
        period_s: log_range(rng, low_s, high_s),
        uneven,
    }
}

/// Two gyroscopes on one vehicle, whose vibration has a frequency in this range, Hz.
fn vehicle(rng: &mut Pcg64, spec: &mut TwistSpec, vibration_hz: (f64, f64)) -> Stamps {
    spec.motion = Motion::Vehicle(
        rng.random_range(0.3..1.0),
        rng.random_range(0.02..0.1),
        vibration_hz,
    );
    spec.a.rate_hz = near_whole(rng, &[120.0], 200.0);
    spec.b.rate_hz = near_whole(rng, &[120.0], 200.0);
    Stamps::Right
}

/// All families.
#[must_use]
#[allow(clippy::too_many_lines)] // a table
pub fn families() -> Vec<Family> {
    let family = |name, accepted, make| Family {
        name,
        accepted,
        make,
    };
    vec![
        family("clean", 1.0, |_, _| Stamps::Right),
        family("weak, 0.5 to 1 rad/s", 1.0, |_, s| {
            s.motion = Motion::Twist(0.5, 1.0);
            Stamps::Right
        }),
        family("one axis", 1.0, |_, s| {
            s.motion = Motion::SingleAxis(1.5, 4.0);
            Stamps::Right
        }),
        family("noise times 5", 1.0, |_, s| {
            s.a.noise *= 5.0;
            s.b.noise *= 5.0;
            Stamps::Right
        }),
        family("walk", 0.9, |_, s| {
            s.motion = Motion::Natural(0.5, 1.5);
            Stamps::Right
        }),
        family("taps", 0.93, |rng, s| {
            s.motion = Motion::Taps(rng.random_range(2.0..6.0));
            Stamps::Right
        }),
        family("50 to 64 Hz", 0.95, |rng, s| {
            s.a.rate_hz = rng.random_range(50.0..64.0);
            s.b.rate_hz = rng.random_range(50.0..64.0);
            Stamps::Right
        }),
        family("low-pass of 10 to 42 Hz, delays given", 0.95, |rng, s| {
            s.b.filter_hz = Some([10.0, 20.0, 42.0][rng.random_range(0..3)]);
            s.b.filter_damping = rng.random_range(std::f64::consts::FRAC_1_SQRT_2..1.0);
            s.a.filter_hz = Some(188.0);
            Stamps::Right
        }),
        family("lost 0.5 to 8 %", 0.95, |rng, s| {
            s.b.lost = rng.random_range(0.005..0.08);
            Stamps::Right
        }),
        family("one axis late, 0.1 to 4 ms", 0.95, |rng, s| {
            s.b.axes_late_s[rng.random_range(0..3)] = log_range(rng, 0.1e-3, 4e-3);
            Stamps::Right
        }),
        family("axes in turn, 20 to 300 µs", 0.95, |rng, s| {
            let each = rng.random_range(20e-6..300e-6);
            s.b.axes_late_s = [-each, 0.0, each];
            Stamps::Right
        }),
        family("all axes late, 20 to 300 µs", 0.95, |rng, s| {
            let size = log_range(rng, 20e-6, 300e-6);
            let drawn: [f64; 3] = std::array::from_fn(|_| size * rng.random_range(-1.0..1.0));
            let mean = drawn.iter().sum::<f64>() / 3.0;
            s.b.axes_late_s = drawn.map(|late| late - mean);
            Stamps::Right
        }),
        family("ms stamps, near whole ms", 0.95, |rng, s| {
            s.b.rate_hz = near_whole(rng, &[50.0, 100.0, 200.0, 250.0, 500.0, 1000.0], 50.0);
            Stamps::Cut(1e-3)
        }),
        family("cut to 1 ms", 0.95, |_, _| Stamps::Cut(1e-3)),
        family("rounded to 1 ms, near whole ms", 0.95, |rng, s| {
            s.b.rate_hz = near_whole(rng, &[50.0, 100.0, 200.0, 250.0, 500.0], 300.0);
            Stamps::Rounded(1e-3)
        }),
        family("cut to 10 ms", 0.9, |rng, s| {
            s.b.rate_hz = rng.random_range(60.0..200.0);
            Stamps::Cut(10e-3)
        }),
        family("rounded to 10 ms", 0.9, |rng, s| {
            s.b.rate_hz = near_whole(rng, &[200.0, 100.0, 50.0], 300.0);
            Stamps::Rounded(10e-3)
        }),
        family("latency, exponential, 0.1 to 1.5 ms", 0.9, |rng, s| {
            s.b.rate_hz = rng.random_range(100.0..250.0);
            Stamps::Latency(log_range(rng, 0.1e-3, 1.5e-3))
        }),
        family("batches spread back", 0.9, |rng, s| {
            s.b.rate_hz = rng.random_range(100.0..400.0);
            let late_s = log_range(rng, 0.1e-3, 1.5e-3);
            Stamps::Batches {
                samples: rng.random_range(4..20),
                spread: true,
                late_s,
            }
        }),
        family("batches, one stamp each", 0.9, |rng, s| {
            s.b.rate_hz = rng.random_range(50.0..250.0);
            let late_s = log_range(rng, 0.1e-3, 1.5e-3);
            Stamps::Batches {
                samples: rng.random_range(3..11),
                spread: false,
                late_s,
            }
        }),
        family("white stamps, 10 to 300 µs", 0.95, |rng, _| {
            Stamps::White(log_range(rng, 10e-6, 300e-6))
        }),
        family("stamps by Student's t of 2", 0.9, |rng, _| {
            Stamps::Heavy(log_range(rng, 10e-6, 200e-6))
        }),
        family("uneven sampling, 10 to 300 µs", 0.95, |rng, s| {
            s.b.jitter_s = log_range(rng, 10e-6, 300e-6);
            Stamps::Right
        }),
        family("wander 2 to 6 µs, 1 to 4 s", 0.95, |rng, s| {
            s.b.wander_s = Some((log_range(rng, 2e-6, 6e-6), log_range(rng, 1.0, 4.0)));
            Stamps::Right
        }),
        family("wander 2 to 20 µs, 0.1 to 2 s", 0.95, |rng, s| {
            s.b.wander_s = Some((log_range(rng, 2e-6, 20e-6), log_range(rng, 0.1, 2.0)));
            Stamps::Right
        }),
        family("wander 20 to 300 µs, 0.1 to 2 s", 0.95, |rng, s| {
            s.b.wander_s = Some((log_range(rng, 20e-6, 300e-6), log_range(rng, 0.1, 2.0)));
            Stamps::Right
        }),
        family("swing of 5 to 50 µs in 3 to 15 s", 0.95, |rng, _| {
            Stamps::Swing(log_range(rng, 5e-6, 50e-6), rng.random_range(3.0..15.0))
        }),
        family("sawtooth 20 to 500 µs, even", 0.95, |rng, _| {
            sawtooth(rng, 500e-6, (0.3, 3.0), 0.0)
        }),
        family("sawtooth 20 to 500 µs, uneven by 20 %", 0.95, |rng, _| {
            sawtooth(rng, 500e-6, (0.3, 3.0), 0.2)
        }),
        family("sawtooth 20 to 100 µs of 3 to 20 s", 0.95, |rng, _| {
            sawtooth(rng, 100e-6, (3.0, 20.0), 0.0)
        }),
        family("clock step 0.3 to 50 ms", 0.4, |rng, _| {
            Stamps::Step(log_range(rng, 0.3e-3, 50e-3), rng.random_range(0.3..0.7))
        }),
        family("mount flexes, 15 to 40 Hz", 0.95, |_, s| {
            s.grip = Grip::Flexing(15.0, 40.0);
            Stamps::Right
        }),
        family("vehicle at 120 Hz, vibration aliased", 0.9, |rng, s| {
            vehicle(rng, s, (65.0, 115.0))
        }),
        family("vehicle at 120 Hz, vibration in the band", 0.9, |rng, s| {
            vehicle(rng, s, (10.0, 40.0))
        }),
    ]
}
