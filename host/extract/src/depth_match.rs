//! Which depth frame has which pulse: the pattern first, and where it does not
//! decide, what else there is.
//!
//! In this order: the pulse that the user gives; the pattern of the pulses; the
//! camera's own gyroscope against the board's (its recorder writes an IMU track
//! unless told not to), which gives the offset of the clocks far better than half
//! a period; the recorded offset of the published system.

use std::path::Path;

use super::board_data::Reference;
use super::constants::Constants;
use super::depth::{DepthIndex, DepthInput};
use super::depth_clock::{
    Ambiguity, Decision, DepthMatch, FrameState, Hint, MatchError, match_frames,
};
use super::error::ExtractError;
use super::gyro_clock;
use super::streams::{self, OtherGyro, Span, related};
use super::survey::Survey;
use super::time::{AffineMap, BoardNanos, DeviceNanos, PiecewiseMap, SECOND};
use twist_sync::{Options, RecordingClock};

/// 1-sigma of a clock relation from the camera's gyroscope, ns: its low-pass delay
/// is not documented and is a few milliseconds at most.
const CAMERA_SIGMA: f64 = 2.5e6;
/// 1-sigma of the published system's recorded offset, ns: set by hand to a few
/// milliseconds.
const RECORDED_SIGMA: f64 = 3e6;
/// Of the windows of the camera's gyroscope, each this many is used: the relation
/// is needed to milliseconds only.
const EVERY: usize = 3;

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
            let recorded = recorded_offset(self.survey)
                .and_then(|delta| AffineMap::new(DeviceNanos(0), BoardNanos(delta), 0.0));
            if let Some(map) = recorded {
                let hint = Hint::Clock {
                    map,
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

    /// Times the frames of a camera that ran on its own clock, through its gyroscope and the
    /// board's.
    ///
    /// # Errors
    ///
    /// The gyroscopes do not relate the clocks, it was stopped, or the board's recording
    /// cannot be read.
    pub(crate) fn free_running(&self) -> Result<Matched, ExtractError> {
        let failed = |why: String| Err(not_matched(MatchError::NoGyro { why }));
        if !self.index.has_imu {
            let why = "the recording has no samples of the camera's IMU; record with the IMU on";
            return failed(why.to_owned());
        }
        let clock = match self.camera_clock(1) {
            Err(ExtractError::Missing(why)) => return failed(why),
            clock => clock?,
        };
        let imu = &self.survey.imu;
        let (first, last) = (BoardNanos(imu.first_ns), BoardNanos(imu.last_ns));
        // The time of an image is its stamp's: what is put on with the tables is taken off.
        let knots = gyro_clock::knots::<DeviceNanos>(&clock.course, first, last);
        let map = PiecewiseMap::from_knots(knots.into_iter().map(|(device, at)| {
            let edge = at.0.saturating_sub(self.constants.depth_center_ns);
            (device, BoardNanos(edge))
        }));
        let (from, to) = clock.course.span();
        let model = clock.course.at(0.5 * (from + to));
        let found = DepthMatch {
            rate_error: model.skew,
            rate_sigma: model.covariance[1][1].max(0.0).sqrt(),
            ..DepthMatch::by_clock(self.index.frames.len(), FrameState::FreeRunning, map)
        };
        let remark = format!(
            "the depth camera ran on its own clock: its frames are timed through the gyroscopes of camera and \
             board, ± {:.1} µs (1-sigma) and a constant of up to {:.1} ms, for the low-pass delay of the \
             camera's gyroscope is not documented",
            model.covariance[0][0].max(0.0).sqrt() * 1e6,
            CAMERA_SIGMA * 1e-6
        );
        let matched = Matched {
            remarks: vec![remark],
            ..Matched::new(found)
        };
        Ok(matched.by("the camera's own clock"))
    }

    fn camera_hint(&self) -> Result<Option<Hint>, ExtractError> {
        // Without a relation the pulses stay ambiguous, which is what is said.
        let clock = match self.camera_clock(EVERY) {
            Err(error) if !error.is_fatal() => return Ok(None),
            clock => clock?,
        };
        let (from, to) = clock.course.span();
        let at = 0.5 * (from + to);
        let model = clock.course.at(at);
        let board = (at * 1e9).round() as i64;
        let offset = (model.offset * 1e9).round() as i64;
        let map = AffineMap::new(
            DeviceNanos(board.saturating_add(offset)),
            BoardNanos(board),
            1.0 / (1.0 + model.skew) - 1.0,
        );
        Ok(map.map(|map| Hint::Clock {
            map,
            sigma: CAMERA_SIGMA,
            center: self.constants.depth_center_ns,
        }))
    }

    /// The relation of the camera's clock to the board's by their gyroscopes, from each
    /// `every`-th window.
    fn camera_clock(&self, every: usize) -> Result<RecordingClock, ExtractError> {
        let span = Span {
            from: BoardNanos(self.survey.imu.first_ns),
            to: BoardNanos(self.survey.imu.last_ns),
        };
        let camera = OtherGyro {
            open: &|| streams::camera(self.input),
            options: Options {
                a_delay_s: self.constants.board_imu_delay_ns as f64 * 1e-9,
                ..Options::of_windows()
            },
            prior: None,
            every,
        };
        related(self.board, span, &camera)
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
    let first = frames.iter().copied().min().unwrap_or_default();
    let knot = |at: i64| {
        let board = at.saturating_add(delta).saturating_sub(center);
        (DeviceNanos(at), BoardNanos(board))
    };
    let clock = PiecewiseMap::from_knots([knot(first.0), knot(first.0.saturating_add(SECOND))]);
    DepthMatch::by_clock(frames.len(), FrameState::OffPulse, clock)
}
