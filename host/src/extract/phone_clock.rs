//! The phone's clock in board time: from both gyroscopes over the whole
//! recording; else from what the session found; else from the recorded offset of
//! the published system.

use super::board::{BoardError, BoardInput};
use super::gyro_clock::{Delays, GyroClock, GyroClockError, Prior, relate};
use super::phone::files::PhoneFiles;
use super::progress::Progress;
use super::report::{ClockReport, Constants};
use super::streams::{self, StreamError};
use super::survey::Survey;
use super::tables::ColorFrame;
use super::time::{BoardNanos, PhoneNanos, PiecewiseMap, SECOND};
use crate::sync::smoother::ClockCourse;
use crate::sync::{ClockModel, FrameTrain};
use crate::time::BoardSeconds;

/// How far a recorded offset may be off, s.
const RECORDED_MARGIN: f64 = 0.5;
/// How far the relation is laid out beyond the recording, s.
const BEYOND: i64 = 60;

/// A relation of phone and board.
#[derive(Clone, Debug)]
pub struct PhoneClock {
    /// Phone time to board time.
    pub map: PiecewiseMap<PhoneNanos, BoardNanos>,
    /// Worth knowing.
    pub remark: Option<String>,
    source: &'static str,
    gyros: Option<GyroClock>,
    course: Option<ClockCourse>,
    middle: BoardNanos,
}

/// Why looking for it ended.
#[derive(Debug)]
pub enum Stopped {
    /// The user stopped it.
    Cancelled,
    /// The board's recording cannot be read.
    Board(BoardError),
}

/// Finds the relation. The inner error says in words why there is none.
///
/// # Errors
///
/// Stopped, or the board's recording cannot be read.
pub fn find(
    board: &BoardInput,
    files: &PhoneFiles,
    survey: &Survey,
    prior: Option<Prior>,
    constants: &Constants,
    progress: &dyn Progress,
) -> Result<Result<PhoneClock, String>, Stopped> {
    let prior = prior
        .or(survey.clock.map(Prior::Model))
        .or_else(|| recorded_offset(survey));
    let (first, last) = (survey.imu.first_ns, survey.imu.last_ns);
    let span = (
        BoardNanos(first.saturating_sub(BEYOND * SECOND)),
        BoardNanos(last.saturating_add(BEYOND * SECOND)),
    );
    let middle = BoardNanos(first.midpoint(last));
    let Some(gyro) = &files.gyro else {
        return Ok(from_prior(
            prior,
            span,
            middle,
            "there is no gyroscope file of the phone",
        ));
    };
    if survey.imu.samples == 0 {
        return Ok(from_prior(
            prior,
            span,
            middle,
            "the board's recording has no IMU samples",
        ));
    }
    let delays = Delays {
        board: constants.board_imu_delay_ns as f64 * 1e-9,
        other: constants.phone_imu_delay_ns as f64 * 1e-9,
    };
    progress.begin(
        "relating the phone's clock",
        last.saturating_sub(first).unsigned_abs(),
    );
    let related = relate(
        &|| streams::board(board, progress),
        &|| streams::phone(gyro),
        prior,
        delays,
        1,
        &|at| progress.at(at.0.saturating_sub(first).unsigned_abs()),
    );
    progress.end();
    match related {
        Ok(gyros) => Ok(Ok(PhoneClock {
            map: gyros.pieces(span.0, span.1),
            remark: None,
            source: "gyroscopes",
            course: Some(gyros.course.clone()),
            gyros: Some(gyros),
            middle,
        })),
        Err(GyroClockError::Read(StreamError::Cancelled)) => Err(Stopped::Cancelled),
        Err(GyroClockError::Read(StreamError::Board(error))) => Err(Stopped::Board(error)),
        Err(error) => Ok(from_prior(prior, span, middle, &error.to_string())),
    }
}

/// The published system's `/mcu_s10_ts`: the last pair of times.
fn recorded_offset(survey: &Survey) -> Option<Prior> {
    let is_it = |topic: &str| topic.ends_with("mcu_s10_ts");
    let pair = survey.times.iter().rev().find(|pair| is_it(&pair.topic))?;
    let offset = pair.other.checked_sub(pair.stamp.0)?;
    Some(Prior::Offset(offset as f64 * 1e-9, RECORDED_MARGIN))
}

fn from_prior(
    prior: Option<Prior>,
    span: (BoardNanos, BoardNanos),
    middle: BoardNanos,
    why: &str,
) -> Result<PhoneClock, String> {
    match prior {
        None => Err(format!("phone time cannot be related to board time: {why}")),
        Some(Prior::Model(model)) => {
            let course = ClockCourse::from_estimates(&[model], model.wander)
                .ok_or_else(|| "the session's clock model is not usable".to_owned())?;
            Ok(PhoneClock {
                map: lay_out(&course, span),
                remark: Some(format!(
                    "the clock relation is the session's, from the twist alone, and not from the whole \
                     recording: {why}"
                )),
                source: "session",
                gyros: None,
                course: Some(course),
                middle,
            })
        }
        Some(Prior::Offset(offset, _)) => {
            let nanos = (offset * 1e9).round() as i64;
            let knot = |at: BoardNanos| (PhoneNanos(at.0.saturating_add(nanos)), at);
            Ok(PhoneClock {
                map: PiecewiseMap::from_knots([knot(span.0), knot(span.1)]),
                remark: Some(format!(
                    "the clock relation is the one offset that was recorded, without the drift of the \
                     clocks: {why}"
                )),
                source: "bag",
                gyros: None,
                course: None,
                middle,
            })
        }
    }
}

fn lay_out(
    course: &ClockCourse,
    span: (BoardNanos, BoardNanos),
) -> PiecewiseMap<PhoneNanos, BoardNanos> {
    super::gyro_clock::lay_out(course, span.0, span.1)
}

impl PhoneClock {
    /// The relation at a board time, with its uncertainty.
    #[must_use]
    pub fn model_at(&self, at: BoardNanos) -> Option<ClockModel> {
        let course = self.course.as_ref()?;
        Some(course.at(BoardSeconds(at.0 as f64 * 1e-9)))
    }

    /// What the report says about it, over these frames.
    #[must_use]
    pub fn report(&self, frames: &[ColorFrame]) -> ClockReport {
        let middle = self.model_at(self.middle);
        let sigmas = frames
            .iter()
            .step_by(30)
            .filter_map(|frame| self.model_at(frame.at))
            .map(|model| model.covariance[0][0].max(0.0).sqrt() * 1e6);
        let range = sigmas.fold(None, |range: Option<[f64; 2]>, sigma| {
            let [low, high] = range.unwrap_or([sigma, sigma]);
            Some([low.min(sigma), high.max(sigma)])
        });
        let phone: Vec<PhoneNanos> = frames.iter().map(|frame| frame.phone).collect();
        ClockReport {
            source: self.source,
            windows: self.gyros.as_ref().map_or(0, |gyros| gyros.windows),
            used: self.gyros.as_ref().map_or(0, |gyros| gyros.course.used),
            contradicting: self
                .gyros
                .as_ref()
                .map_or(0, |gyros| gyros.course.contradicting),
            offset_s: middle.map_or(0.0, |model| model.offset),
            skew_ppm: middle.map_or(0.0, |model| model.skew * 1e6),
            skew_sigma_ppm: middle
                .map_or(0.0, |model| model.covariance[1][1].max(0.0).sqrt() * 1e6),
            sigma_us: range.unwrap_or([0.0, 0.0]),
            residual_us: self
                .gyros
                .as_ref()
                .map_or(0.0, |gyros| gyros.residual_rms() * 1e6),
            frame_period_ns: FrameTrain::from_timestamps(&phone)
                .map(|train| (train.period_s * 1e9, train.period_sigma_s * 1e9)),
            course: self
                .gyros
                .as_ref()
                .map_or_else(Vec::new, |gyros| gyros.results.clone()),
        }
    }
}
