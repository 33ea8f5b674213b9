//! Which depth frame has which pulse: the pattern first, and where it does not
//! decide, what else there is.
//!
//! In this order: the pulse that the user gives; the pattern of the pulses; the
//! camera's own gyroscope against the board's (its recorder writes an IMU track
//! unless told not to), which gives the offset of the clocks far better than half
//! a period; the recorded offset of the published system.

use std::path::Path;

use crate::clocks::gyro_clock;
use crate::clocks::streams::{self, OtherGyro, Span, related};
use crate::constants::Constants;
use crate::depth::depth_clock::{
    Ambiguity, Assignment, Decision, DepthMatch, FrameState, Hint, MatchError, match_frames,
};
use crate::depth::{DepthIndex, DepthInput};
use crate::error::ExtractError;
use crate::inputs::board_data::Reference;
use crate::inputs::survey::Survey;
use crate::time::{BoardNanos, DeviceNanos, PiecewiseMap, SECOND};
use system::ReadMonitor;
use twist_sync::Options;

/// 1-sigma of a clock relation from the camera's gyroscope, ns: its low-pass delay
/// is not documented and is a few milliseconds at most.
const CAMERA_SIGMA: f64 = 2.5e6;
/// 1-sigma of the published system's recorded offset, ns: set by hand to a few
/// milliseconds.
const RECORDED_SIGMA: f64 = 3e6;

/// Frames with their pulses.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Matched {
    /// The frames.
    pub(crate) found: DepthMatch,
    /// Worth knowing.
    pub(crate) remarks: Vec<String>,
    by: &'static str,
}

impl Matched {
    fn new(found: DepthMatch) -> Self {
        Self {
            found,
            remarks: Vec::new(),
            by: "the pattern",
        }
    }

    fn by(self, by: &'static str) -> Self {
        Self { by, ..self }
    }

    /// What decided, in words.
    pub(crate) fn decided_by(&self) -> String {
        match self.found.decision {
            Decision::Pattern { margin } if margin.is_finite() => {
                format!("the pattern of the pulses (χ² margin {margin:.0})")
            }
            Decision::Pattern { .. } => "the pattern of the pulses".into(),
            Decision::Hint { left: 0 } => self.by.to_owned(),
            Decision::Hint { left } => format!("{} (of {left} possible shifts)", self.by),
        }
    }
}

/// What frames and pulses are matched by.
pub(crate) struct Matching<'a> {
    pub(crate) board: &'a Path,
    pub(crate) input: &'a DepthInput,
    pub(crate) index: &'a DepthIndex,
    pub(crate) survey: &'a Survey,
    pub(crate) constants: &'a Constants,
    pub(crate) monitor: &'a ReadMonitor,
}

impl Matching<'_> {
    /// Matches depth frames to pulses.
    ///
    /// # Errors
    ///
    /// Frames and pulses do not match, it was stopped, or the board's recording cannot be
    /// read.
    pub(crate) fn find(&self, first_pulse: Option<usize>) -> Result<Matched, ExtractError> {
        let frames: Vec<DeviceNanos> = self.index.frames.iter().map(|frame| frame.at).collect();
        let look = |hint| match_frames(&frames, &self.survey.pulses, hint).map(Matched::new);
        let found = look(first_pulse.map(Hint::FirstPulse));
        if first_pulse.is_some() {
            return Ok(found.map_err(not_matched)?.by("the user"));
        }
        let error = match found {
            Ok(found) => return Ok(found),
            Err(MatchError::Ambiguous(left)) => MatchError::Ambiguous(Ambiguity {
                has_imu: self.index.has_imu,
                ..left
            }),
            Err(error) => error,
        };
        if let MatchError::Ambiguous(_) = error {
            let hint = if self.index.has_imu {
                self.camera_hint()?
            } else {
                None
            };
            if let Some(hint) = hint {
                let found = look(Some(hint)).map_err(not_matched)?;
                return Ok(found.by("the camera's gyroscope"));
            }
            if let Some(delta) = recorded_offset(self.survey) {
                let hint = Hint::Clock {
                    map: offset_map(&frames, delta),
                    around: DeviceNanos(0),
                    sigma: RECORDED_SIGMA,
                    center: 0,
                };
                if let Ok(found) = look(Some(hint)) {
                    return Ok(found.by("the recorded offset"));
                }
            }
        }
        // The published system's own way: one recorded offset for all frames.
        if let Some(delta) = recorded_offset(self.survey) {
            let remark = format!(
                "depth frames have the one offset that was recorded, without pulses: {error}"
            );
            let found = by_offset(&frames, delta, self.constants.depth_center_ns);
            let found = Matched {
                remarks: vec![remark],
                ..Matched::new(found)
            };
            return Ok(found.by("the recorded offset"));
        }
        Err(not_matched(error))
    }

    /// The relation of the camera's clock to the board's by their gyroscopes.
    fn camera_hint(&self) -> Result<Option<Hint>, ExtractError> {
        let span = Span {
            from: BoardNanos(self.survey.imu.first_ns),
            to: BoardNanos(self.survey.imu.last_ns),
        };
        let camera = OtherGyro {
            open: &|| streams::camera(self.input, self.monitor),
            options: Options {
                a_delay_s: self.constants.board_imu_delay_ns as f64 * 1e-9,
                ..Options::of_windows()
            },
            prior: None,
        };
        // Without a relation the pulses stay ambiguous, which is what is said.
        let course = match related(self.board, span, &camera, self.monitor) {
            Err(error) if !error.is_fatal() => return Ok(None),
            clock => clock?.course,
        };
        let (from, to) = course.span();
        let middle = 0.5 * (from + to);
        let device = middle + course.at(middle).offset;
        Ok(Some(Hint::Clock {
            map: PiecewiseMap::from_knots(gyro_clock::knots(&course, span.from, span.to)),
            around: DeviceNanos((device * 1e9).round() as i64),
            sigma: CAMERA_SIGMA,
            center: self.constants.depth_center_ns,
        }))
    }
}

fn not_matched(error: MatchError) -> ExtractError {
    ExtractError::Missing(error.to_string())
}

/// Board − depth stamp by the published system's `/depth_to_mcu_offset`.
fn recorded_offset(survey: &Survey) -> Option<i64> {
    let mut pairs = survey.times.iter();
    let pair = pairs.find(|pair| pair.of == Reference::DepthOffset)?;
    pair.stamp.0.checked_sub(pair.other)
}

/// All frames by one offset. The edge-to-centre time is in the offset already, so
/// that it is taken off here and put on again with the tables.
fn by_offset(frames: &[DeviceNanos], delta: i64, center: i64) -> DepthMatch {
    let frame = Assignment {
        state: FrameState::OffPulse,
        pulse: None,
        residual: 0,
    };
    DepthMatch {
        frames: vec![frame; frames.len()],
        missing: Vec::new(),
        decision: Decision::Hint { left: 0 },
        rate_error: 0.0,
        rate_sigma: 0.0,
        residual: 0.0,
        clock: offset_map(frames, delta.saturating_sub(center)),
    }
}

/// The map that adds `delta` to device times.
fn offset_map(frames: &[DeviceNanos], delta: i64) -> PiecewiseMap<DeviceNanos, BoardNanos> {
    let first = frames.iter().copied().min().unwrap_or_default();
    let knot = |at: i64| (DeviceNanos(at), BoardNanos(at.saturating_add(delta)));
    PiecewiseMap::from_knots([knot(first.0), knot(first.0.saturating_add(SECOND))])
}
