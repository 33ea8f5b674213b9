//! The twists before a recording, joined with each other and with a skew from earlier recordings.
//!
//! The warming of a rig is not known in advance: its clocks are steady, or move by ppm. A single
//! Gaussian that is wide enough for a warming rig mistakes, in a steady one, the noise of a twist's
//! own skew (0.6 ppm) for warming: 0.1 of the difference of two such skews, a minute apart,
//! extrapolated by five minutes, is 12 µs/min. So there are three hypotheses of the warming
//! ([`WARMINGS`]), each with its own Kalman filter ([`Course`]) and weighted by its predictions of
//! the later twists. The result is one [`Course`] with their mean and covariance.
//!
//! Two other ways of joining estimates exist for other questions. The twist after a recording is
//! joined with the relation from before it by [`twist_sync::ClockRelation::joined`]: nothing is
//! predicted from there on, so no hypothesis of the warming is needed, only the random walk that any
//! two clocks have. [`crate::tracker`] does not join twists: its hypotheses are about the
//! motion of a rate that is observed many times a second.

use crate::rates::{Course, Fit, Rate};
use crate::tracker::WARMING_S;
use crate::{BoardSeconds, ClockRelation};

/// Hypotheses of the skew's change in the first ten minutes, 1-sigma: none, some, much; equally
/// likely at first. Two clocks that each move by 0.1 to 5 ppm, even in the logarithm
/// (hil-sim/rig/ranges.md), have the rms of the three, 2.5 ppm.
const WARMINGS: [f64; 3] = [0.15e-6, 0.8e-6, 4.3e-6];

/// 1-sigma of the warming of a phone that begins to record: the phone is one of the two clocks with
/// that rms, and the probability that it begins to warm up is one half.
const BEGINS: f64 = 1.26e-6;

/// Returns the remaining warming of the two clocks (rms) as a part of that of a rig that was just
/// switched on. The board's crystal has been warming up since its reset or longer. The phone's
/// history is unknown: that it has been in use as long as the board is assumed to be as likely as
/// that it begins to warm up now.
fn warming_left(since_reset: BoardSeconds) -> f64 {
    let board = (-2.0 * since_reset.0.max(0.0) / WARMING_S).exp();
    let phone = 0.5 * (board + 1.0);
    (0.5 * (board + phone)).sqrt()
}

/// A skew from earlier recordings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownSkew {
    /// The skew with its present 1-sigma, apart from the warming since.
    pub rate: Rate,
    /// Possible warming since, as a multiple of that in the first ten minutes.
    pub warmed: f64,
}

/// The joint result of several twists.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Twists([Hypothesis; WARMINGS.len()]);

/// The clocks if their warming is the one of [`WARMINGS`].
#[derive(Clone, Copy, Debug, PartialEq)]
struct Hypothesis {
    warming: f64,
    course: Course,
    likelihood_ln: f64,
}

impl Twists {
    /// Returns the result of a first twist.
    #[must_use]
    pub fn new(clock: ClockRelation) -> Self {
        let left = warming_left(BoardSeconds(clock.reference));
        Self(WARMINGS.map(|warming| Hypothesis {
            warming,
            course: Course::of_twist(clock, warming * left),
            likelihood_ln: 0.0,
        }))
    }

    /// Joins a later twist; `None` if it contradicts the earlier ones.
    #[must_use]
    pub fn with(&self, twist: &ClockRelation) -> Option<Self> {
        self.updated(|hypothesis| hypothesis.course.with_twist(twist))
    }

    /// Joins a skew from earlier recordings; `None` if it contradicts the twists.
    #[must_use]
    pub fn with_known(&self, known: &KnownSkew) -> Option<Self> {
        self.updated(|hypothesis| {
            let sigma = known.rate.sigma.hypot(known.warmed * hypothesis.warming);
            let skew = known.rate.skew;
            hypothesis.course.with_known_skew(Rate { skew, sigma })
        })
    }

    fn updated(&self, join: impl Fn(&Hypothesis) -> Option<(Course, Fit)>) -> Option<Self> {
        let mut each = self.0;
        let mut is_consistent = false;
        for hypothesis in &mut each {
            let (course, fit) = join(hypothesis)?;
            hypothesis.course = course;
            hypothesis.likelihood_ln += fit.likelihood_ln;
            is_consistent |= fit.is_consistent();
        }
        is_consistent.then_some(Self(each))
    }

    /// Returns the mean and covariance of all hypotheses. However steady the clocks were, the phone
    /// may begin to warm up when it begins to record.
    #[must_use]
    pub fn course(&self) -> Course {
        let likely = |hypothesis: Hypothesis| (hypothesis.course, hypothesis.likelihood_ln);
        let mut course = Course::mixed(&self.0.map(likely));
        let least = Course::of_twist(course.clock, BEGINS).change.variance;
        course.change.variance = course.change.variance.max(least);
        course
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Wander;
    use crate::rates::PLANNED_S;

    /// A twist at `t` of clocks whose skew starts with 20 ppm and changes by `c` a second,
    /// decaying within `fades` seconds.
    fn twist(t: f64, c: f64, fades: f64) -> ClockRelation {
        let gone = 1.0 - (-t / fades).exp();
        ClockRelation {
            reference: t,
            offset: 36_000.0 + 20e-6 * t + c * (fades * t - fades * fades * gone),
            skew: 20e-6 + c * fades * gone,
            covariance: [[4e-12, 0.0], [0.0, 4e-13]],
            wander: Wander::from_ppm(0.01),
        }
    }

    fn twists(c: f64, times: &[f64]) -> Twists {
        let mut each = times.iter().map(|&t| twist(t, c, WARMING_S));
        let first = Twists::new(each.next().unwrap());
        each.fold(first, |known, twist| known.with(&twist).unwrap())
    }

    fn course(c: f64, times: &[f64]) -> Course {
        twists(c, times).course()
    }

    /// The mean skew of those clocks over five minutes from `from` on.
    fn true_rate(c: f64, from: f64) -> f64 {
        let offset = |t| twist(t, c, WARMING_S).offset - 36_000.0;
        (offset(from + PLANNED_S) - offset(from)) / PLANNED_S
    }

    #[test]
    fn one_twist_says_nothing_about_the_change() {
        let one = course(0.0, &[0.0]);
        let rate = one.rate_from(BoardSeconds(10.0));
        assert!((rate.skew - 20e-6).abs() < 1e-15);
        // 0.63 ppm of the twist; 2.5 ppm in ten minutes are 1.1 on the average of the next
        // five, and more or less where it dies away more slowly or faster.
        assert!((1.2e-6..1.5e-6).contains(&rate.sigma), "{}", rate.sigma);
        let at = |t| one.offset_sigma_at(BoardSeconds(t));
        assert!((at(0.0) - 2e-6).abs() < 1e-9);
        assert!(at(60.0) > at(0.0) && at(-60.0) > at(0.0));
        // The phone may still be warming up, however long the board has run.
        let change = |t| course(0.0, &[t]).change.variance.sqrt();
        let left = [600.0, 1e6].map(|t| change(t) / change(0.0));
        assert!(left[0] < 0.55 && (left[1] - 0.5).abs() < 1e-3, "{left:?}");
    }

    #[test]
    fn two_twists_determine_the_rate_between_them() {
        let two = course(0.0, &[100.0, 160.0]);
        assert!((two.clock.skew - 20e-6).abs() < 1e-12);
        let sigma = |course: &Course| course.clock.covariance[1][1].sqrt();
        let alone = course(0.0, &[160.0]);
        assert!(
            sigma(&alone) > 6e-7 && sigma(&two) < 3e-7,
            "{}",
            sigma(&two)
        );
        // Less the change, it is 2 µs · √2 over 60 s.
        let still = Course::of_twist(twist(100.0, 0.0, 1.0), 0.0);
        let (still, _) = still.with_twist(&twist(160.0, 0.0, 1.0)).unwrap();
        assert!(
            (0.04e-6..0.06e-6).contains(&sigma(&still)),
            "{}",
            sigma(&still)
        );
    }

    /// Two twists whose own skews differ by their noise: the less it is taken for warming,
    /// the less a steady rig drifts.
    #[test]
    fn the_noise_of_two_twists_is_hardly_mistaken_for_warming() {
        let mut second = twist(170.0, 0.0, WARMING_S);
        second.skew += 0.6e-6;
        let one = Twists::new(twist(100.0, 0.0, WARMING_S));
        let mixed = one.with(&second).unwrap().course();
        let strong = Course::of_twist(twist(100.0, 0.0, WARMING_S), 2.5e-6);
        let (strong, _) = strong.with_twist(&second).unwrap();
        assert!(mixed.change.per_s > 0.0 && mixed.change.per_s < 0.8 * strong.change.per_s);
        // A change that is plain is taken as it is.
        let plain = course(4e-8, &[100.0, 220.0, 340.0]);
        let expected = 4e-8 * (-340.0_f64 / WARMING_S).exp();
        assert!(
            (plain.change.per_s / expected - 1.0).abs() < 0.15,
            "{plain:?}"
        );
    }

    #[test]
    fn three_twists_predict_a_warming_rig() {
        // 1 ppm in ten minutes.
        let c = 1e-6 / (WARMING_S * (1.0 - (-600.0 / WARMING_S).exp()));
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
        // What the phone may do from now on is left: 1.3 ppm in ten minutes.
        assert!((0.5e-6..0.6e-6).contains(&errors[2].1), "{errors:?}");
    }

    #[test]
    fn a_known_skew_sharpens_the_relation_and_a_wrong_one_is_refused() {
        let one = twists(0.0, &[100.0]);
        let known = |skew, warmed| KnownSkew {
            rate: Rate { skew, sigma: 2e-8 },
            warmed,
        };
        let sharp = one.with_known(&known(20.5e-6, 0.0)).unwrap().course();
        assert!((sharp.clock.skew - 20.5e-6).abs() < 1e-9);
        assert!(sharp.clock.covariance[1][1].sqrt() < 2.1e-8);
        // It says nothing of how the skew goes on.
        let (then, now) = (one.course().change.variance, sharp.change.variance);
        assert!((now / then - 1.0).abs() < 1e-6, "{now} {then}");
        assert_eq!(one.with_known(&known(30e-6, 0.0)), None);
        // It counts for less once the rig may have warmed up, and even less where it says
        // itself that it has.
        let aged = |skew| one.with_known(&known(skew, 0.8)).unwrap().course();
        let sigma = |course: &Course| course.clock.covariance[1][1].sqrt();
        let (near, far) = (aged(20.2e-6), aged(23e-6));
        assert!((1e-7..6e-7).contains(&sigma(&near)), "{}", sigma(&near));
        assert!(
            sigma(&far) > sigma(&near) && far.clock.skew < 21e-6,
            "{far:?}"
        );
        assert!(far.change.variance > near.change.variance);
        // So is a twist that cannot be of the same clocks.
        let mut slipped = twist(160.0, 0.0, WARMING_S);
        slipped.offset += 2e-3;
        assert_eq!(one.with(&slipped), None);
    }
}
