//! Motion from formulas: rest, a twist by hand, hand-held walking.
//!
//! The orientation is three Euler angles (z-y-x: yaw, pitch, roll), each a sum
//! of sines at incommensurate frequencies, so that a gesture never repeats and
//! its correlation with a shifted copy has one peak. The angular rate follows
//! from the angles' exact derivatives:
//!
//! ```text
//! x = roll' - yaw' sin(pitch)
//! y = pitch' cos(roll) + yaw' cos(pitch) sin(roll)
//! z = -pitch' sin(roll) + yaw' cos(pitch) cos(roll)
//! ```
//!
//! The acceleration of the rig in the world is a sum of sines of its own;
//! gravity is turned into the rig's axes by the same angles.
//!
//! A gesture fades in and out over [`FADE`] seconds by a quintic step (two
//! continuous derivatives). All functions are those of the `libm` crate, which
//! gives the same bits on every machine.

use std::sync::{Arc, PoisonError, RwLock};

use libm::{cos, sin};

use super::{STANDARD_GRAVITY, Step};
use crate::random::Random;

/// Time in which a gesture fades in, and in which it fades out, in seconds.
pub const FADE: f64 = 0.7;

/// A kind of motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Gesture {
    /// Lies still and level.
    Rest,
    /// Twisted by hand about all three axes: peaks of 2 to 4 rad/s, 0.4 to 2.2 Hz.
    Twist,
    /// As strong as the one twist that is published: its peaks are 1.14, 0.37 and 0.015 rad/s.
    WeakTwist,
    /// The same about one axis alone.
    OneAxisTwist,
    /// Carried while walking: about two steps a second, with the sway and
    /// tremor of the hands.
    Walk,
}

/// `amplitude · sin(harmonic · phase + shift)`.
#[derive(Clone, Copy, Debug)]
struct Term {
    amplitude: f64,
    harmonic: f64,
    shift: f64,
}

/// A sum of sines of one phase, which may itself be modulated.
#[derive(Clone, Debug, Default)]
struct Sum(Vec<Term>);

impl Sum {
    /// Value, and derivative by the phase.
    fn at(&self, phase: f64) -> (f64, f64) {
        let (mut value, mut slope) = (0.0, 0.0);
        for term in &self.0 {
            let (s, c) = libm::sincos(term.harmonic * phase + term.shift);
            value += term.amplitude * s;
            slope += term.amplitude * term.harmonic * c;
        }
        (value, slope)
    }

    fn value(&self, phase: f64) -> f64 {
        let mut value = 0.0;
        for term in &self.0 {
            value += term.amplitude * sin(term.harmonic * phase + term.shift);
        }
        value
    }
}

/// A gesture with all its details drawn.
#[derive(Clone, Debug, Default)]
struct Drawn {
    /// Roll, pitch, yaw as functions of time.
    free: [Sum; 3],
    /// Roll, pitch, yaw as functions of the gait's phase.
    gait: [Sum; 3],
    /// World acceleration x, y, z as a function of the gait's phase, m/s².
    force: [Sum; 3],
    /// The gait's phase is `2 pi stride_hz t + irregularity(t)`.
    stride_hz: f64,
    irregularity: Sum,
}

/// Angles, their rates, and the world acceleration at one time.
#[derive(Clone, Copy, Debug, Default)]
struct Pose {
    angle: [f64; 3],
    rate: [f64; 3],
    force: [f64; 3],
}

const TAU: f64 = core::f64::consts::TAU;

/// Peaks of a twist, rad/s, and of the published one.
const STRONG: (f64, f64) = (3.3, 3.8);
const PUBLISHED: [f64; 3] = [1.14, 0.37, 0.015];

/// A wave given by frequency and the amplitude of its *rate*.
fn wave(random: &mut Random, hz: (f64, f64), rate: f64) -> Term {
    let omega = TAU * random.uniform(hz.0, hz.1);
    Term {
        amplitude: rate / omega,
        harmonic: omega,
        shift: random.uniform(0.0, TAU),
    }
}

impl Drawn {
    /// Draws a gesture; `None` for rest.
    fn new(gesture: Gesture, random: &mut Random) -> Option<Self> {
        match gesture {
            Gesture::Rest => None,
            Gesture::Twist => Some(Self::twist(random, None)),
            Gesture::WeakTwist => Some(Self::twist(random, Some(PUBLISHED))),
            Gesture::OneAxisTwist => Some(Self::twist(random, Some([PUBLISHED[0], 0.0, 0.0]))),
            Gesture::Walk => Some(Self::walk(random)),
        }
    }

    fn twist(random: &mut Random, peaks: Option<[f64; 3]>) -> Self {
        let mut drawn = Self::default();
        for axis in &mut drawn.free {
            for band in 0..6 {
                let low = 0.4 + 0.3 * f64::from(band);
                axis.0.push(wave(random, (low, low + 0.3), 1.0));
            }
        }
        let strong = [0; 3].map(|_| random.uniform(STRONG.0, STRONG.1));
        let target = peaks.unwrap_or(strong);
        // Scale each axis until its peak over two minutes is the one drawn. The
        // axes mix a little, so this takes a few rounds.
        let mut scale = [1.0; 3];
        let unscaled: Vec<Pose> = (0..12_000)
            .map(|k| drawn.pose(f64::from(k) * 0.01))
            .collect();
        for _ in 0..6 {
            let mut peak = [0.0f64; 3];
            for pose in &unscaled {
                let mut pose = *pose;
                for (axis, scale) in scale.into_iter().enumerate() {
                    pose.angle[axis] *= scale;
                    pose.rate[axis] *= scale;
                }
                for (peak, rate) in peak.iter_mut().zip(pose.body_rate()) {
                    *peak = peak.max(rate.abs());
                }
            }
            for ((scale, target), peak) in scale.iter_mut().zip(target).zip(peak) {
                *scale *= target / peak.max(f64::MIN_POSITIVE);
            }
        }
        for (axis, scale) in drawn.free.iter_mut().zip(scale) {
            for term in &mut axis.0 {
                term.amplitude *= scale;
            }
        }
        // Hands that turn an axis less hold it more quietly.
        drawn.add_tremor(random, target.map(|peak| (peak / STRONG.0).min(1.0)));
        drawn
    }

    fn walk(random: &mut Random) -> Self {
        let mut drawn = Self {
            stride_hz: random.uniform(0.85, 1.0),
            ..Self::default()
        };
        for _ in 0..3 {
            drawn.irregularity.0.push(Term {
                amplitude: random.uniform(0.2, 0.5),
                harmonic: TAU * random.uniform(0.03, 0.25),
                shift: random.uniform(0.0, TAU),
            });
        }
        let mut gait = |amplitude: f64, harmonic: f64| Term {
            amplitude: amplitude * random.uniform(0.8, 1.2),
            harmonic,
            shift: random.uniform(0.0, TAU),
        };
        drawn.gait = [
            Sum(vec![gait(0.060, 1.0), gait(0.012, 3.0)]),
            Sum(vec![gait(0.030, 2.0), gait(0.008, 4.0)]),
            Sum(vec![gait(0.070, 1.0), gait(0.010, 2.0)]),
        ];
        drawn.force = [
            Sum(vec![gait(1.0, 2.0), gait(0.4, 4.0)]),
            Sum(vec![gait(0.8, 1.0), gait(0.3, 3.0)]),
            Sum(vec![gait(2.5, 2.0), gait(0.8, 4.0)]),
        ];
        for axis in &mut drawn.free {
            for band in 0..3 {
                let low = 0.25 + 0.5 * f64::from(band);
                axis.0.push(wave(random, (low, low + 0.5), 0.10));
            }
        }
        // Looking around: slow turns of up to a radian.
        drawn.free[2].0.push(wave(random, (0.04, 0.08), 0.35));
        drawn.add_tremor(random, [1.0; 3]);
        drawn
    }

    /// The tremor of hands: 8 to 12 Hz, some hundredths of a rad/s.
    fn add_tremor(&mut self, random: &mut Random, shares: [f64; 3]) {
        for (axis, share) in self.free.iter_mut().zip(shares) {
            axis.0.push(wave(random, (8.0, 10.0), 0.02 * share));
            axis.0.push(wave(random, (10.0, 12.0), 0.015 * share));
        }
    }

    fn pose(&self, t: f64) -> Pose {
        let mut pose = Pose::default();
        let (irregularity, irregular_rate) = self.irregularity.at(t);
        let phase = TAU * self.stride_hz * t + irregularity;
        let phase_rate = TAU * self.stride_hz + irregular_rate;
        for axis in 0..3 {
            let (free, free_rate) = self.free[axis].at(t);
            let (gait, gait_slope) = self.gait[axis].at(phase);
            pose.angle[axis] = free + gait;
            pose.rate[axis] = free_rate + gait_slope * phase_rate;
            pose.force[axis] = self.force[axis].value(phase);
        }
        pose
    }
}

impl Pose {
    /// Returns the angular rate about the rig's axes.
    fn body_rate(&self) -> [f64; 3] {
        let [roll, pitch, _] = self.angle;
        let [roll_rate, pitch_rate, yaw_rate] = self.rate;
        let (sr, cr) = libm::sincos(roll);
        let (sp, cp) = libm::sincos(pitch);
        [
            roll_rate - yaw_rate * sp,
            pitch_rate * cr + yaw_rate * cp * sr,
            -pitch_rate * sr + yaw_rate * cp * cr,
        ]
    }

    /// World acceleration plus the reaction to gravity, in the rig's axes.
    fn body_force(&self) -> [f64; 3] {
        let [roll, pitch, yaw] = self.angle;
        let (sr, cr) = (sin(roll), cos(roll));
        let (sp, cp) = (sin(pitch), cos(pitch));
        let (sy, cy) = (sin(yaw), cos(yaw));
        let [x, y, z] = [
            self.force[0],
            self.force[1],
            self.force[2] + STANDARD_GRAVITY,
        ];
        // Undo yaw, then pitch, then roll.
        let (x, y) = (cy * x + sy * y, -sy * x + cy * y);
        let (x, z) = (cp * x - sp * z, sp * x + cp * z);
        let (y, z) = (cr * y + sr * z, -sr * y + cr * z);
        [x, y, z]
    }
}

/// Quintic step from 0 at 0 to 1 at 1, and its derivative.
fn step(x: f64) -> (f64, f64) {
    if x <= 0.0 {
        (0.0, 0.0)
    } else if x >= 1.0 {
        (1.0, 0.0)
    } else {
        let x2 = x * x;
        (
            x2 * x * (10.0 + x * (6.0 * x - 15.0)),
            30.0 * x2 * (x - 1.0) * (x - 1.0),
        )
    }
}

/// One gesture of a performance.
#[derive(Clone, Debug)]
struct Act {
    from: f64,
    until: f64,
    drawn: Drawn,
}

impl Act {
    /// Amplitude and its derivative.
    fn envelope(&self, t: f64) -> (f64, f64) {
        let (up, up_slope) = step((t - self.from) / FADE);
        let (down, down_slope) = step((self.until - t) / FADE);
        (up * down, (up_slope * down - up * down_slope) / FADE)
    }

    fn pose(&self, t: f64) -> Pose {
        let (loud, loud_slope) = self.envelope(t);
        let mut pose = self.drawn.pose(t - self.from);
        for axis in 0..3 {
            pose.rate[axis] = pose.rate[axis] * loud + pose.angle[axis] * loud_slope;
            pose.angle[axis] *= loud;
            pose.force[axis] *= loud;
        }
        pose
    }
}

/// The motion of the rig: a sequence of gestures with all details drawn, and those that were added
/// while it runs.
#[derive(Debug)]
pub struct Motion {
    acts: Vec<Act>,
    added: RwLock<Vec<Act>>,
}

impl Motion {
    /// Returns a motion at rest.
    #[must_use]
    pub fn rest() -> Arc<Self> {
        Arc::new(Self {
            acts: Vec::new(),
            added: RwLock::default(),
        })
    }

    /// The steps one after the other from time zero on; rest after the last,
    /// unless that one has no end.
    #[must_use]
    pub fn new(steps: &[Step], mut random: Random) -> Self {
        let mut acts = Vec::new();
        let mut from = 0.0;
        for step in steps {
            let until = step.seconds.map_or(f64::INFINITY, |s| from + s);
            if let Some(drawn) = Drawn::new(step.gesture, &mut random) {
                acts.push(Act { from, until, drawn });
            }
            from = until;
        }
        Self {
            acts,
            added: RwLock::default(),
        }
    }

    /// Adds a gesture to what moves the rig already, from a true time on for some seconds.
    pub fn add(&self, gesture: Gesture, from: f64, seconds: f64, random: &mut Random) {
        let until = from + seconds;
        if let Some(drawn) = Drawn::new(gesture, random) {
            let mut added = self.added.write().unwrap_or_else(PoisonError::into_inner);
            added.push(Act { from, until, drawn });
        }
    }

    /// Returns angles, rates and forces of all gestures that are performed at a time.
    fn pose(&self, t: f64) -> Option<Pose> {
        let is_now = |act: &&Act| act.from < t && t < act.until;
        let added = self.added.read().unwrap_or_else(PoisonError::into_inner);
        let acts = self.acts.iter().find(is_now).into_iter();
        let acts = acts.chain(added.iter().filter(is_now));
        acts.map(|act| act.pose(t)).reduce(|mut all, pose| {
            for axis in 0..3 {
                all.angle[axis] += pose.angle[axis];
                all.rate[axis] += pose.rate[axis];
                all.force[axis] += pose.force[axis];
            }
            all
        })
    }

    /// Angular rate about the rig's axes at true time `t`, in rad/s.
    #[must_use]
    pub fn angular_rate(&self, t: f64) -> [f64; 3] {
        self.pose(t).map_or([0.0; 3], |p| p.body_rate())
    }

    /// Specific force (what an accelerometer measures: acceleration minus
    /// gravity) along the rig's axes at true time `t`, in m/s². At rest it is
    /// `[0, 0, 9.80665]`.
    #[must_use]
    pub fn specific_force(&self, t: f64) -> [f64; 3] {
        self.pose(t)
            .map_or([0.0, 0.0, STANDARD_GRAVITY], |p| p.body_force())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Seed, Stream};
    use nalgebra::{Rotation3, Vector3};

    fn performance(gesture: Gesture, seed: u64) -> Motion {
        Motion::new(
            &[Step {
                gesture,
                seconds: None,
            }],
            Seed(seed).stream(Stream::Motion),
        )
    }

    #[test]
    fn rest_is_gravity_and_nothing_else() {
        let p = performance(Gesture::Rest, 1);
        assert_eq!(p.angular_rate(3.0), [0.0; 3]);
        assert_eq!(p.specific_force(3.0), [0.0, 0.0, STANDARD_GRAVITY]);
    }

    #[test]
    fn a_twist_peaks_at_2_to_4_rad_per_second_about_each_axis_in_any_10_s() {
        for seed in 0..20 {
            let p = performance(Gesture::Twist, seed);
            for window in 0..10 {
                let mut peak = [0.0f64; 3];
                for k in 0..1000 {
                    let t = 1.0 + f64::from(window) * 10.0 + f64::from(k) * 0.01;
                    let w = p.angular_rate(t);
                    for axis in 0..3 {
                        peak[axis] = peak[axis].max(w[axis].abs());
                    }
                }
                for axis in peak {
                    assert!((2.0..4.0).contains(&axis), "seed {seed}: {peak:?}");
                }
            }
        }
    }

    /// The rate is the derivative of the orientation: integrating it in small
    /// steps gives the orientation that the gravity vector shows.
    #[test]
    fn rate_and_orientation_agree() {
        for gesture in [Gesture::Twist, Gesture::Walk] {
            let mut p = performance(gesture, 5);
            // Without acceleration only gravity is left.
            p.acts[0].drawn.force = Default::default();
            let mut r = Rotation3::identity();
            let h = 1e-4;
            for k in 0..40_000 {
                let w = p.angular_rate((f64::from(k) + 0.5) * h);
                r *= Rotation3::new(Vector3::from(w) * h);
            }
            let seen = Vector3::from(p.specific_force(4.0));
            let integrated = r.inverse() * Vector3::new(0.0, 0.0, STANDARD_GRAVITY);
            assert!((seen - integrated).norm() < 1e-4, "{gesture:?}");
        }
    }

    #[test]
    fn gestures_begin_and_end_smoothly() {
        let steps = [
            (Gesture::Rest, Some(2.0)),
            (Gesture::Twist, Some(5.0)),
            (Gesture::Walk, None),
        ]
        .map(|(gesture, seconds)| Step { gesture, seconds });
        let p = Motion::new(&steps, Seed(2).stream(Stream::Motion));
        assert_eq!(p.angular_rate(1.99), [0.0; 3]);
        assert!(p.angular_rate(4.0).iter().any(|w| w.abs() > 0.1));
        // No step larger than what the fade allows, anywhere.
        let mut last = p.angular_rate(0.0);
        for k in 1..100_000 {
            let w = p.angular_rate(f64::from(k) * 1e-4);
            for axis in 0..3 {
                assert!((w[axis] - last[axis]).abs() < 0.02, "at {k}");
            }
            last = w;
        }
    }

    #[test]
    fn walking_shakes_at_the_rhythm_of_steps() {
        let p = performance(Gesture::Walk, 8);
        let n = 6000;
        let mean: f64 = (0..n)
            .map(|k| p.specific_force(5.0 + f64::from(k) * 0.01)[2])
            .sum::<f64>()
            / f64::from(n);
        let sd = ((0..n)
            .map(|k| (p.specific_force(5.0 + f64::from(k) * 0.01)[2] - mean).powi(2))
            .sum::<f64>()
            / f64::from(n))
        .sqrt();
        assert!((mean - STANDARD_GRAVITY).abs() < 0.5, "{mean}");
        assert!((1.0..4.0).contains(&sd), "{sd}");
    }

    /// By a Hann-windowed Fourier sum: no line between 20 and 100 Hz reaches a
    /// millionth of the power of the twist's strongest.
    #[test]
    fn a_twist_is_band_limited() {
        let p = performance(Gesture::Twist, 3);
        let n = 4096;
        let samples: Vec<f64> = (0..n)
            .map(|k| p.angular_rate(2.0 + f64::from(k) / 400.0)[0])
            .collect();
        let power = |hz: f64| {
            let (mut re, mut im) = (0.0, 0.0);
            for (k, x) in samples.iter().enumerate() {
                let window = 0.5 - 0.5 * (TAU * k as f64 / f64::from(n)).cos();
                let angle = TAU * hz * k as f64 / 400.0;
                re += window * x * angle.cos();
                im += window * x * angle.sin();
            }
            re * re + im * im
        };
        let low = (1..30)
            .map(|k| power(f64::from(k) * 0.1))
            .fold(0.0, f64::max);
        let high = (0..160)
            .map(|k| power(20.0 + f64::from(k) * 0.5))
            .fold(0.0, f64::max);
        assert!(high < 1e-6 * low, "{high} against {low}");
    }
}
