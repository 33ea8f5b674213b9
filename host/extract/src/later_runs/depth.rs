//! Depth frames over a reset of the board.
//!
//! A reset parts the pulses into runs, and while there are none the camera goes on
//! by its own clock: frames in between belong to no pulse, and how many there are says
//! nothing about which pulse the next frame has. But that clock runs on. So:
//!
//! 1. One run, the *anchor*, is matched like any recording: the first whose pattern (or
//!    hint) decides. For the pattern, the frames are those from the first one on for the
//!    first run, those up to the last one for the last run.
//! 2. From there on and back, the camera's clock predicts which frames are of the next
//!    run, and each takes the pulse next to it in time. That is safe as long as the
//!    1-sigma of the prediction (place of the runs, fit, drift of the camera's clock) is
//!    below a twelfth of a period.
//! 3. What was predicted must come true: frames lie on the pulses within five sigma,
//!    nearly all have one, and the rate is that of the anchor. Where the camera leaves
//!    its own clock for the pulses is seen in the frames, and must be at the first pulse
//!    of the run: else the anchor is off by whole periods.
//!
//! What contradicts the anchor is an error, and nothing is matched. A run that cannot be
//! reached has no board time for its frames ([`crate::depth_clock::FrameState::NotMatched`]), and why
//! is said. Frames in a gap next to a matched run are timed by the camera's clock.
//!
//! Limit: a camera that needs more than three frames to follow the pulses of a new run
//! cannot be told from a match that is as many periods off.

mod anchor;
mod carry;
mod error;
mod join;

use std::ops::Range;

pub(crate) use error::RunError;

use crate::depth_clock::fit::median;
use crate::depth_clock::pattern::distance;
use crate::depth_clock::{DEVICE_TICK_NS, DepthMatch, Hint, MatchError, PulseTime};
use crate::time::{AffineMap, BoardNanos, DeviceNanos};

/// No prediction is better than this, ns: two ticks of the camera.
const FLOOR: f64 = 2.0 * DEVICE_TICK_NS;

/// The beginning of a run after a reset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Reset {
    /// Index of its first pulse.
    pub(crate) first_pulse: usize,
    /// 1-sigma of its distance to the run before, ns.
    pub(crate) sigma: f64,
}

/// A run that was matched by the camera's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Carried {
    /// Which, from 0.
    pub(crate) run: usize,
    /// 1-sigma of the prediction, ns.
    pub(crate) sigma: f64,
    /// How far frames were beside it, ns.
    pub(crate) off: f64,
}

/// A run whose frames have no board time.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct LeftOut {
    /// Which, from 0.
    pub(crate) run: usize,
    /// Its frames.
    pub(crate) frames: usize,
    /// Why.
    pub(crate) why: RunError,
}

/// Frames with their pulses over resets.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct OverResets {
    /// All frames.
    pub(crate) found: DepthMatch,
    /// The run that was matched by itself.
    pub(crate) anchor: usize,
    /// Runs that the camera's clock reached.
    pub(crate) carried: Vec<Carried>,
    /// Runs that it did not.
    pub(crate) left_out: Vec<LeftOut>,
    /// Frames between runs, timed by the camera's clock.
    pub(crate) in_gaps: usize,
}

/// A run of the board.
#[derive(Clone, Debug)]
struct Run {
    pulses: Range<usize>,
    first: BoardNanos,
    last: BoardNanos,
    /// 1-sigma of its distance to the run before, ns.
    sigma: f64,
}

/// Frames of one run, in order of time, with what they are.
#[derive(Clone, Debug)]
struct Part {
    /// Device times and numbers of the frames.
    frames: Vec<(DeviceNanos, usize)>,
    found: DepthMatch,
    /// Device time of the first and last frame that has a pulse.
    span: (DeviceNanos, DeviceNanos),
}

/// Everything that is looked at.
struct Recording<'a> {
    /// Device times with the frames' numbers, in order of time.
    frames: Vec<(DeviceNanos, usize)>,
    pulses: &'a [PulseTime],
    runs: Vec<Run>,
    period: f64,
}

/// Matches frames to the pulses of all runs of the board.
///
/// `pulses` are in order of time, `resets` too. A [`Hint::FirstPulse`] counts in all of
/// `pulses`.
///
/// # Errors
///
/// No run can be matched by itself; the error is that of the run that came nearest to
/// it. Or the match of one does not fit to the next.
pub(crate) fn match_over_resets(
    frames: &[DeviceNanos],
    pulses: &[PulseTime],
    resets: &[Reset],
    hint: Option<Hint>,
) -> Result<OverResets, MatchError> {
    let recording = Recording::new(frames, pulses, resets);
    let (anchor, part) = recording.anchor(hint)?;
    let count = recording.runs.len();
    let mut parts: Vec<Option<Part>> = vec![None; count];
    let mut why: Vec<Option<RunError>> = vec![None; count];
    let mut carried = Vec::new();
    parts[anchor] = Some(part);
    for run in (anchor + 1..count).chain((0..anchor).rev()) {
        match recording.carry(&parts, anchor, run) {
            Ok((part, sigma, off)) => {
                parts[run] = Some(part);
                carried.push(Carried { run, sigma, off });
            }
            Err(why) if why.contradicts() => return Err(why.of_run(run)),
            Err(error) => why[run] = Some(error),
        }
    }
    carried.sort_by_key(|carried| carried.run);
    Ok(recording.join(frames, anchor, &parts, why, carried))
}

impl<'a> Recording<'a> {
    fn new(frames: &[DeviceNanos], pulses: &'a [PulseTime], resets: &[Reset]) -> Self {
        let mut sorted: Vec<(DeviceNanos, usize)> = frames.iter().copied().zip(0..).collect();
        sorted.sort_unstable();
        let starts = resets
            .iter()
            .map(|reset| (reset.first_pulse.min(pulses.len()), reset.sigma));
        let starts: Vec<(usize, f64)> = std::iter::once((0, 0.0)).chain(starts).collect();
        let ends = starts.iter().skip(1).map(|start| start.0);
        let ends = ends.chain([pulses.len()]);
        let at = |index: usize| pulses.get(index).map_or(BoardNanos(0), |pulse| pulse.at);
        let runs = starts.iter().zip(ends).map(|(&(start, sigma), end)| Run {
            pulses: start..end.max(start),
            first: at(start),
            last: at(end.max(start + 1) - 1),
            sigma,
        });
        let steps = pulses
            .windows(2)
            .map(|pair| distance(pair[1].at.0, pair[0].at.0));
        Self {
            frames: sorted,
            pulses,
            runs: runs.collect(),
            period: median(steps.collect()),
        }
    }

    fn pulses_of(&self, run: &Run) -> &'a [PulseTime] {
        self.pulses.get(run.pulses.clone()).unwrap_or_default()
    }

    /// Frames within a run by their board times (of the pulse).
    fn between(
        &self,
        run: &Run,
        at: impl Fn(&(DeviceNanos, usize)) -> i64,
    ) -> &[(DeviceNanos, usize)] {
        let half = 0.5 * self.period;
        let start = self
            .frames
            .partition_point(|frame| distance(at(frame), run.first.0) < -half);
        let end = self
            .frames
            .partition_point(|frame| distance(at(frame), run.last.0) <= half);
        self.frames.get(start..end).unwrap_or_default()
    }
}

/// The relation of the clocks around a frame, device time to time of the pulse.
fn relation(found: &DepthMatch, at: DeviceNanos) -> Option<AffineMap<DeviceNanos, BoardNanos>> {
    let board = found.clock.apply(at)?;
    AffineMap::new(at, board, 1.0 / (1.0 + found.rate_error) - 1.0)
}

#[cfg(test)]
mod tests;
