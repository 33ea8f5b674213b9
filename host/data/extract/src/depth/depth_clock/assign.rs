//! With the shift known: each frame takes the pulse next to it in time.

use super::fit;
use super::pattern::{Fitted, Grid, distance};
use super::{Decision, DepthMatch};
use crate::time::DeviceNanos;

/// A frame may be this far from its pulse (ns) or ten times the scatter: more is
/// a frame that no pulse of the recording has made.
const TOLERANCE: f64 = 1e6;

/// What a frame is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum FrameState {
    /// It has a pulse of its own.
    Matched,
    /// Another frame lies nearer to the same pulse.
    Doubled,
    /// It lies in front of the first recorded pulse.
    BeforeFirstPulse,
    /// It lies after the last recorded pulse.
    AfterLastPulse,
    /// It lies between pulses, or where a pulse is missing in the recording.
    OffPulse,
    /// Frames and pulses were not matched: it has no board time.
    NotMatched,
}

/// A frame's pulse.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Assignment {
    /// What it is.
    pub(crate) state: FrameState,
    /// Index of its pulse; of the nearest one for a doubled frame.
    pub(crate) pulse: Option<usize>,
    /// Frame − pulse on the fitted clock, in ns.
    pub(crate) residual: i64,
}

pub(super) fn assign(
    grid: &Grid,
    shift: i64,
    fitted: &Fitted,
    frames: &[DeviceNanos],
    decision: Decision,
) -> DepthMatch {
    let pulses = grid.pulse_times.len();
    let ratio = grid.ratio();
    // distance(frame)·ratio − distance(pulse) = smooth, with the distance modulo a
    // period: the whole periods are in the shift.
    let base = grid.base(shift);
    let to_pulse = |x: f64| {
        let scaled = x * ratio;
        scaled - fitted.smooth.at(scaled) + base
    };
    let tolerance = (10.0 * fitted.scatter)
        .max(TOLERANCE)
        .min(grid.period * 0.4);
    let mut taken: Vec<Option<(usize, f64)>> = vec![None; pulses];
    let mut out: Vec<Assignment> = Vec::with_capacity(frames.len());
    for (index, frame) in frames.iter().enumerate() {
        let time = to_pulse(distance(frame.0, grid.device_zero.0));
        let (nearest, residual) = grid.nearest_pulse(time);
        let state = if residual.abs() <= tolerance {
            match taken[nearest] {
                Some((_, other)) if other.abs() <= residual.abs() => FrameState::Doubled,
                Some((other, _)) => {
                    out[other].state = FrameState::Doubled;
                    taken[nearest] = Some((index, residual));
                    FrameState::Matched
                }
                None => {
                    taken[nearest] = Some((index, residual));
                    FrameState::Matched
                }
            }
        } else if nearest == 0 && residual < 0.0 {
            FrameState::BeforeFirstPulse
        } else if nearest + 1 == pulses && residual > 0.0 {
            FrameState::AfterLastPulse
        } else {
            FrameState::OffPulse
        };
        let has_pulse = matches!(state, FrameState::Matched | FrameState::Doubled);
        out.push(Assignment {
            state,
            pulse: has_pulse.then_some(nearest),
            residual: residual.round() as i64,
        });
    }
    let first = taken.iter().position(Option::is_some).unwrap_or(0);
    let last = taken.iter().rposition(Option::is_some).unwrap_or(0);
    let missing = (first..last)
        .filter(|&pulse| taken[pulse].is_none())
        .collect();
    let end = grid.end();
    // board = device·ratio·(1 − b) and the rate is device against board.
    let rate_error = 1.0 / (ratio * (1.0 - fitted.smooth.b)) - 1.0;
    let matched = taken.iter().flatten().count().max(1) as f64;
    // Slope of a line through evenly spread points: σ·√12 / (span·√n).
    let rate_sigma = fitted.scatter * 12.0_f64.sqrt() / (end.max(1.0) * matched.sqrt());
    DepthMatch {
        frames: out,
        missing,
        decision,
        rate_error,
        rate_sigma,
        residual: fitted.scatter,
        clock: fit::knots(grid.device_zero, grid.board_zero, end, to_pulse),
    }
}
