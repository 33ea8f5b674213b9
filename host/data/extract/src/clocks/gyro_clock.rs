//! Conversion of the relation that [`twist_sync::estimate_course`] finds between another
//! device's clock (the phone's, the depth camera's) and the board's (clock a) over a whole
//! recording: to integers for the data sets, and to figures for the report.
//!
//! Limits: gyroscopes cannot measure the constant difference of the two low-pass
//! delays; it is configured, and its error stays in the result.

use crate::time::{BoardNanos, ClockNanos, SECOND};
use twist_sync::{ClockCourse, RecordingClock};

/// Largest number of knots of a relation: one a second for a month.
const MOST_KNOTS: i64 = 31 * 86_400;

/// Estimate of one window against the smoothed course.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct WindowResult {
    /// Board time, s.
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

/// Returns the estimates of a recording against its smoothed course.
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

/// Returns the root mean square of the windows' residuals, s; 0 without windows.
pub(crate) fn residual_rms(results: &[WindowResult]) -> f64 {
    let squares: f64 = results.iter().map(|w| w.residual_s * w.residual_s).sum();
    (squares / results.len().max(1) as f64).sqrt()
}

/// Converts a course to pairs of times in integers, one each second of board time from `from`,
/// and the last one at `to`.
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

/// Converts nanoseconds to seconds. Whole seconds and rest are converted separately, so that
/// the result is rounded once.
fn to_seconds(nanos: i64) -> f64 {
    nanos.div_euclid(SECOND) as f64 + nanos.rem_euclid(SECOND) as f64 * 1e-9
}
