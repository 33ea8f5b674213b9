//! The relation of another device's clock (the phone's, the depth camera's) to the
//! board's, from both gyroscopes, over a whole recording.
//!
//! The recording is cut into windows of [`twist_sync::smoother`]'s length. Each
//! window with enough motion gives an estimate by [`estimate_offset`], with its
//! gates; the estimates are joined by the smoother, which knows how clocks wander.
//! Both gyroscopes are *streamed*: a few windows are in memory at a time, so that
//! a recording of hours needs no more than one of minutes. The windows of a batch
//! are estimated in parallel.
//!
//! Where to look for the offset is known from the session (the twist), or found
//! by [`search`]: the correlation of the turning rates over the whole recording.
//!
//! Limits: what gyroscopes cannot see, the constant difference of the two
//! low-pass delays, goes in as configuration ([`Delays`]) and stays in the result.

pub mod search;

use std::collections::VecDeque;

use rayon::prelude::*;

use super::time::{BoardNanos, ClockNanos, PiecewiseMap, SECOND};
use timebase::ClockModel;
use twist_sync::smoother::{ClockCourse, WindowOptions};
use twist_sync::{ClockRelation, GyroTrack, Options, estimate_offset};

/// Windows that are estimated at a time.
const BATCH: usize = 8;
/// Least half-width of the search around the expected offset, s.
const LEAST_MARGIN: f64 = 0.1;
/// Largest half-width, s.
const MOST_MARGIN: f64 = 5.0;
/// Two clocks are this far apart in rate at most.
const MOST_SKEW: f64 = 500e-6;
/// Most knots of a relation laid out: a month.
const MOST_KNOTS: i64 = 31 * 86_400;
/// Most samples of one window: a stream with more of them in that time is damaged.
const MAX_WINDOW_SAMPLES: usize = 200_000;

/// One sample of a gyroscope in its own clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GyroSample {
    /// Nanoseconds.
    pub at: i64,
    /// rad/s.
    pub rate: [f64; 3],
}

/// Samples in order of time.
pub type GyroStream<'a, E> = Box<dyn Iterator<Item = Result<GyroSample, E>> + 'a>;

/// Opens a gyroscope's recording at its beginning.
pub type GyroOpener<'a, E> = &'a dyn Fn() -> Result<GyroStream<'a, E>, E>;

/// Delays of the two low-pass filters, in seconds: subtracted from the timestamps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Delays {
    /// Of the board's gyroscope.
    pub board: f64,
    /// Of the other gyroscope.
    pub other: f64,
}

/// What is known beforehand about the relation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Prior {
    /// A clock model, as the session found it.
    Model(ClockRelation),
    /// Other − board in seconds, within a half-width in seconds.
    Offset(f64, f64),
}

impl Prior {
    /// The session's clock model.
    #[must_use]
    pub fn of(model: ClockModel) -> Self {
        Self::Model(model.into())
    }
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

/// The relation over the recording.
#[derive(Clone, Debug, PartialEq)]
pub struct GyroClock {
    /// Offset and skew over time.
    pub course: ClockCourse,
    /// Windows with data of both.
    pub windows: usize,
    /// The windows that were accepted.
    pub results: Vec<WindowResult>,
}

/// Why there is no relation.
#[derive(Debug, thiserror::Error)]
pub enum GyroClockError<E: std::error::Error + 'static> {
    /// Reading one of the recordings failed.
    #[error(transparent)]
    Read(#[from] E),
    /// No part of the recordings can be related.
    #[error(
        "the two gyroscopes cannot be related: {0}; twist the rig by hand at the beginning of a recording"
    )]
    NoRelation(String),
}

/// Root mean square of the windows' residuals, s; 0 with none.
#[must_use]
pub fn residual_rms(results: &[WindowResult]) -> f64 {
    let squares: f64 = results.iter().map(|w| w.residual_s * w.residual_s).sum();
    (squares / results.len().max(1) as f64).sqrt()
}

impl GyroClock {
    /// Root mean square of the windows' residuals, s; 0 with none.
    #[must_use]
    pub fn residual_rms(&self) -> f64 {
        residual_rms(&self.results)
    }

    /// The relation in integers, with a knot each second from `from` to `to` of
    /// board time.
    #[must_use]
    pub fn pieces<T: ClockNanos>(
        &self,
        from: BoardNanos,
        to: BoardNanos,
    ) -> PiecewiseMap<T, BoardNanos> {
        lay_out(&self.course, from, to)
    }
}

/// A course in integers, with a knot each second from `from` to `to` of board time.
#[must_use]
pub fn lay_out<T: ClockNanos>(
    course: &ClockCourse,
    from: BoardNanos,
    to: BoardNanos,
) -> PiecewiseMap<T, BoardNanos> {
    // One more: the last line goes on beyond the end.
    let end = BoardNanos(to.0.saturating_add(2 * SECOND));
    let all = knots(course, from, end);
    PiecewiseMap::from_knots(all)
}

/// The same as pairs of times, the last one at `to`.
#[must_use]
pub fn knots<T: ClockNanos>(
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

/// Relates the clocks over the whole recording. `every` takes each n-th window
/// only (1: all).
///
/// # Errors
///
/// Reading fails, or no window can be related.
pub fn relate<E: std::error::Error + Send + 'static>(
    board: GyroOpener<'_, E>,
    other: GyroOpener<'_, E>,
    prior: Option<Prior>,
    delays: Delays,
    every: usize,
    progress: &dyn Fn(BoardNanos),
) -> Result<GyroClock, GyroClockError<E>> {
    let settings = WindowOptions::default();
    let options = Options {
        mcu_delay_s: delays.board,
        phone_delay_s: delays.other,
        ..settings.estimate
    };
    let expected = match prior {
        Some(Prior::Model(model)) => Expected::Model(model),
        Some(Prior::Offset(offset, margin)) => Expected::Offset(offset, margin),
        None => Expected::Model(search::first_relation(board, other, &options)?),
    };
    let mut windows = Windows {
        board: board()?,
        board_next: None,
        other: other()?,
        buffer: VecDeque::new(),
        other_ended: false,
        length: (settings.window_s * 1e9) as i64,
    };
    let mut expected = expected;
    let mut estimates: Vec<ClockRelation> = Vec::new();
    let mut refusal = None;
    let mut count = 0;
    loop {
        let mut batch = Vec::with_capacity(BATCH);
        let mut ended = false;
        while batch.len() < BATCH {
            let Some(track) = windows.next_board()? else {
                ended = true;
                break;
            };
            count += 1;
            progress(BoardNanos(last_nanos(&track)));
            if (count - 1) % every.max(1) != 0 {
                continue;
            }
            let (offset, margin) = expected.at(&track);
            let part = windows.other_part(&track, offset, margin)?;
            batch.push((track, part, offset, margin));
            // Until the first estimate, each window is judged before the next:
            // its result makes the search of all others narrow.
            if estimates.is_empty() {
                break;
            }
        }
        let results: Vec<_> = batch
            .par_iter()
            .map(|(track, part, offset, margin)| {
                let options = Options {
                    search: Some((*offset, *margin)),
                    ..options
                };
                estimate_offset(track, part, &options)
            })
            .collect();
        for result in results {
            match result {
                Ok(estimate) => {
                    expected = Expected::Model(estimate.clock);
                    estimates.push(estimate.clock);
                }
                Err(error) => refusal = refusal.or(Some(error)),
            }
        }
        if ended {
            break;
        }
    }
    let course = ClockCourse::from_estimates(&estimates, options.wander).ok_or_else(|| {
        GyroClockError::NoRelation(refusal.map_or_else(
            || "they have no time in common".into(),
            |refusal| refusal.to_string(),
        ))
    })?;
    let results = estimates
        .iter()
        .map(|estimate| {
            let smoothed = course.at(estimate.reference);
            WindowResult {
                board_s: estimate.reference,
                offset_s: estimate.offset,
                sigma_s: estimate.covariance[0][0].max(0.0).sqrt(),
                residual_s: estimate.offset - smoothed.offset,
                course_sigma_s: smoothed.covariance[0][0].max(0.0).sqrt(),
            }
        })
        .collect();
    Ok(GyroClock {
        course,
        windows: count,
        results,
    })
}

/// Where a window's offset is expected.
enum Expected {
    Model(ClockRelation),
    Offset(f64, f64),
}

impl Expected {
    /// Offset and half-width of the search at a window.
    fn at(&self, track: &GyroTrack) -> (f64, f64) {
        let middle = track.epoch_s + 0.5 * track.t.last().copied().unwrap_or(0.0);
        match self {
            Self::Offset(offset, margin) => (*offset, margin.clamp(LEAST_MARGIN, MOST_MARGIN)),
            Self::Model(model) => {
                let offset = model.offset_at(middle);
                let distance = (middle - model.reference).abs();
                let drift = (6.0 * offset.sigma).min(MOST_SKEW * distance);
                let known = 6.0 * model.covariance[0][0].max(0.0).sqrt();
                (
                    offset.value,
                    (LEAST_MARGIN + known + drift).min(MOST_MARGIN),
                )
            }
        }
    }
}

fn last_nanos(track: &GyroTrack) -> i64 {
    ((track.epoch_s + track.t.last().copied().unwrap_or(0.0)) * 1e9) as i64
}

/// Cuts two streams into windows.
struct Windows<'a, E> {
    board: GyroStream<'a, E>,
    board_next: Option<GyroSample>,
    other: GyroStream<'a, E>,
    /// Samples of the other stream that a window may still need.
    buffer: VecDeque<GyroSample>,
    other_ended: bool,
    /// ns.
    length: i64,
}

impl<E> Windows<'_, E> {
    fn next_board(&mut self) -> Result<Option<GyroTrack>, E> {
        let first = match self.board_next.take() {
            Some(sample) => sample,
            None => match self.board.next().transpose()? {
                Some(sample) => sample,
                None => return Ok(None),
            },
        };
        let mut samples = vec![first];
        let end = first.at.saturating_add(self.length);
        while let Some(sample) = self.board.next().transpose()? {
            if sample.at >= end || samples.len() >= MAX_WINDOW_SAMPLES {
                self.board_next = Some(sample);
                break;
            }
            samples.push(sample);
        }
        Ok(Some(track(&samples)))
    }

    /// The other stream around a window. Windows come in order of time.
    fn other_part(&mut self, window: &GyroTrack, offset: f64, margin: f64) -> Result<GyroTrack, E> {
        let nanos = |seconds: f64| (seconds * 1e9) as i64;
        let from = nanos(window.epoch_s + offset - margin);
        let last = window.t.last().copied().unwrap_or(0.0);
        let to = nanos(window.epoch_s + last + offset + margin);
        // The next window may look back by as much as its own margin.
        let keep = from.saturating_sub(nanos(2.0 * MOST_MARGIN));
        while !self.other_ended && self.buffer.back().is_none_or(|sample| sample.at < to) {
            match self.other.next().transpose()? {
                Some(sample) if sample.at >= keep => self.buffer.push_back(sample),
                Some(_) => {}
                None => self.other_ended = true,
            }
        }
        while self.buffer.front().is_some_and(|sample| sample.at < keep) {
            self.buffer.pop_front();
        }
        let within = |sample: &&GyroSample| sample.at >= from && sample.at < to;
        let samples: Vec<GyroSample> = self
            .buffer
            .iter()
            .filter(within)
            .take(MAX_WINDOW_SAMPLES)
            .copied()
            .collect();
        Ok(track(&samples))
    }
}

/// A track for the sync math; differences are taken in integers.
fn track(samples: &[GyroSample]) -> GyroTrack {
    let epoch = samples.first().map_or(0, |sample| sample.at);
    GyroTrack {
        epoch_s: to_seconds(epoch),
        t: samples
            .iter()
            .map(|sample| (i128::from(sample.at) - i128::from(epoch)) as f64 * 1e-9)
            .collect(),
        w: samples.iter().map(|sample| sample.rate).collect(),
    }
}
