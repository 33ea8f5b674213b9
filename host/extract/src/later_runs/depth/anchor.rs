//! The run that is matched by itself, like any recording.

use super::{FLOOR, Part, Recording, RunError, relation};
use crate::depth_clock::pattern::distance;
use crate::depth_clock::{
    Ambiguity, Assignment, FrameState, Hint, MatchError, match_frames, match_running,
};
use crate::time::DeviceNanos;

/// Share of the frames of the run that must lie closely on pulses.
const ON_PULSE: f64 = 0.95;

impl Part {
    /// Before anything is known, frames of another run may be taken for this one's: then
    /// the camera's change from its own clock to the pulses is among them, and they
    /// cannot all lie on pulses.
    fn of_this_run_alone(self) -> Result<Self, RunError> {
        let near = (6.0 * self.found.residual).max(FLOOR);
        let on_pulse = |frame: &&Assignment| {
            frame.state == FrameState::Matched && (frame.residual as f64).abs() <= near
        };
        let matched = self.found.frames.iter().filter(on_pulse).count();
        if (matched as f64) < ON_PULSE * self.frames.len() as f64 {
            return Err(RunError::NotFollowing {
                matched,
                frames: self.frames.len(),
            });
        }
        Ok(self)
    }
}

impl Recording<'_> {
    /// The first run that can be matched by itself, and its frames.
    pub(super) fn anchor(&self, hint: Option<Hint>) -> Result<(usize, Part), MatchError> {
        let last = self.runs.len() - 1;
        let mut error: Option<MatchError> = None;
        for (index, run) in self.runs.iter().enumerate() {
            let own = match hint {
                Some(Hint::FirstPulse(pulse)) if run.pulses.contains(&pulse) => {
                    Some(Hint::FirstPulse(pulse - run.pulses.start))
                }
                Some(Hint::FirstPulse(_)) => continue,
                hint => hint,
            };
            // Runs in the middle have no frame that is known to be theirs.
            if own.is_none() && index != 0 && index != last {
                continue;
            }
            let first = self.own_frames(index, own);
            let times: Vec<DeviceNanos> = first.iter().map(|frame| frame.0).collect();
            let pulses = self.pulses_of(run);
            let found = if index == 0 {
                match_frames(&times, pulses, own)
            } else {
                match_running(&times, pulses, own)
            };
            let part = found.and_then(|found| {
                let map = relation(&found, middle(&times)).ok_or(MatchError::TooFew {
                    frames: times.len(),
                    pulses: pulses.len(),
                })?;
                let part = self.place(run, &map, FLOOR);
                let part = part.and_then(Part::of_this_run_alone);
                Ok((found.decision, part.map_err(|why| why.of_run(index))?))
            });
            match part {
                Ok((decision, mut part)) => {
                    part.found.decision = decision;
                    return Ok((index, part));
                }
                Err(why) => {
                    let why = counted_in_all(why, run.pulses.start);
                    // That several pulses fit says more than that nothing did.
                    let says_more = matches!(why, MatchError::Ambiguous(_))
                        && !matches!(error, Some(MatchError::Ambiguous(_)));
                    if error.is_none() || says_more {
                        error = Some(why);
                    }
                }
            }
        }
        Err(error.unwrap_or(MatchError::TooFew {
            frames: self.frames.len(),
            pulses: self.pulses.len(),
        }))
    }

    /// Frames that may be of a run, before anything is matched.
    fn own_frames(&self, index: usize, hint: Option<Hint>) -> &[(DeviceNanos, usize)] {
        let run = &self.runs[index];
        let beginning = match hint {
            Some(Hint::Clock { map, center, .. }) => {
                let at = |frame: &(DeviceNanos, usize)| map.apply(frame.0).0.saturating_sub(center);
                return self.between(run, at);
            }
            Some(Hint::FirstPulse(pulse)) => self.pulses_of(run).get(pulse).map(|pulse| pulse.at),
            None => None,
        };
        // Rates of clocks are below 2 ‰; a period more at each end does no harm.
        let length = distance(run.last.0, beginning.unwrap_or(run.first).0) * 1.002 + self.period;
        let near =
            |pair: &[(DeviceNanos, usize)]| distance(pair[1].0.0, pair[0].0.0) < 10.0 * self.period;
        // A single stamp far from all others is damaged.
        if index == 0 || beginning.is_some() {
            let start = self.frames.windows(2).position(near).unwrap_or(0);
            let frames = &self.frames[start..];
            let zero = frames.first().map_or(DeviceNanos(0), |frame| frame.0);
            let end = frames.partition_point(|frame| distance(frame.0.0, zero.0) <= length);
            &frames[..end]
        } else {
            let last = self
                .frames
                .windows(2)
                .rposition(near)
                .map_or(0, |at| at + 1);
            let frames = self.frames.get(..=last).unwrap_or_default();
            let end = frames.last().map_or(DeviceNanos(0), |frame| frame.0);
            let start = frames.partition_point(|frame| distance(end.0, frame.0.0) > length);
            &frames[start..]
        }
    }
}

fn middle(times: &[DeviceNanos]) -> DeviceNanos {
    times.get(times.len() / 2).copied().unwrap_or_default()
}

/// Numbers of pulses of one run as numbers of all.
fn counted_in_all(error: MatchError, start: usize) -> MatchError {
    let start = start as i64;
    match error {
        MatchError::Ambiguous(left) => MatchError::Ambiguous(Ambiguity {
            first: left.first + start,
            last: left.last + start,
            ..left
        }),
        MatchError::Conflict { pattern, hint, by } => MatchError::Conflict {
            pattern: pattern + start,
            hint: hint + start,
            by,
        },
        error => error,
    }
}
