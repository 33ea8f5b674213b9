//! How the rate of the phone's clock against the board's goes on.
//!
//! Two crystals are not at rest while a rig warms up: by 0.1 to 5 ppm in ten minutes each
//! (docs/beliefs.md), fast at first and then ever more slowly. So beside offset and skew
//! there is the *change* of the skew, which dies away:
//!
//! ```text
//! change(t) = c · e^(−t/T)                  T = WARMING_S
//! skew(t)   = skew + c · T (1 − e^(−t/T))
//! offset(t) = offset + skew · t + c · (T t − T² (1 − e^(−t/T)))
//! ```
//!
//! A Kalman filter over the twists before a recording estimates the three. One twist knows
//! nothing of the change: it is 0 ± [`WARMING_PER_S`]. Two know the skew between them to
//! 0.06 ppm, three and more the change too.

use nalgebra::{Matrix2, Matrix2x3, Matrix3, Vector2, Vector3};

use recording::session_file::RateChange;
use timebase::{BoardSeconds, ClockModel, Wander};

/// 1-sigma of the change of the skew while a rig warms up, before any of it is known, 1/s:
/// two clocks that each move by 0.1 to 5 ppm in ten minutes, even in the logarithm, have
/// an rms of 2.5 ppm in ten minutes.
const WARMING_PER_S: f64 = 2.5e-6 / 600.0;

/// Time in which a rig warms up, s.
const WARMING_S: f64 = 300.0;

/// The drift is planned for, and stated of, so much of a recording, s.
pub const PLANNED_S: f64 = 300.0;

/// How far twists, or a skew known from before, may be from each other, in sigmas of both.
const CONSISTENT_SIGMAS: f64 = 5.0;

/// `T (1 − e^(−t/T))`: what a change makes of the skew in `t` seconds.
fn of_skew(t: f64) -> f64 {
    -WARMING_S * (-t / WARMING_S).exp_m1()
}

/// `T t − T² (1 − e^(−t/T))`: what it makes of the offset.
fn of_offset(t: f64) -> f64 {
    WARMING_S * (t - of_skew(t))
}

/// A rate with its 1-sigma.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate {
    /// Rate of the phone's clock against the board's, minus one.
    pub skew: f64,
    /// 1-sigma of it.
    pub sigma: f64,
}

/// The relation of the clocks at the last twist, and how its skew changes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Course {
    /// The relation at its reference.
    pub clock: ClockModel,
    /// The change of its skew there.
    pub change: RateChange,
}

impl Course {
    /// What one twist says.
    #[must_use]
    pub const fn of_twist(clock: ClockModel) -> Self {
        let change = RateChange {
            per_s: 0.0,
            variance: WARMING_PER_S * WARMING_PER_S,
            with_offset: 0.0,
            with_skew: 0.0,
        };
        Self { clock, change }
    }

    /// The same with a later twist; `None` if the two contradict each other.
    #[must_use]
    pub fn with_twist(&self, twist: &ClockModel) -> Option<Self> {
        let base = twist.offset;
        let (mean, covariance) = self.predicted(twist.reference, base);
        let observe = Matrix2x3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0);
        let seen = Matrix2::from(twist.covariance).transpose();
        let inverse = (observe * covariance * observe.transpose() + seen).try_inverse()?;
        let gain = covariance * observe.transpose() * inverse;
        let innovation = Vector2::new(0.0, twist.skew) - observe * mean;
        if innovation.dot(&(inverse * innovation)) > CONSISTENT_SIGMAS * CONSISTENT_SIGMAS {
            return None;
        }
        let keep = Matrix3::identity() - gain * observe;
        // Joseph form: stays positive.
        let covariance = keep * covariance * keep.transpose() + gain * seen * gain.transpose();
        let mean = mean + gain * innovation;
        Some(Self::of(
            twist.reference,
            base,
            mean,
            covariance,
            twist.wander,
        ))
    }

    /// The same with a skew that is known from before; `None` if the two contradict each
    /// other.
    #[must_use]
    pub fn with_known_skew(&self, skew: f64, sigma: f64) -> Option<Self> {
        let base = self.clock.offset;
        let (mean, covariance) = self.predicted(self.clock.reference, base);
        let variance = covariance[(1, 1)] + sigma * sigma;
        let innovation = skew - mean[1];
        if !variance.is_normal() || innovation.abs() > CONSISTENT_SIGMAS * variance.sqrt() {
            return None;
        }
        let gain = covariance.column(1) / variance;
        let mean = mean + gain * innovation;
        let covariance = covariance - gain * covariance.row(1);
        let (reference, wander) = (self.clock.reference, self.clock.wander);
        Some(Self::of(reference, base, mean, covariance, wander))
    }

    /// The mean rate over [`PLANNED_S`] from a board time on, with all that may change
    /// meanwhile.
    #[must_use]
    pub fn rate_from(&self, from: BoardSeconds) -> Rate {
        let to = BoardSeconds(from.0 + PLANNED_S);
        let base = self.clock.offset;
        let (start, _) = self.predicted(from, base);
        let (end, _) = self.predicted(to, base);
        // The rate's error is that of skew and change, and the wander over the span.
        let since = from.0 - self.clock.reference.0;
        let of_change = (of_offset(since + PLANNED_S) - of_offset(since)) / PLANNED_S;
        let [_, [_, skew_variance]] = self.clock.covariance;
        let wander = self.clock.wander.diffusion() * (since.abs() + PLANNED_S / 3.0);
        let variance = skew_variance
            + 2.0 * of_change * self.change.with_skew
            + of_change * of_change * self.change.variance
            + wander;
        Rate {
            skew: (end[0] - start[0]) / PLANNED_S,
            sigma: variance.max(0.0).sqrt(),
        }
    }

    /// 1-sigma of the offset at a board time, s.
    #[must_use]
    pub fn offset_sigma_at(&self, at: BoardSeconds) -> f64 {
        let (_, covariance) = self.predicted(at, self.clock.offset);
        covariance[(0, 0)].max(0.0).sqrt()
    }

    /// Offset less a base, skew and change at a board time, with their covariance.
    fn predicted(&self, at: BoardSeconds, base: f64) -> (Vector3<f64>, Matrix3<f64>) {
        let (clock, change) = (&self.clock, &self.change);
        let t = at.0 - clock.reference.0;
        let mean = Vector3::new(clock.offset - base, clock.skew, change.per_s);
        let [[oo, os], [_, ss]] = clock.covariance;
        let (oc, sc) = (change.with_offset, change.with_skew);
        let covariance = Matrix3::new(oo, os, oc, os, ss, sc, oc, sc, change.variance);
        let fade = (-t / WARMING_S).exp();
        let step = Matrix3::new(1.0, t, of_offset(t), 0.0, 1.0, of_skew(t), 0.0, 0.0, fade);
        let q = clock.wander.diffusion();
        let (span, cross) = (t.abs(), q * t.abs() * t / 2.0);
        let grown = q * span.powi(3) / 3.0;
        let wander = Matrix3::new(grown, cross, 0.0, cross, q * span, 0.0, 0.0, 0.0, 0.0);
        (step * mean, step * covariance * step.transpose() + wander)
    }

    fn of(
        reference: BoardSeconds,
        base: f64,
        mean: Vector3<f64>,
        covariance: Matrix3<f64>,
        wander: Wander,
    ) -> Self {
        let p = 0.5 * (covariance + covariance.transpose());
        Self {
            clock: ClockModel {
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

    /// A twist at `t` of clocks whose skew starts with 20 ppm and changes by `c` a second,
    /// dying away within `fades` seconds.
    fn twist(t: f64, c: f64, fades: f64) -> ClockModel {
        let gone = 1.0 - (-t / fades).exp();
        ClockModel {
            reference: BoardSeconds(t),
            offset: 36_000.0 + 20e-6 * t + c * (fades * t - fades * fades * gone),
            skew: 20e-6 + c * fades * gone,
            covariance: [[4e-12, 0.0], [0.0, 4e-13]],
            wander: Wander::from_ppm(0.01),
        }
    }

    fn course(c: f64, times: &[f64]) -> Course {
        let mut twists = times.iter().map(|&t| twist(t, c, WARMING_S));
        let first = Course::of_twist(twists.next().unwrap());
        twists.fold(first, |course, twist| course.with_twist(&twist).unwrap())
    }

    /// The mean skew of those clocks over five minutes from `from` on.
    fn true_rate(c: f64, from: f64) -> f64 {
        let offset = |t| twist(t, c, WARMING_S).offset - 36_000.0;
        (offset(from + PLANNED_S) - offset(from)) / PLANNED_S
    }

    #[test]
    fn one_twist_knows_nothing_of_the_change() {
        let one = course(0.0, &[100.0]);
        let rate = one.rate_from(BoardSeconds(110.0));
        assert!((rate.skew - 20e-6).abs() < 1e-15);
        // 0.63 ppm of the twist; 2.5 ppm in ten minutes until the middle of five minutes.
        assert!((0.7e-6..0.95e-6).contains(&rate.sigma), "{}", rate.sigma);
        let at = |t| one.offset_sigma_at(BoardSeconds(t));
        assert!((at(100.0) - 2e-6).abs() < 1e-9);
        assert!(at(160.0) > at(100.0) && at(40.0) > at(100.0));
    }

    #[test]
    fn two_twists_know_the_rate_between_them() {
        let two = course(0.0, &[100.0, 160.0]);
        assert!((two.clock.skew - 20e-6).abs() < 1e-12);
        let alone = course(0.0, &[160.0]);
        let sigma = |course: &Course| course.clock.covariance[1][1].sqrt();
        assert!(
            sigma(&alone) > 6e-7 && sigma(&two) < 1.6e-7,
            "{}",
            sigma(&two)
        );
        // Less the change, it is 2 µs · √2 over 60 s.
        let known = Course {
            change: RateChange {
                variance: 0.0,
                ..Course::of_twist(twist(0.0, 0.0, 1.0)).change
            },
            ..course(0.0, &[100.0])
        };
        let known = known.with_twist(&twist(160.0, 0.0, 1.0)).unwrap();
        assert!(
            (0.04e-6..0.06e-6).contains(&sigma(&known)),
            "{}",
            sigma(&known)
        );
    }

    #[test]
    fn three_twists_foresee_a_warming_rig() {
        // 1 ppm in ten minutes.
        let c = 1e-6 / of_skew(600.0);
        let errors = [
            &[20.0, 80.0][..],
            &[20.0, 80.0, 140.0],
            &[20.0, 140.0, 260.0],
        ]
        .map(|times| {
            let course = course(c, times);
            let from = times[times.len() - 1] + 10.0;
            let rate = course.rate_from(BoardSeconds(from));
            let error = (rate.skew - true_rate(c, from)).abs();
            assert!(error < 2.0 * rate.sigma, "{error} {rate:?}");
            (error, rate.sigma)
        });
        assert!(
            errors[1].0 < errors[0].0 && errors[2].0 < errors[1].0,
            "{errors:?}"
        );
        assert!(errors[2].1 < 0.5 * errors[0].1, "{errors:?}");
    }

    #[test]
    fn a_known_skew_sharpens_the_relation_and_a_wrong_one_is_refused() {
        let one = course(0.0, &[100.0]);
        let sharp = one.with_known_skew(20.5e-6, 2e-8).unwrap();
        assert!((sharp.clock.skew - 20.5e-6).abs() < 1e-9);
        assert!(sharp.clock.covariance[1][1].sqrt() < 2.1e-8);
        // It says nothing of how the skew goes on.
        assert_eq!(sharp.change.variance, one.change.variance);
        assert_eq!(one.with_known_skew(30e-6, 2e-8), None);
        // So is a twist that cannot be of the same clocks.
        let mut slipped = twist(160.0, 0.0, WARMING_S);
        slipped.offset += 2e-3;
        assert_eq!(one.with_twist(&slipped), None);
    }
}
