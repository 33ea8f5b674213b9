//! Prediction of the rate of the phone's clock against the board's.
//!
//! While a rig warms up, the rate of each of the two crystals changes by 0.1 to 5 ppm in ten minutes
//! (hil-sim/rig/ranges.md), fast at first and then ever more slowly. So the state has, beside offset
//! and skew, the *change* of the skew, which decays:
//!
//! ```text
//! change(t) = c · e^(−t/T)                  T = WARMING_S
//! skew(t)   = skew + c · T (1 − e^(−t/T))
//! offset(t) = offset + skew · t + c · (T t − T² (1 − e^(−t/T)))
//! ```
//!
//! A Kalman filter over the twists before a recording estimates the three ([`crate::twists`]).
//! One twist says nothing about the change. Two determine the skew between them to 0.06 ppm, three
//! and more the change too. `T` differs from rig to rig: it is known to a factor
//! ([`WARMING_FACTOR_LN`]), whose influence on a prediction is part of the stated uncertainty.

use crate::tracker::WARMING_S;
use nalgebra::{Matrix2, Matrix2x3, Matrix3, Vector2, Vector3};
use serde::{Deserialize, Serialize};
use twist_sync::mixture::{Supposed, mixed};

use crate::{BoardSeconds, ClockRelation, Wander};

/// 1-sigma of the logarithm of [`WARMING_S`]: a factor of two.
const WARMING_FACTOR_LN: f64 = std::f64::consts::LN_2;

/// Time over which a warming is quoted, s.
const TEN_MINUTES_S: f64 = 600.0;

/// Length of a recording for which the drift is planned and stated, s.
pub const PLANNED_S: f64 = 300.0;

/// Returns `T (1 − e^(−t/T))`: the skew gained in `t` seconds per unit of change.
fn skew_gain(t: f64) -> f64 {
    -WARMING_S * (-t / WARMING_S).exp_m1()
}

/// Returns `T t − T² (1 − e^(−t/T))`: the offset gained in `t` seconds per unit of change.
fn offset_gain(t: f64) -> f64 {
    WARMING_S * (t - skew_gain(t))
}

/// Returns the derivatives of the offset gained, the skew gained and the remaining change by the
/// logarithm of `T`.
fn gain_by_warming_time(t: f64) -> Vector3<f64> {
    let x = t / WARMING_S;
    let (gone, fading) = (-(-x).exp_m1(), x * (-x).exp());
    Vector3::new(
        WARMING_S * WARMING_S * (x - 2.0 * gone + fading),
        WARMING_S * (gone - fading),
        fading,
    )
}

/// Largest distance of two estimates that count as consistent, in sigmas of their difference.
pub(crate) const CONSISTENT_SIGMAS: f64 = 5.0;

/// Returns the warming in the first `since_s` seconds as a part of that in the first ten minutes.
#[must_use]
pub fn warming_share(since_s: f64) -> f64 {
    skew_gain(since_s) / skew_gain(TEN_MINUTES_S)
}

/// The rate of two clocks with its 1-sigma.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate {
    /// Rate of the phone's clock against the board's, minus one.
    pub skew: f64,
    /// 1-sigma of the skew.
    pub sigma: f64,
}

/// Agreement of a measurement with what was known before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Fit {
    /// Squared distance of the two, in variances of their difference.
    distance: f64,
    /// Logarithm of the measurement's likelihood, less a constant.
    pub(crate) likelihood_ln: f64,
}

impl Fit {
    fn new(distance: f64, variance: f64) -> Option<Self> {
        let is_valid = variance.is_normal() && variance > 0.0 && distance.is_finite();
        is_valid.then(|| Self {
            distance,
            likelihood_ln: -0.5 * (distance + variance.ln()),
        })
    }

    pub(crate) fn is_consistent(&self) -> bool {
        self.distance <= CONSISTENT_SIGMAS * CONSISTENT_SIGMAS
    }
}

/// Estimated change of the skew of two clocks while a rig warms up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RateChange {
    /// Change of the skew at the relation's reference, 1/s; it decays.
    pub per_s: f64,
    /// Variance of the change, 1/s².
    pub variance: f64,
    /// Covariance with the offset.
    pub with_offset: f64,
    /// Covariance with the skew, 1/s.
    pub with_skew: f64,
}

/// The relation of the clocks at the last twist, and the change of its skew.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Course {
    /// The relation at its reference.
    pub clock: ClockRelation,
    /// The change of its skew there.
    pub change: RateChange,
}

impl Course {
    /// Returns the course after one twist, of clocks whose skew changes by `warming` (1-sigma) in the
    /// first ten minutes.
    pub(crate) fn of_twist(clock: ClockRelation, warming: f64) -> Self {
        let change = RateChange {
            per_s: 0.0,
            variance: (warming / skew_gain(TEN_MINUTES_S)).powi(2),
            with_offset: 0.0,
            with_skew: 0.0,
        };
        Self { clock, change }
    }

    /// Returns the course joined with a later twist, and their agreement.
    pub(crate) fn with_twist(&self, twist: &ClockRelation) -> Option<(Self, Fit)> {
        let base = twist.offset;
        let (mean, covariance) = self.predicted(BoardSeconds(twist.reference), base);
        let observe = Matrix2x3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0);
        let seen = Matrix2::from(twist.covariance).transpose();
        let expected = observe * covariance * observe.transpose() + seen;
        let inverse = expected.try_inverse()?;
        let gain = covariance * observe.transpose() * inverse;
        let innovation = Vector2::new(0.0, twist.skew) - observe * mean;
        let fit = Fit::new(
            innovation.dot(&(inverse * innovation)),
            expected.determinant(),
        )?;
        let keep = Matrix3::identity() - gain * observe;
        // Joseph form: stays positive.
        let covariance = keep * covariance * keep.transpose() + gain * seen * gain.transpose();
        let mean = mean + gain * innovation;
        let course = Self::from_state(twist.reference, base, mean, covariance, twist.wander);
        Some((course, fit))
    }

    /// Returns the course joined with a skew that was known before, and their agreement.
    pub(crate) fn with_known_skew(&self, known: Rate) -> Option<(Self, Fit)> {
        let base = self.clock.offset;
        let (mean, covariance) = self.predicted(BoardSeconds(self.clock.reference), base);
        let variance = covariance[(1, 1)] + known.sigma * known.sigma;
        let innovation = known.skew - mean[1];
        let fit = Fit::new(innovation * innovation / variance, variance)?;
        let gain = covariance.column(1) / variance;
        let mean = mean + gain * innovation;
        let covariance = covariance - gain * covariance.row(1);
        let (reference, wander) = (self.clock.reference, self.clock.wander);
        let course = Self::from_state(reference, base, mean, covariance, wander);
        Some((course, fit))
    }

    /// Returns the mean and covariance of several courses with one reference, each with the logarithm
    /// of its likelihood.
    pub(crate) fn mixed<const N: usize>(parts: &[(Self, f64); N]) -> Self {
        const { assert!(N > 0) };
        let ClockRelation {
            reference,
            offset: base,
            wander,
            ..
        } = parts[0].0.clock;
        let parts = parts.map(|(course, likelihood_ln)| {
            let (mean, covariance) = course.predicted(BoardSeconds(reference), base);
            Supposed {
                prior: 1.0,
                likelihood_ln,
                mean,
                covariance,
            }
        });
        let (mean, covariance) = mixed(&parts);
        Self::from_state(reference, base, mean, covariance, wander)
    }

    /// Predicts the mean rate over [`PLANNED_S`] from a board time on.
    #[must_use]
    pub fn rate_from(&self, from: BoardSeconds) -> Rate {
        self.rate_over(from, PLANNED_S)
    }

    /// Predicts the mean rate over `length_s` seconds from a board time on.
    #[must_use]
    pub fn rate_over(&self, from: BoardSeconds, length_s: f64) -> Rate {
        let to = BoardSeconds(from.0 + length_s);
        let base = self.clock.offset;
        let (start, _) = self.predicted(from, base);
        let (end, _) = self.predicted(to, base);
        // The rate's error is that of skew and change, and the wander over the span.
        let since = from.0 - self.clock.reference;
        let of_change = (offset_gain(since + length_s) - offset_gain(since)) / length_s;
        let longer = gain_by_warming_time(since + length_s) - gain_by_warming_time(since);
        let of_time = WARMING_FACTOR_LN * longer[0] / length_s;
        let [_, [_, skew_variance]] = self.clock.covariance;
        let wander = self.clock.wander.diffusion() * (since.abs() + length_s / 3.0);
        let variance = skew_variance
            + 2.0 * of_change * self.change.with_skew
            + of_change * of_change * self.change.variance
            + self.change_squared() * of_time * of_time
            + wander;
        Rate {
            skew: (end[0] - start[0]) / length_s,
            sigma: variance.max(0.0).sqrt(),
        }
    }

    /// Returns the offset at a board time minus its extrapolation from `from` by the mean rate
    /// ([`Self::rate_from`]), s: a train of even pulses does not follow a rate that changes.
    pub(crate) fn bend(&self, from: BoardSeconds, at: BoardSeconds) -> f64 {
        let base = self.clock.offset;
        let (start, _) = self.predicted(from, base);
        let (then, _) = self.predicted(at, base);
        then[0] - start[0] - self.rate_from(from).skew * (at.0 - from.0)
    }

    /// Returns the 1-sigma of the offset at a board time, s.
    #[must_use]
    pub fn offset_sigma_at(&self, at: BoardSeconds) -> f64 {
        let (_, covariance) = self.predicted(at, self.clock.offset);
        covariance[(0, 0)].max(0.0).sqrt()
    }

    /// Predicts offset less a base, skew and change at a board time, with their covariance.
    fn predicted(&self, at: BoardSeconds, base: f64) -> (Vector3<f64>, Matrix3<f64>) {
        let (clock, change) = (&self.clock, &self.change);
        let t = at.0 - clock.reference;
        let mean = Vector3::new(clock.offset - base, clock.skew, change.per_s);
        let [[oo, os], [_, ss]] = clock.covariance;
        let (oc, sc) = (change.with_offset, change.with_skew);
        let covariance = Matrix3::new(oo, os, oc, os, ss, sc, oc, sc, change.variance);
        let fade = (-t / WARMING_S).exp();
        let step = Matrix3::new(
            1.0,
            t,
            offset_gain(t),
            0.0,
            1.0,
            skew_gain(t),
            0.0,
            0.0,
            fade,
        );
        let q = clock.wander.diffusion();
        let (span, cross) = (t.abs(), q * t.abs() * t / 2.0);
        let grown = q * span.powi(3) / 3.0;
        let wander = Matrix3::new(grown, cross, 0.0, cross, q * span, 0.0, 0.0, 0.0, 0.0);
        let longer = gain_by_warming_time(t) * WARMING_FACTOR_LN;
        let time = longer * longer.transpose() * self.change_squared();
        (
            step * mean,
            step * covariance * step.transpose() + time + wander,
        )
    }

    /// Returns the mean square of the change, 1/s².
    fn change_squared(&self) -> f64 {
        self.change.per_s.powi(2) + self.change.variance.max(0.0)
    }

    fn from_state(
        reference: f64,
        base: f64,
        mean: Vector3<f64>,
        covariance: Matrix3<f64>,
        wander: Wander,
    ) -> Self {
        let p = 0.5 * (covariance + covariance.transpose());
        Self {
            clock: ClockRelation {
                reference,
                offset: base + mean[0],
                skew: mean[1],
                covariance: [[p[(0, 0)], p[(0, 1)]], [p[(0, 1)], p[(1, 1)]]],
                wander,
            },
            change: RateChange {
                per_s: mean[2],
                variance: p[(2, 2)],
                with_offset: p[(0, 2)],
                with_skew: p[(1, 2)],
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 1 ppm in ten minutes, and pulses at the mean rate of five: they meet the frames at
    /// both ends, and are off in between.
    #[test]
    fn even_pulses_are_off_a_changing_rate_between_the_ends() {
        let clock = ClockRelation {
            reference: 100.0,
            offset: 36_000.0,
            skew: 20e-6,
            covariance: [[4e-12, 0.0], [0.0, 1e-14]],
            wander: Wander::default(),
        };
        let per_s = 1e-6 / skew_gain(TEN_MINUTES_S);
        let course = |per_s| Course {
            change: RateChange {
                per_s,
                ..Course::of_twist(clock, 1e-6).change
            },
            ..Course::of_twist(clock, 1e-6)
        };
        let warming = course(per_s);
        let bend = |course: &Course, s| course.bend(BoardSeconds(100.0), BoardSeconds(100.0 + s));
        assert!(bend(&warming, 0.0).abs() < 1e-12 && bend(&warming, PLANNED_S).abs() < 1e-12);
        let expected = offset_gain(150.0) - 0.5 * offset_gain(PLANNED_S);
        let middle = bend(&warming, 150.0);
        assert!((middle - per_s * expected).abs() < 1e-9, "{middle}");
        assert!((-60e-6..-15e-6).contains(&middle), "{middle}");
        assert!(bend(&course(0.0), 150.0).abs() < 1e-12);
    }

    #[test]
    fn a_known_skew_sharpens_the_relation_and_a_wrong_one_contradicts() {
        let wide = ClockRelation {
            reference: 100.0,
            offset: 36_000.0,
            skew: 20e-6,
            covariance: [[9e-12, 1e-12], [1e-12, 1e-12]],
            wander: Wander::default(),
        };
        let twist = Course::of_twist(wide, 0.0);
        let known = |skew| Rate { skew, sigma: 2e-8 };
        let (course, fit) = twist.with_known_skew(known(2.05e-5)).unwrap();
        assert!(fit.is_consistent());
        let sharp = course.clock;
        assert!((sharp.skew - 2.05e-5).abs() < 1e-9);
        assert!(sharp.covariance[1][1].sqrt() < 2.1e-8);
        // Correlation 1/3: the offset moves by cov/var of the skew's change.
        assert!((sharp.offset - wide.offset - 0.5e-6).abs() < 1e-8);
        assert!(sharp.covariance[0][0] < wide.covariance[0][0]);
        let (_, fit) = twist.with_known_skew(known(3e-5)).unwrap();
        assert!(!fit.is_consistent());
    }
}
