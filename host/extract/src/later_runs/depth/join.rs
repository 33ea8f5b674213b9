//! All runs together: states of all frames, one clock.

use super::{Carried, LeftOut, OverResets, Part, Recording, RunError};
use crate::depth_clock::fit::KNOT_SPACING;
use crate::depth_clock::pattern::distance;
use crate::depth_clock::{Assignment, Decision, DepthMatch, FrameState};
use crate::time::{BoardNanos, DeviceNanos, PiecewiseMap};

impl Recording<'_> {
    /// All runs together.
    pub(super) fn join(
        &self,
        frames: &[DeviceNanos],
        anchor: usize,
        parts: &[Option<Part>],
        why: Vec<Option<RunError>>,
        carried: Vec<Carried>,
    ) -> OverResets {
        let matched = || parts.iter().flatten();
        let clock = PiecewiseMap::from_knots(matched().flat_map(knots));
        let mut out: Vec<Option<Assignment>> = vec![None; frames.len()];
        for part in matched() {
            for (&(_, number), &assigned) in part.frames.iter().zip(&part.found.frames) {
                out[number] = Some(assigned);
            }
        }
        let mut left_out = vec![0; self.runs.len()];
        let mut in_gaps = 0;
        let frames: Vec<Assignment> = out
            .into_iter()
            .zip(frames)
            .map(|(assigned, &at)| {
                assigned.unwrap_or_else(|| {
                    let (run, state) = self.elsewhere(clock.apply(at), parts);
                    match state {
                        FrameState::NotMatched => left_out[run] += 1,
                        FrameState::OffPulse => in_gaps += 1,
                        _ => {}
                    }
                    Assignment::without_pulse(state)
                })
            })
            .collect();
        let mut taken = vec![false; self.pulses.len()];
        for frame in &frames {
            if let (FrameState::Matched, Some(pulse)) = (frame.state, frame.pulse) {
                taken[pulse] = true;
            }
        }
        let first = taken.iter().position(|&taken| taken).unwrap_or(0);
        let last = taken.iter().rposition(|&taken| taken).unwrap_or(0);
        let known = self.runs.iter().zip(parts);
        let known = known.filter(|(_, part)| part.is_some());
        let missing = known.flat_map(|(run, _)| run.pulses.clone());
        let missing = missing.filter(|&pulse| (first..last).contains(&pulse) && !taken[pulse]);
        let why = why.into_iter().enumerate().zip(left_out);
        let left_out = why.filter_map(|((run, why), frames)| {
            let why = why?;
            Some(LeftOut { run, frames, why })
        });
        let of_anchor = parts.get(anchor).and_then(Option::as_ref);
        let found = DepthMatch {
            missing: missing.collect(),
            decision: of_anchor.map_or(Decision::Hint { left: 0 }, |p| p.found.decision),
            rate_error: of_anchor.map_or(0.0, |part| part.found.rate_error),
            rate_sigma: of_anchor.map_or(0.0, |part| part.found.rate_sigma),
            residual: matched()
                .map(|part| part.found.residual)
                .fold(0.0, f64::max),
            frames,
            clock,
        };
        OverResets {
            found,
            anchor,
            carried,
            left_out: left_out.collect(),
            in_gaps,
        }
    }

    /// What a frame is that is in no run's part, and to which run it is nearest.
    fn elsewhere(&self, at: Option<BoardNanos>, parts: &[Option<Part>]) -> (usize, FrameState) {
        let last = self.runs.len() - 1;
        let Some(at) = at else {
            return (0, FrameState::NotMatched);
        };
        let half = 0.5 * self.period;
        let known = |run: usize, state| match parts.get(run) {
            Some(Some(_)) => (run, state),
            _ => (run, FrameState::NotMatched),
        };
        for (index, run) in self.runs.iter().enumerate() {
            if distance(at.0, run.first.0) < -half {
                return match index {
                    0 => known(0, FrameState::BeforeFirstPulse),
                    // The frames of a gap are timed from either side of it.
                    _ => match known(index - 1, FrameState::OffPulse) {
                        (_, FrameState::NotMatched) => known(index, FrameState::OffPulse),
                        timed => timed,
                    },
                };
            }
            if distance(at.0, run.last.0) <= half {
                return known(index, FrameState::OffPulse);
            }
        }
        known(last, FrameState::AfterLastPulse)
    }
}

/// Pairs of times of one run, from its first frame with a pulse to its last.
fn knots(part: &Part) -> Vec<(DeviceNanos, BoardNanos)> {
    let (first, last) = part.span;
    let length = distance(last.0, first.0);
    // The last piece is never shorter than half of the others.
    let count = (length / KNOT_SPACING - 0.5).floor().max(0.0) as i64;
    let inner = (0..=count).map(|knot| DeviceNanos(first.0 + knot * KNOT_SPACING as i64));
    inner
        .chain([last])
        .filter_map(|at| Some((at, part.found.clock.apply(at)?)))
        .collect()
}
