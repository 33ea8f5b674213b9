//! Gyroscopes of all devices as streams that can be opened again.

use std::io;
use std::path::{Path, PathBuf};

use super::board_data::{BoardError, BoardEvent, BoardInput, Images};
use super::depth::{DepthError, DepthInput};
use super::phone_rows::PhoneRows;
use super::progress::Progress;
use super::time::BoardNanos;
use twist_sync::{
    GyroOpener, GyroSample, GyroStream, Options, Prior, RecordingClock, RecordingError,
    estimate_course,
};

/// Samples between two looks at whether to stop.
const LOOK: u64 = 8192;

/// Why a stream ended early.
#[derive(Debug, thiserror::Error)]
pub(crate) enum StreamError {
    /// The board's recording.
    #[error(transparent)]
    Board(#[from] BoardError),
    /// The depth recording.
    #[error(transparent)]
    Depth(#[from] DepthError),
    /// A file of the phone.
    #[error("reading {path}: {error}")]
    Phone {
        /// Which.
        path: PathBuf,
        /// Why.
        error: io::Error,
    },
    /// Stopped.
    #[error("stopped")]
    Cancelled,
}

/// Why a step of the extraction ended before its end.
#[derive(Debug)]
pub(crate) enum Stopped {
    /// The user stopped it.
    Cancelled,
    /// The board's recording cannot be read.
    Board(BoardError),
}

/// Goes over all that the board recorded, and gives back what could not be read.
pub(crate) fn each_event<E: From<Stopped>>(
    input: &BoardInput,
    images: Images,
    what: &str,
    progress: &dyn Progress,
    mut each: impl FnMut(BoardEvent) -> Result<(), E>,
) -> Result<Vec<String>, E> {
    let mut stream = input.open(images).map_err(Stopped::Board)?;
    let length = std::fs::metadata(input.path()).map_or(0, |meta| meta.len());
    progress.begin(what, length);
    let mut count = 0_u64;
    while let Some(event) = stream.next_event().map_err(Stopped::Board)? {
        each(event)?;
        count += 1;
        if count.is_multiple_of(LOOK) {
            progress.at(stream.position());
            if progress.cancelled() {
                return Err(Stopped::Cancelled.into());
            }
        }
    }
    progress.end();
    Ok(stream.damage())
}

/// The board's gyroscope within a span.
///
/// # Errors
///
/// The recording cannot be opened.
fn board<'a>(
    input: &BoardInput,
    (from, to): (BoardNanos, BoardNanos),
    progress: &'a dyn Progress,
) -> Result<GyroStream<'a, StreamError>, StreamError> {
    let mut stream = input.open(Images::Skip)?;
    let mut count = 0_u64;
    let mut last = from.0.saturating_sub(1);
    Ok(Box::new(std::iter::from_fn(move || {
        loop {
            count += 1;
            if count.is_multiple_of(LOOK) && progress.cancelled() {
                return Some(Err(StreamError::Cancelled));
            }
            match stream.next_event() {
                Err(error) => return Some(Err(error.into())),
                Ok(None) => return None,
                Ok(Some(BoardEvent::Imu(row))) if row.at > to => return None,
                // Windows are cut in order of time.
                Ok(Some(BoardEvent::Imu(row))) if row.at.0 > last => {
                    last = row.at.0;
                    return Some(Ok(GyroSample {
                        at: last,
                        rate: row.gyro,
                    }));
                }
                Ok(Some(_)) => {}
            }
        }
    })))
}

/// Relates the clock of another gyroscope to the board's within a span, taking each
/// `every`-th window. The inner error says in words why there is no relation.
pub(crate) fn related<'a>(
    what: &str,
    (input, (from, to)): (&'a BoardInput, (BoardNanos, BoardNanos)),
    (other, options): (GyroOpener<'a, StreamError>, &Options),
    prior: Option<Prior>,
    every: usize,
    progress: &'a dyn Progress,
) -> Result<Result<RecordingClock, String>, Stopped> {
    let way = |at: BoardNanos| at.0.saturating_sub(from.0).unsigned_abs();
    progress.begin(what, way(to));
    let board = || board(input, (from, to), progress);
    let related = estimate_course(&board, other, prior, options, every, &|at| {
        progress.at(way(BoardNanos(at)));
    });
    progress.end();
    match related {
        Ok(clock) => Ok(Ok(clock)),
        Err(RecordingError::Read(StreamError::Cancelled)) => Err(Stopped::Cancelled),
        Err(RecordingError::Read(StreamError::Board(error))) => Err(Stopped::Board(error)),
        Err(error) => Ok(Err(error.to_string())),
    }
}

/// The phone's gyroscope.
///
/// # Errors
///
/// The file cannot be opened.
pub(crate) fn phone<'a>(path: &Path) -> Result<GyroStream<'a, StreamError>, StreamError> {
    let fail = {
        let path = path.to_owned();
        move |error| StreamError::Phone {
            path: path.clone(),
            error,
        }
    };
    let mut rows = PhoneRows::open(path).map_err(&fail)?;
    Ok(Box::new(std::iter::from_fn(move || {
        match rows.next_sample() {
            Ok(sample) => sample.map(|sample| {
                Ok(GyroSample {
                    at: sample.time.0,
                    rate: sample.xyz,
                })
            }),
            Err(error) => Some(Err(fail(error))),
        }
    })))
}

/// The depth camera's gyroscope.
///
/// # Errors
///
/// The file cannot be opened.
pub(crate) fn camera<'a>(
    input: &DepthInput,
    progress: &'a dyn Progress,
) -> Result<GyroStream<'a, StreamError>, StreamError> {
    let mut count = 0_u64;
    Ok(Box::new(input.gyro()?.map(move |sample| {
        count += 1;
        if count.is_multiple_of(LOOK) && progress.cancelled() {
            return Err(StreamError::Cancelled);
        }
        Ok(sample?)
    })))
}
