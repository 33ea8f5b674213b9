//! The relation over time, joined from estimates: a Kalman filter and a
//! Rauch–Tung–Striebel smoother over the state (offset, skew), where the skew walks
//! at random with the given [`Wander`].
//!
//! A clock may step, and an estimate may be wrong. So the estimates are cut into segments,
//! each with a relation of its own, such that the total cost is least: the squares of the
//! innovations, [`CONTRADICTION`]² for an estimate that is left out, and
//! [`STEP_COST`] for a segment (optimal partitioning, Jackson et al. 2005). A segment has
//! at least two estimates: a single one that contradicts the rest counts as wrong.

mod error;
mod recording;
mod search;
mod together;

pub use self::error::CourseError;
pub use self::recording::{
    Prior, RecordingClock, RefusedWindows, course_of_tracks, estimate_course,
};
use crate::clock::{ClockRelation, State, Wander, WithSigma};

/// Innovation beyond which an estimate is left out, in sigmas.
pub(crate) const CONTRADICTION: f64 = 6.0;
/// Cost of a segment, as a sum of squares: more than leaving out one estimate, less than
/// leaving out two.
const STEP_COST: f64 = 60.0;
/// With more estimates than this, a segment begins only where the squared innovation from one
/// estimate to the next is above [`NOTABLE`].
const MOST_BEGINNINGS: usize = 1000;
const NOTABLE: f64 = 6.0;

/// A step of one clock against the other.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct ClockStep {
    /// Earliest time of the step, in seconds of clock a.
    pub from_s: f64,
    /// Latest time of the step, in seconds of clock a.
    pub to_s: f64,
    /// Change of the offset (b − a) in seconds.
    pub by: WithSigma,
}

/// A stretch whose data contradict the relation, or in which there is motion but no accepted
/// estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Unsupported {
    /// Begin, in seconds of clock a.
    pub from_s: f64,
    /// End, in seconds of clock a.
    pub to_s: f64,
    /// 1-sigma in seconds that is added to that of the offset within the stretch, as a root of
    /// the sum of squares.
    pub sigma_s: f64,
}

/// A stretch of time in which no clock stepped, with its estimates (at least one).
#[derive(Debug, Clone, PartialEq)]
struct Segment {
    /// Filtered (past only) states at the estimates, in time order.
    filtered: Vec<ClockRelation>,
    /// Smoothed (all data) states at the same times.
    smoothed: Vec<ClockRelation>,
}

/// The clock relation over a whole recording: offset and skew at every instant.
#[derive(Debug, Clone, PartialEq)]
pub struct ClockCourse {
    segments: Vec<Segment>,
    /// Steps between the segments, in order of time.
    pub steps: Vec<ClockStep>,
    /// Stretches over which the relation is not supported, with a larger sigma.
    pub unsupported: Vec<Unsupported>,
    /// Part of the offset's 1-sigma that all estimates share, in seconds. Every sigma of the
    /// course includes it.
    pub common_s: f64,
    /// Number of estimates in the segments.
    pub used: usize,
    /// Number of estimates left out because they contradict the rest.
    pub contradicting: usize,
}

/// A segment under construction, from the estimate `begin` on.
struct Growing {
    begin: usize,
    /// Cost of all before it.
    before: f64,
    cost: f64,
    used: usize,
    last: (f64, State),
}

impl Growing {
    fn new(begin: usize, before: f64, estimate: &ClockRelation, base: f64) -> Self {
        Self {
            begin,
            before,
            cost: STEP_COST,
            used: 1,
            last: (estimate.reference, State::from_relation(estimate, base)),
        }
    }

    /// Extends the segment by the next estimate. Returns false if that contradicts the segment
    /// and is left out.
    fn extend(&mut self, estimate: &ClockRelation, base: f64, wander: Wander) -> bool {
        let (at, state) = self.last;
        let forward = state.predicted(estimate.reference - at, wander);
        let updated = forward.updated(&State::from_relation(estimate, base));
        let limit = CONTRADICTION * CONTRADICTION;
        match updated.filter(|(_, square)| *square <= limit) {
            Some((next, square)) => {
                self.cost += square;
                self.used += 1;
                self.last = (estimate.reference, next);
                true
            }
            None => {
                self.cost += limit;
                false
            }
        }
    }
}

/// Cuts estimates, in order of time, into segments; returns begin and end of each.
fn partition(sorted: &[ClockRelation], base: f64, wander: Wander) -> Vec<(usize, usize)> {
    let may_begin = |k: usize| {
        k == 0 || sorted.len() <= MOST_BEGINNINGS || {
            let before = Growing::new(k - 1, 0.0, &sorted[k - 1], base);
            let (at, state) = before.last;
            let forward = state.predicted(sorted[k].reference - at, wander);
            let updated = forward.updated(&State::from_relation(&sorted[k], base));
            updated.is_none_or(|(_, square)| square > NOTABLE)
        }
    };
    // Cheapest way to explain all before each estimate, and the segment that ends there.
    let mut cheapest: Vec<(f64, Option<usize>)> = vec![(0.0, None)];
    let mut growing: Vec<Growing> = Vec::new();
    for (k, estimate) in sorted.iter().enumerate() {
        let before = cheapest[k].0;
        // One that costs more already will not become cheaper than a segment from here.
        growing.retain(|own| own.before + own.cost <= before + 2.0 * STEP_COST);
        for own in &mut growing {
            own.extend(estimate, base, wander);
        }
        if may_begin(k) {
            growing.push(Growing::new(k, before, estimate, base));
        }
        let ends = growing.iter().filter(|own| own.used > 1);
        let best = ends.map(|own| (own.before + own.cost, Some(own.begin)));
        let left_out = (before + CONTRADICTION * CONTRADICTION, None);
        cheapest.push(best.fold(left_out, |x, y| if y.0 < x.0 { y } else { x }));
    }
    let mut segments = Vec::new();
    let mut end = sorted.len();
    while end > 0 {
        if let Some(begin) = cheapest[end].1 {
            segments.push((begin, end));
            end = begin;
        } else {
            end -= 1;
        }
    }
    segments.reverse();
    segments
}

impl Segment {
    fn new(estimates: &[ClockRelation], base: f64, wander: Wander) -> Option<Self> {
        let mut growing = Growing::new(0, 0.0, estimates.first()?, base);
        let mut filtered = vec![growing.last];
        for estimate in &estimates[1..] {
            if growing.extend(estimate, base, wander) {
                filtered.push(growing.last);
            }
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
        })
    }

    fn first(&self) -> &ClockRelation {
        &self.smoothed[0]
    }

    fn last(&self) -> &ClockRelation {
        &self.smoothed[self.smoothed.len() - 1]
    }

    fn at(&self, at: f64) -> ClockRelation {
        let after = self.smoothed.partition_point(|m| m.reference <= at);
        match (after.checked_sub(1), self.smoothed.get(after)) {
            (None, _) => self.first().referenced_at(at),
            (Some(last), None) => self.smoothed[last].referenced_at(at),
            (Some(before), Some(next)) => {
                let (base, wander) = (next.offset, next.wander);
                let here = State::from_relation(&self.filtered[before].referenced_at(at), base);
                here.improved(
                    &State::from_relation(next, base),
                    next.reference - at,
                    wander,
                )
                .relation(base, at, wander)
            }
        }
    }
}

impl ClockCourse {
    /// Joins estimates of one pair of clocks (of windows of a recording, or of a few twists).
    ///
    /// Returns `None` without estimates, or if at least half as many contradict as agree.
    #[must_use]
    pub fn from_estimates(estimates: &[ClockRelation], wander: Wander) -> Option<Self> {
        let mut sorted = estimates.to_vec();
        sorted.sort_by(|a, b| a.reference.total_cmp(&b.reference));
        let base = sorted.first()?.offset;
        let parts = match sorted.len() {
            1 => vec![(0, 1)],
            _ => partition(&sorted, base, wander),
        };
        let segment =
            |&(begin, end): &(usize, usize)| Segment::new(&sorted[begin..end], base, wander);
        let segments: Vec<Segment> = parts.iter().filter_map(segment).collect();
        let used = segments.iter().map(|segment| segment.filtered.len()).sum();
        let contradicting = sorted.len() - used;
        if 2 * contradicting >= used {
            return None;
        }
        let step = |pair: &[Segment]| {
            let (from_s, to_s) = (pair[0].last().reference, pair[1].first().reference);
            let middle = 0.5 * (from_s + to_s);
            let [before, after] = [0, 1].map(|k| pair[k].at(middle).offset_here());
            ClockStep {
                from_s,
                to_s,
                by: WithSigma {
                    value: after.value - before.value,
                    sigma: after.sigma.hypot(before.sigma),
                },
            }
        };
        let mut course = Self {
            steps: segments.windows(2).map(step).collect(),
            segments,
            unsupported: Vec::new(),
            common_s: 0.0,
            used,
            contradicting,
        };
        course.unsupported = course.contradicted(&sorted);
        Some(course)
    }

    /// Returns the stretches from one used estimate to the next that contain an estimate which
    /// was left out.
    fn contradicted(&self, sorted: &[ClockRelation]) -> Vec<Unsupported> {
        let used: Vec<f64> = self
            .segments
            .iter()
            .flat_map(|s| &s.smoothed)
            .map(|r| r.reference)
            .collect();
        let others = sorted.iter().filter(|own| !used.contains(&own.reference));
        let stretch = |own: &ClockRelation| {
            let next = used.partition_point(|&at| at < own.reference);
            let after = used.get(next).map(|at| at - own.reference);
            let before = next.checked_sub(1).map(|k| own.reference - used[k]);
            // At either end as far as on the other side.
            let to = after.or(before).unwrap_or(0.0);
            Unsupported {
                from_s: own.reference - before.unwrap_or(to),
                to_s: own.reference + to,
                // A step in the middle of a window moves its estimate by about half the step.
                sigma_s: 2.0 * (own.offset - self.at(own.reference).offset).abs(),
            }
        };
        others.map(stretch).collect()
    }

    /// Joins estimates, each with the part of its 1-sigma that all of them share, in seconds.
    pub(crate) fn with_common(estimates: &[(ClockRelation, f64)], wander: Wander) -> Option<Self> {
        let alone = estimates.iter().map(|&(mut own, common_s)| {
            own.covariance[0][0] -= common_s * common_s;
            own
        });
        let mut course = Self::from_estimates(&alone.collect::<Vec<_>>(), wander)?;
        course.common_s = estimates.iter().map(|own| own.1).fold(0.0, f64::max);
        Some(course)
    }

    /// Replaces the course, over the time of `knots`, by relations that follow the clocks
    /// more closely and include all estimates, such as those from exchanges with both. A course
    /// with steps is returned unchanged, because such relations follow no steps.
    #[must_use]
    pub fn with_followed(mut self, knots: &[ClockRelation]) -> Self {
        let (Some(first), Some(last), [segment]) =
            (knots.first(), knots.last(), &mut self.segments[..])
        else {
            return self;
        };
        let is_beyond =
            |own: &ClockRelation| own.reference < first.reference || own.reference > last.reference;
        for own in [&mut segment.filtered, &mut segment.smoothed] {
            own.retain(is_beyond);
            let place = own.partition_point(|own| own.reference < first.reference);
            own.splice(place..place, knots.iter().copied());
        }
        self
    }

    /// Returns the relation at a time of clock a in seconds, from all data: between estimates an
    /// interpolation of the two nearest, outside of them a prediction. Within a step it is the
    /// relation of the nearer side.
    #[must_use]
    pub fn at(&self, at: f64) -> ClockRelation {
        let middle = |step: &ClockStep| 0.5 * (step.from_s + step.to_s);
        let segment = self.steps.partition_point(|step| middle(step) <= at);
        let mut relation = self.segments[segment.min(self.segments.len() - 1)].at(at);
        relation.covariance[0][0] += self.common_s * self.common_s;
        let inside = |own: &&Unsupported| own.from_s < at && at < own.to_s;
        for own in self.unsupported.iter().filter(inside) {
            relation.covariance[0][0] += own.sigma_s * own.sigma_s;
        }
        // The step may be on the other side of `at`: it is between two estimates, or within
        // one of them, which reach half as far as they are apart.
        for step in &self.steps {
            let part = 0.25 + 0.5 * (at - step.from_s) / (step.to_s - step.from_s);
            let wrong = part.min(1.0 - part).max(0.0);
            relation.covariance[0][0] += wrong * step.by.value * step.by.value;
        }
        relation
    }

    /// Returns the course for a clock a that reads `a_s` more and offsets that are larger by
    /// `between_s`.
    pub(crate) fn moved(mut self, a_s: f64, between_s: f64) -> Self {
        for segment in &mut self.segments {
            for relation in segment.filtered.iter_mut().chain(&mut segment.smoothed) {
                *relation = relation.moved(a_s, between_s);
            }
        }
        let times = self
            .steps
            .iter_mut()
            .flat_map(|s| [&mut s.from_s, &mut s.to_s]);
        let stretches = self
            .unsupported
            .iter_mut()
            .flat_map(|own| [&mut own.from_s, &mut own.to_s]);
        for time in times.chain(stretches) {
            *time += a_s;
        }
        self
    }

    /// Converts a time of clock b to clock a, both in seconds.
    #[must_use]
    pub fn b_to_a(&self, b: f64) -> f64 {
        // Two rounds: each reduces the error by the skew, which is at most 10⁻³.
        let near = self.segments[0].first().b_to_a(b);
        let near = b - self.at(near).offset;
        b - self.at(near).offset
    }

    /// Returns the times of the first and the last estimate, in seconds of clock a.
    #[must_use]
    pub fn span(&self) -> (f64, f64) {
        let last = &self.segments[self.segments.len() - 1];
        (self.segments[0].first().reference, last.last().reference)
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
        let true_offset = |t: f64| 1e5 + 20e-6 * t;
        let estimates: Vec<ClockRelation> = (0..30)
            .map(|k| estimate(10.0 * f64::from(k), true_offset(10.0 * f64::from(k)), 10e-6))
            .collect();
        let course = ClockCourse::from_estimates(&estimates, wander).unwrap();
        assert_eq!((course.used, course.contradicting), (30, 0));
        let middle = course.at(155.0);
        assert!((middle.offset - true_offset(155.0)).abs() < 3e-6);
        let (inside, outside) = (
            middle.covariance[0][0].sqrt(),
            course.at(600.0).covariance[0][0].sqrt(),
        );
        assert!(
            inside < 5e-6 && outside > 2.0 * inside,
            "{inside} {outside}"
        );
    }

    /// Windows of 10 s about a line with these offsets on top of it.
    fn windows(offsets: &[f64]) -> Vec<ClockRelation> {
        let at = |k: usize| 10.0 * k as f64;
        let line = |k: usize| 5.0 + 20e-6 * at(k);
        let each = offsets.iter().enumerate();
        each.map(|(k, offset)| estimate(at(k), line(k) + offset, 20e-6))
            .collect()
    }

    #[test]
    fn a_step_parts_the_course_and_a_few_wrong_windows_do_not() {
        let wander = Wander::from_ppm(0.05);
        let step =
            |before: usize, after: usize, by: f64| [vec![0.0; before], vec![by; after]].concat();
        for (before, after, by) in [
            (2, 7, 10e-3),
            (5, 4, -1.0),
            (7, 2, 0.3e-3),
            (20, 20, 0.2e-3),
        ] {
            let course = ClockCourse::from_estimates(&windows(&step(before, after, by)), wander);
            let course = course.unwrap();
            assert_eq!((course.used, course.contradicting), (before + after, 0));
            let [found] = course.steps[..] else {
                panic!("{before} {after} {by}: {:?}", course.steps);
            };
            assert!(
                (found.by.value - by).abs() < 4.0 * found.by.sigma,
                "{found:?}"
            );
            assert_eq!(found.from_s, 10.0 * (before - 1) as f64);
            assert_eq!(found.to_s, 10.0 * before as f64);
            let first = course.at(0.0);
            assert!((first.offset - 5.0).abs() < 4.0 * first.covariance[0][0].sqrt());
        }
        // The first window is wrong, and two others.
        let mut offsets = vec![0.0; 12];
        (offsets[0], offsets[5], offsets[8]) = (5e-3, -2e-3, 40e-3);
        let course = ClockCourse::from_estimates(&windows(&offsets), wander).unwrap();
        assert_eq!((course.used, course.contradicting), (9, 3));
        assert_eq!(course.steps, []);
        assert!((course.at(0.0).offset - 5.0).abs() < 60e-6);
        // No two agree.
        assert!(ClockCourse::from_estimates(&windows(&[0.0, 1e-3]), wander).is_none());
        assert!(ClockCourse::from_estimates(&windows(&[0.0, 1e-3, -4e-3]), wander).is_none());
        let many = [5e-3, 0.0, 0.0, -2e-3, 0.0, 0.0, 40e-3];
        assert!(ClockCourse::from_estimates(&windows(&many), wander).is_none());
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
