//! Matches depth frames to pulses with all the evidence that a recording has.
//!
//! In this order: the pulse that the user gives; the pattern of the pulses; the
//! camera's own gyroscope against the board's (the camera's recorder writes an IMU track by
//! default), which gives the offset of the clocks to far less than half
//! a period; the offset that the published system recorded.

use std::path::Path;

use crate::clocks::gyro_clock;
use crate::clocks::streams::{self, OtherGyro, Span, related};
use crate::constants::Constants;
use crate::depth::depth_clock::{
    Ambiguity, Assignment, Decision, DepthMatch, FrameState, Hint, HintSource, MatchError,
    match_frames,
};
use crate::depth::{DepthIndex, DepthInput};
use crate::error::ExtractError;
use crate::inputs::board_data::Reference;
use crate::inputs::survey::Survey;
use crate::time::{BoardNanos, DeviceNanos, PiecewiseMap, SECOND};
use system::ReadMonitor;
use twist_sync::Options;

/// 1-sigma of a clock relation from the camera's gyroscope, ns: the sensor's low-pass delay
/// is undocumented and a few milliseconds at most.
const CAMERA_SIGMA: f64 = 2.5e6;
/// 1-sigma of the published system's recorded offset, ns: set by hand to a few
/// milliseconds.
const RECORDED_SIGMA: f64 = 3e6;

/// Inputs of the matching of frames and pulses.
pub(crate) struct Matching<'a> {
    pub(crate) board: &'a Path,
    pub(crate) input: &'a DepthInput,
    pub(crate) index: &'a DepthIndex,
    pub(crate) survey: &'a Survey,
    pub(crate) constants: &'a Constants,
    pub(crate) monitor: &'a ReadMonitor,
}

/// Depth frames that have a time.
pub(crate) struct Matched {
    /// The frames with their pulses.
    pub(crate) found: DepthMatch,
    /// Reason why no pulses were matched, if all frames have the one recorded offset instead.
    pub(crate) offset_alone: Option<MatchError>,
}

impl From<DepthMatch> for Matched {
    fn from(found: DepthMatch) -> Self {
        Self {
            found,
            offset_alone: None,
        }
    }
}

impl Matching<'_> {
    /// Matches depth frames to pulses, or returns the reason why they do not match.
    ///
    /// # Errors
    ///
    /// Fails if the board's recording cannot be read, or if reading was stopped.
    pub(crate) fn find(
        &self,
        first_pulse: Option<usize>,
    ) -> Result<Result<Matched, MatchError>, ExtractError> {
        let frames: Vec<DeviceNanos> = self.index.frames.iter().map(|frame| frame.at).collect();
        let look = |hint| match_frames(&frames, &self.survey.pulses, hint).map(Matched::from);
        let found = look(first_pulse.map(Hint::FirstPulse));
        if first_pulse.is_some() {
            return Ok(found);
        }
        let error = match found {
            Ok(found) => return Ok(Ok(found)),
            Err(MatchError::Ambiguous(left)) => MatchError::Ambiguous(Ambiguity {
                has_imu: self.index.has_imu,
                ..left
            }),
            Err(error) => error,
        };
        let offset = recorded_offset(self.survey);
        if let MatchError::Ambiguous(_) = error {
            let hint = if self.index.has_imu {
                self.camera_hint()?
            } else {
                None
            };
            if let Some(hint) = hint {
                return Ok(look(Some(hint)));
            }
            let hint = offset.map(|delta| Hint::Clock {
                source: HintSource::RecordedOffset,
                map: offset_map(&frames, delta),
                around: DeviceNanos(0),
                sigma: RECORDED_SIGMA,
                center: 0,
            });
            if let Some(Ok(found)) = hint.map(|hint| look(Some(hint))) {
                return Ok(Ok(found));
            }
        }
        // The published system's own way: one recorded offset for all frames.
        Ok(match offset {
            Some(delta) => Ok(Matched {
                found: by_offset(&frames, delta, self.constants.depth_center_ns),
                offset_alone: Some(error),
            }),
            None => Err(error),
        })
    }

    /// Relates the camera's clock to the board's by their gyroscopes; `None` if they do not.
    fn camera_hint(&self) -> Result<Option<Hint>, ExtractError> {
        let span = Span {
            from: BoardNanos(self.survey.imu.first_ns),
            to: BoardNanos(self.survey.imu.last_ns),
        };
        let camera = OtherGyro {
            open: &|| streams::camera(self.input, self.monitor),
            options: Options {
                a_delay_s: self.constants.board_imu_delay_ns as f64 * 1e-9,
                ..Options::for_windows()
            },
            prior: None,
        };
        // Without a relation the pulses stay ambiguous, which is the reported error.
        let course = match related(self.board, span, &camera, self.monitor) {
            Err(error) if !error.is_fatal() => return Ok(None),
            clock => clock?.course,
        };
        let (from, to) = course.span();
        let middle = 0.5 * (from + to);
        let device = middle + course.at(middle).offset;
        Ok(Some(Hint::Clock {
            source: HintSource::CameraGyroscope,
            map: PiecewiseMap::from_knots(gyro_clock::knots(&course, span.from, span.to)),
            around: DeviceNanos((device * 1e9).round() as i64),
            sigma: CAMERA_SIGMA,
            center: self.constants.depth_center_ns,
        }))
    }
}

/// Returns board time minus depth stamp, ns, by the published system's `/depth_to_mcu_offset`.
fn recorded_offset(survey: &Survey) -> Option<i64> {
    let mut pairs = survey.times.iter();
    let pair = pairs.find(|pair| pair.of == Reference::DepthOffset)?;
    pair.stamp.0.checked_sub(pair.other)
}

/// Gives all frames the same offset. The offset includes the edge-to-centre time, which is
/// subtracted here because it is added again with the frames' times.
fn by_offset(frames: &[DeviceNanos], delta: i64, center: i64) -> DepthMatch {
    let frame = Assignment {
        state: FrameState::OffPulse,
        pulse: None,
        residual: 0,
    };
    DepthMatch {
        frames: vec![frame; frames.len()],
        missing: Vec::new(),
        decision: Decision::Hint {
            source: HintSource::RecordedOffset,
            left: 0,
        },
        rate_error: 0.0,
        rate_sigma: 0.0,
        residual: 0.0,
        clock: offset_map(frames, delta.saturating_sub(center)),
    }
}

/// Returns the map that adds `delta` (ns) to device times.
fn offset_map(frames: &[DeviceNanos], delta: i64) -> PiecewiseMap<DeviceNanos, BoardNanos> {
    let first = frames.iter().copied().min().unwrap_or_default();
    let knot = |at: i64| (DeviceNanos(at), BoardNanos(at.saturating_add(delta)));
    PiecewiseMap::from_knots([knot(first.0), knot(first.0.saturating_add(SECOND))])
}
