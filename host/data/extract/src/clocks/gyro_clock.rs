//! The relation of another device's clock (the phone's, the depth camera's) to the
//! board's over a whole recording, as the data sets need it: in integers, and as
//! the report tells it. It is found by [`twist_sync::estimate_course`], with the
//! board as clock a.
//!
//! Limits: what gyroscopes cannot see, the constant difference of the two low-pass
//! delays, goes in as configuration and stays in the result.

use crate::time::{BoardNanos, ClockNanos, SECOND};
use clock::ClockRelation;
use twist_sync::{ClockCourse, Prior, RecordingClock};

/// Most knots of a relation laid out: a month.
const MOST_KNOTS: i64 = 31 * 86_400;

/// The session's clock model as what is known beforehand.
pub(crate) fn prior(model: ClockRelation) -> Prior {
    Prior::Relation(model)
}

/// One window's estimate against the smoothed course.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct WindowResult {
    /// Board time of the estimate, s.
    pub board_s: f64,
    /// Other − board at that time, s.
    pub offset_s: f64,
    /// 1-sigma of the estimate, s.
    pub sigma_s: f64,
    /// Estimate − smoothed course, s.
    pub residual_s: f64,
    /// 1-sigma of the smoothed course, s.
    pub course_sigma_s: f64,
}

/// The estimates of a recording against its course.
pub(crate) fn window_results(clock: &RecordingClock) -> Vec<WindowResult> {
    clock
        .estimates
        .iter()
        .map(|estimate| {
            let smoothed = clock.course.at(estimate.reference);
            WindowResult {
                board_s: estimate.reference,
                offset_s: estimate.offset,
                sigma_s: estimate.covariance[0][0].max(0.0).sqrt(),
                residual_s: estimate.offset - smoothed.offset,
                course_sigma_s: smoothed.covariance[0][0].max(0.0).sqrt(),
            }
        })
        .collect()
}

/// Root mean square of the windows' residuals, s; 0 with none.
pub(crate) fn residual_rms(results: &[WindowResult]) -> f64 {
    let squares: f64 = results.iter().map(|w| w.residual_s * w.residual_s).sum();
    (squares / results.len().max(1) as f64).sqrt()
}

/// A course in integers: pairs of times, one each second of board time from `from`,
/// the last one at `to`.
pub(crate) fn knots<T: ClockNanos>(
    course: &ClockCourse,
    from: BoardNanos,
    to: BoardNanos,
) -> Vec<(T, BoardNanos)> {
    let seconds = (to.0.saturating_sub(from.0) / SECOND).clamp(0, MOST_KNOTS);
    (0..=seconds)
        .map(|second| from.0.saturating_add(second * SECOND))
        .chain([to.0])
        .map(|board| {
            let offset = course.at(to_seconds(board)).offset;
            let offset = (offset * 1e9).round() as i64;
            (
                T::from_nanos(board.saturating_add(offset)),
                BoardNanos(board),
            )
        })
        .collect()
}

/// Nanoseconds in seconds; the whole and the rest apart, so that it is rounded once.
fn to_seconds(nanos: i64) -> f64 {
    nanos.div_euclid(SECOND) as f64 + nanos.rem_euclid(SECOND) as f64 * 1e-9
}
