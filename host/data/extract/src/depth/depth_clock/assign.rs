//! Assigns to each frame the pulse nearest to it in time, once the shift is known.

use super::fit;
use super::pattern::{Fitted, Trains, distance};
use super::{Decision, DepthMatch};
use crate::time::DeviceNanos;

/// Largest distance of a frame from its pulse, ns, unless ten times the scatter is more.
/// A frame farther away was made by no recorded pulse.
const TOLERANCE: f64 = 1e6;

/// Relation of a frame to the pulses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum FrameState {
    /// The frame has a pulse of its own.
    Matched,
    /// Another frame is nearer to the same pulse.
    Doubled,
    /// The frame is earlier than the first recorded pulse.
    BeforeFirstPulse,
    /// The frame is later than the last recorded pulse.
    AfterLastPulse,
    /// The frame is between pulses, or where a pulse is missing in the recording.
    OffPulse,
    /// Frames and pulses were not matched: the frame has no board time.
    NotMatched,
}

/// Pulse of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Assignment {
    /// Relation of the frame to the pulses.
    pub(crate) state: FrameState,
    /// Index of the frame's pulse; for a doubled frame, of the nearest one.
    pub(crate) pulse: Option<usize>,
    /// Frame − pulse on the fitted clock, ns.
    pub(crate) residual: i64,
}

/// Assigns pulses to `frames` at `shift`, on the clock that was fitted there.
pub(super) fn assign(
    trains: &Trains,
    shift: i64,
    fitted: &Fitted,
    frames: &[DeviceNanos],
    decision: Decision,
) -> DepthMatch {
    let pulses = trains.pulse_times.len();
    let ratio = trains.ratio();
    // distance(frame)·ratio − distance(pulse) = smooth, with the distance modulo a
    // period: the whole periods are in the shift.
    let base = trains.base(shift);
    let to_pulse = |x: f64| {
        let scaled = x * ratio;
        scaled - fitted.smooth.at(scaled) + base
    };
    let tolerance = (10.0 * fitted.scatter)
        .max(TOLERANCE)
        .min(trains.period * 0.4);
    let mut taken: Vec<Option<(usize, f64)>> = vec![None; pulses];
    let mut out: Vec<Assignment> = Vec::with_capacity(frames.len());
    for (index, frame) in frames.iter().enumerate() {
        let time = to_pulse(distance(frame.0, trains.device_zero.0));
        let (nearest, residual) = trains.nearest_pulse(time);
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
    let end = trains.end();
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
        clock: fit::knots(trains.device_zero, trains.board_zero, end, to_pulse),
    }
}
