//! Which depth frame has which pulse: the pattern first, and where it does not
//! decide, what else there is. Over a reset of the board the camera's clock leads
//! from one run to the next.
//!
//! In this order: the pulse that the user gives; the pattern of the pulses; the
//! camera's own gyroscope against the board's (its recorder writes an IMU track
//! unless told not to), which gives the offset of the clocks far better than half
//! a period; the recorded offset of the published system.

use super::board_data::BoardInput;
use super::depth::{DepthIndex, DepthInput};
use super::depth_clock::{
    Ambiguity, Decision, DepthMatch, FrameState, Hint, MatchError, match_frames,
};
use super::gyro_clock;
use super::later_runs::depth::{OverResets, Reset, match_over_resets};
use super::progress::Progress;
use super::report::Constants;
use super::streams::{self, Stopped};
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
    /// Frames without a board time, in words.
    pub(crate) losses: Vec<String>,
    by: &'static str,
}

impl Matched {
    fn new(found: DepthMatch) -> Self {
        Self {
            found,
            remarks: Vec::new(),
            losses: Vec::new(),
            by: "the pattern",
        }
    }

    fn by(self, by: &'static str) -> Self {
        Self { by, ..self }
    }

    fn over_resets(over: &OverResets) -> Self {
        let anchor = over.anchor + 1;
        let carried = over.carried.iter().map(|run| {
            format!(
                "the depth camera's clock leads over the reset from run {anchor} of the board to run {}, \
                 whose depth frames lie {:+.1} µs from where it has them (± {:.1} µs, 1-sigma)",
                run.run + 1,
                run.off / 1000.0,
                run.sigma / 1000.0
            )
        });
        let mut remarks: Vec<String> = carried.collect();
        if over.in_gaps > 0 {
            remarks.push(format!(
                "{} depth frames lie where the board was reset, and no pulse made them: they are timed by \
                 the camera's clock",
                over.in_gaps
            ));
        }
        let left_out = over.left_out.iter().filter(|run| run.frames > 0);
        let losses = left_out.map(|run| {
            format!(
                "{} depth frames of run {} of the board have no board time: which pulse each has is not \
                 found from run {anchor}, and not guessed: {}",
                run.frames,
                run.run + 1,
                run.why
            )
        });
        Self {
            losses: losses.collect(),
            remarks,
            ..Self::new(over.found.clone())
        }
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
    pub(crate) board: &'a BoardInput,
    pub(crate) input: &'a DepthInput,
    pub(crate) index: &'a DepthIndex,
    pub(crate) survey: &'a Survey,
    pub(crate) constants: &'a Constants,
    pub(crate) progress: &'a dyn Progress,
}

impl Matching<'_> {
    /// Matches depth frames to pulses.
    ///
    /// # Errors
    ///
    /// Stopped, or the board's recording cannot be read. The inner error says why
    /// frames and pulses were not matched.
    pub(crate) fn find(
        &self,
        first_pulse: Option<usize>,
    ) -> Result<Result<Matched, MatchError>, Stopped> {
        let frames: Vec<DeviceNanos> = self.index.frames.iter().map(|frame| frame.at).collect();
        let pulses = &self.survey.pulses;
        let resets = resets(self.survey);
        let look = |hint| {
            if resets.is_empty() {
                return match_frames(&frames, pulses, hint).map(Matched::new);
            }
            let over = match_over_resets(&frames, pulses, &resets, hint)?;
            Ok(Matched::over_resets(&over))
        };
        self.progress.begin("matching depth frames to pulses", 0);
        let found = look(first_pulse.map(Hint::FirstPulse));
        self.progress.end();
        if first_pulse.is_some() {
            return Ok(found.map(|found| found.by("the user")));
        }
        let error = match found {
            Ok(found) => return Ok(Ok(found)),
            Err(MatchError::Ambiguous(left)) => MatchError::Ambiguous(Ambiguity {
                has_imu: self.index.has_imu,
                ..left
            }),
            Err(error) => error,
        };
        if let MatchError::Ambiguous(_) | MatchError::OverReset { .. } = error {
            let hint = if self.index.has_imu {
                self.camera_hint()?
            } else {
                None
            };
            if let Some(hint) = hint {
                return Ok(look(Some(hint)).map(|found| found.by("the camera's gyroscope")));
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
                    return Ok(Ok(found.by("the recorded offset")));
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
            return Ok(Ok(found.by("the recorded offset")));
        }
        Ok(Err(error))
    }

    /// Times the frames of a camera that ran on its own clock, through its gyroscope and the
    /// board's. The inner error says why that is not possible.
    ///
    /// # Errors
    ///
    /// Stopped, or the board's recording cannot be read.
    pub(crate) fn free_running(&self) -> Result<Result<Matched, MatchError>, Stopped> {
        let failed = |why: &str| {
            Ok(Err(MatchError::NoGyro {
                why: why.to_owned(),
            }))
        };
        if !self.index.has_imu {
            return failed(
                "the recording has no samples of the camera's IMU; record with the IMU on",
            );
        }
        if !self.survey.runs.is_empty() {
            return failed("the board was reset in the recording");
        }
        let clock = match self.camera_clock(1)? {
            Ok(clock) => clock,
            Err(why) => return failed(&why),
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
        Ok(Ok(matched.by("the camera's own clock")))
    }

    fn camera_hint(&self) -> Result<Option<Hint>, Stopped> {
        // Without a relation the pulses stay ambiguous, which is what is said.
        let Ok(clock) = self.camera_clock(EVERY)? else {
            return Ok(None);
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
    fn camera_clock(&self, every: usize) -> Result<Result<RecordingClock, String>, Stopped> {
        let options = Options {
            a_delay_s: self.constants.board_imu_delay_ns as f64 * 1e-9,
            ..Options::of_windows()
        };
        let (first, last) = (self.survey.imu.first_ns, self.survey.imu.last_ns);
        streams::related(
            "relating the depth camera's clock by its gyroscope",
            (self.board, (BoardNanos(first), BoardNanos(last))),
            (&|| streams::camera(self.input, self.progress), &options),
            None,
            every,
            self.progress,
        )
    }
}

/// Where the board's runs after resets begin among the pulses. A run without pulses is
/// none here; its uncertainty goes to the next.
fn resets(survey: &Survey) -> Vec<Reset> {
    let first_at = |at: BoardNanos| survey.pulses.partition_point(|pulse| pulse.at < at);
    let mut resets: Vec<Reset> = Vec::new();
    for mark in &survey.runs {
        let (first_pulse, sigma) = (first_at(mark.from), mark.sigma_s * 1e9);
        if first_pulse == 0 || first_pulse == survey.pulses.len() {
            continue;
        }
        match resets.last_mut() {
            Some(last) if last.first_pulse == first_pulse => last.sigma = last.sigma.hypot(sigma),
            _ => resets.push(Reset { first_pulse, sigma }),
        }
    }
    resets
}

/// Board − depth stamp by the published system's `/depth_to_mcu_offset`.
fn recorded_offset(survey: &Survey) -> Option<i64> {
    let is_it = |topic: &str| topic.ends_with("depth_to_mcu_offset");
    let pair = survey.times.iter().find(|pair| is_it(&pair.topic))?;
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
