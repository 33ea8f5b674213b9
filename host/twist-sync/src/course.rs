//! The relation over time, joined from estimates: a Kalman filter and a
//! Rauch–Tung–Striebel smoother over the state (offset, skew), where the skew walks
//! at random with the given [`Wander`].
//!
//! Limits: a jump of a clock within the recording is not modelled; estimates that
//! contradict the others by more than [`CONTRADICTION`] sigmas are left out and
//! counted.

use crate::clock::{ClockRelation, State, Wander};

/// Innovation beyond which an estimate is left out, in sigmas.
pub(crate) const CONTRADICTION: f64 = 6.0;

/// The clock relation over a whole recording.
#[derive(Debug, Clone, PartialEq)]
pub struct ClockCourse {
    /// Filtered (past only) states at the estimates, in time order.
    filtered: Vec<ClockRelation>,
    /// Smoothed (all data) states at the same times.
    smoothed: Vec<ClockRelation>,
    /// Number of estimates that are used.
    pub used: usize,
    /// Number of estimates that contradict the rest.
    pub contradicting: usize,
}

impl ClockCourse {
    /// Joins estimates of one pair of clocks (windows, or a few twists).
    ///
    /// `None` if there are none.
    #[must_use]
    pub fn from_estimates(estimates: &[ClockRelation], wander: Wander) -> Option<Self> {
        let mut sorted = estimates.to_vec();
        sorted.sort_by(|a, b| a.reference.total_cmp(&b.reference));
        let base = sorted.first()?.offset;
        let mut filtered: Vec<(f64, State)> = Vec::new();
        let mut contradicting = 0;
        for estimate in &sorted {
            let at = estimate.reference;
            let measured = State::of(estimate, base);
            let next = match filtered.last() {
                None => measured,
                Some((before, last)) => {
                    let forward = last.predicted(at - before, wander);
                    let Some((updated, square)) = forward.updated(&measured) else {
                        continue;
                    };
                    if square.is_nan() || square > CONTRADICTION * CONTRADICTION {
                        contradicting += 1;
                        continue;
                    }
                    updated
                }
            };
            filtered.push((at, next));
        }
        let mut smoothed = filtered.clone();
        for i in (0..filtered.len() - 1).rev() {
            let dt = filtered[i + 1].0 - filtered[i].0;
            smoothed[i].1 = filtered[i].1.improved(&smoothed[i + 1].1, dt, wander);
        }
        let relations = |states: &[(f64, State)]| {
            states
                .iter()
                .map(|(at, state)| state.relation(base, *at, wander))
                .collect()
        };
        Some(Self {
            filtered: relations(&filtered),
            smoothed: relations(&smoothed),
            used: filtered.len(),
            contradicting,
        })
    }

    /// The same course, but where the clocks were followed ([`crate::tracker::followed`]):
    /// there it is what came of that, which knows all estimates.
    #[must_use]
    pub fn with_followed(mut self, knots: &[ClockRelation]) -> Self {
        let (Some(first), Some(last)) = (knots.first(), knots.last()) else {
            return self;
        };
        let is_beyond =
            |own: &ClockRelation| own.reference < first.reference || own.reference > last.reference;
        for own in [&mut self.filtered, &mut self.smoothed] {
            own.retain(is_beyond);
            let place = own.partition_point(|own| own.reference < first.reference);
            own.splice(place..place, knots.iter().copied());
        }
        self
    }

    /// The relation at a time of clock a, from all data: between the estimates the
    /// bridge of the two nearest, outside a prediction.
    #[must_use]
    pub fn at(&self, at: f64) -> ClockRelation {
        let after = self.smoothed.partition_point(|m| m.reference <= at);
        match (after.checked_sub(1), self.smoothed.get(after)) {
            (None, _) => self.smoothed[0].referenced_at(at),
            (Some(last), None) => self.smoothed[last].referenced_at(at),
            (Some(before), Some(next)) => {
                let (base, wander) = (next.offset, next.wander);
                let here = State::of(&self.filtered[before].referenced_at(at), base);
                here.improved(&State::of(next, base), next.reference - at, wander)
                    .relation(base, at, wander)
            }
        }
    }

    /// The same course where all times of clock a are later by `a_s` and offsets larger by
    /// `between_s`.
    pub(crate) fn moved(mut self, a_s: f64, between_s: f64) -> Self {
        for relation in self.filtered.iter_mut().chain(&mut self.smoothed) {
            *relation = relation.moved(a_s, between_s);
        }
        self
    }

    /// The time of clock a at a time of clock b, both in seconds.
    #[must_use]
    pub fn b_to_a(&self, b: f64) -> f64 {
        // Twice: the offset changes by the skew, at most 10⁻³, times the first one's error.
        let near = self.smoothed[0].b_to_a(b);
        let near = b - self.at(near).offset;
        b - self.at(near).offset
    }

    /// First and last time of clock a with data.
    #[must_use]
    pub fn span(&self) -> (f64, f64) {
        (
            self.smoothed[0].reference,
            self.smoothed[self.smoothed.len() - 1].reference,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn estimate(at: f64, offset: f64, sigma: f64) -> ClockRelation {
        ClockRelation {
            reference: at,
            offset,
            skew: 0.0,
            covariance: [[sigma * sigma, 0.0], [0.0, 1e-10]],
            wander: Wander::from_ppm(0.02),
        }
    }

    #[test]
    fn a_straight_line_is_found_and_the_end_is_predicted() {
        let wander = Wander::from_ppm(0.01);
        let truth = |t: f64| 1e5 + 20e-6 * t;
        let estimates: Vec<ClockRelation> = (0..30)
            .map(|k| estimate(10.0 * f64::from(k), truth(10.0 * f64::from(k)), 10e-6))
            .collect();
        let course = ClockCourse::from_estimates(&estimates, wander).unwrap();
        assert_eq!((course.used, course.contradicting), (30, 0));
        let middle = course.at(155.0);
        assert!((middle.offset - truth(155.0)).abs() < 3e-6);
        let (inside, outside) = (
            middle.covariance[0][0].sqrt(),
            course.at(600.0).covariance[0][0].sqrt(),
        );
        assert!(
            inside < 5e-6 && outside > 2.0 * inside,
            "{inside} {outside}"
        );
    }

    #[test]
    fn a_window_that_contradicts_is_left_out() {
        let mut estimates: Vec<ClockRelation> = (0..20)
            .map(|k| estimate(10.0 * f64::from(k), 5.0, 5e-6))
            .collect();
        estimates[11].offset += 1e-3;
        let course = ClockCourse::from_estimates(&estimates, Wander::from_ppm(0.02)).unwrap();
        assert_eq!((course.used, course.contradicting), (19, 1));
        assert!((course.at(110.0).offset - 5.0).abs() < 5e-6);
    }

    #[test]
    fn the_bridge_is_continuous() {
        let estimates: Vec<ClockRelation> = (0..5)
            .map(|k| estimate(20.0 * f64::from(k), 3e-6 * f64::from(k * k), 5e-6))
            .collect();
        let course = ClockCourse::from_estimates(&estimates, Wander::from_ppm(0.05)).unwrap();
        for k in 1..4 {
            let t = 20.0 * f64::from(k);
            let (below, above) = (course.at(t - 1e-6), course.at(t + 1e-6));
            assert!((below.offset - above.offset).abs() < 1e-9);
            assert!((below.covariance[0][0] - above.covariance[0][0]).abs() < 1e-13);
        }
    }
}
