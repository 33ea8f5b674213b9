//! Gyroscopes of all devices as streams that can be opened more than once.

use std::io;
use std::path::{Path, PathBuf};

use crate::depth::{DepthError, DepthInput};
use crate::error::ExtractError;
use crate::inputs::board_data::{BoardEvent, BoardStream};
use crate::inputs::phone_rows::PhoneRows;
use crate::time::BoardNanos;
use system::ReadMonitor;
use twist_sync::{
    CourseError, GyroOpener, GyroSample, GyroStream, Options, Prior, RecordingClock,
    estimate_course,
};

/// Reason why a stream ended early.
#[derive(Debug, thiserror::Error)]
pub(crate) enum StreamError {
    /// The board's recording cannot be read.
    #[error(transparent)]
    Board(#[from] recording::RecordingError),
    /// The depth recording cannot be read.
    #[error(transparent)]
    Depth(#[from] DepthError),
    /// A file of the phone cannot be read.
    #[error("reading {path}: {error}")]
    Phone {
        /// The file.
        path: PathBuf,
        /// The reason.
        error: io::Error,
    },
}

/// Part of a recording, in board time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Span {
    pub(crate) from: BoardNanos,
    pub(crate) to: BoardNanos,
}

/// Gyroscope whose clock is to be related to the board's.
pub(crate) struct OtherGyro<'a> {
    pub(crate) open: GyroOpener<'a, StreamError>,
    pub(crate) options: Options,
    pub(crate) prior: Option<Prior>,
}

/// Calls `each` for everything that the board recorded. Returns descriptions of messages that were
/// left out.
///
/// # Errors
///
/// Fails if the recording cannot be read, or with the error of `each`.
pub(crate) fn each_event(
    board: &Path,
    monitor: &ReadMonitor,
    mut each: impl FnMut(BoardEvent) -> Result<(), ExtractError>,
) -> Result<Vec<String>, ExtractError> {
    let mut stream = BoardStream::open(board, monitor)?;
    while let Some(event) = stream.next_event()? {
        each(event)?;
    }
    Ok(stream.left_out())
}

/// Opens the board's gyroscope within a span, without the samples that the board marked: the rates
/// of a late sample belong to another time.
///
/// # Errors
///
/// Fails if the recording cannot be opened.
fn board<'a>(
    board: &Path,
    span: Span,
    monitor: &ReadMonitor,
) -> Result<GyroStream<'a, StreamError>, StreamError> {
    let mut stream = BoardStream::open(board, monitor)?;
    let mut last = span.from.0.saturating_sub(1);
    Ok(Box::new(std::iter::from_fn(move || {
        loop {
            let sample = match stream.next_event() {
                Err(error) => return Some(Err(error.into())),
                Ok(None) => return None,
                Ok(Some(BoardEvent::Sample(sample))) if !sample.is_marked => sample,
                Ok(Some(_)) => continue,
            };
            let at = sample.stamp.nanos();
            if at > span.to.0 {
                return None;
            }
            // Windows are cut in order of time.
            if at > last {
                last = at;
                return Some(Ok(GyroSample {
                    at,
                    rate: sample.gyro,
                }));
            }
        }
    })))
}

/// Relates the clock of another gyroscope to the board's.
///
/// # Errors
///
/// Fails if there is no relation, or if the board's recording cannot be read.
pub(crate) fn related<'a>(
    board: &'a Path,
    span: Span,
    other: &OtherGyro<'a>,
    monitor: &ReadMonitor,
) -> Result<RecordingClock, ExtractError> {
    let open_board = || self::board(board, span, monitor);
    let (prior, options) = (other.prior, &other.options);
    let related = estimate_course(&open_board, other.open, prior, options);
    related.map_err(|error| match error {
        CourseError::Read(StreamError::Board(error)) => ExtractError::Board(error),
        error => ExtractError::Missing(error.to_string()),
    })
}

/// Opens the phone's gyroscope.
///
/// # Errors
///
/// Fails if the file cannot be opened.
pub(crate) fn phone<'a>(
    path: &Path,
    monitor: &ReadMonitor,
) -> Result<GyroStream<'a, StreamError>, StreamError> {
    let fail = {
        let path = path.to_owned();
        move |error| StreamError::Phone {
            path: path.clone(),
            error,
        }
    };
    let mut rows = PhoneRows::open(path, monitor).map_err(&fail)?;
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

/// Opens the depth camera's gyroscope.
///
/// # Errors
///
/// Fails if the file cannot be opened.
pub(crate) fn camera<'a>(
    input: &DepthInput,
    monitor: &ReadMonitor,
) -> Result<GyroStream<'a, StreamError>, StreamError> {
    Ok(Box::new(input.gyro(monitor)?.map(|sample| Ok(sample?))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inputs::survey::survey;
    use board::imu::Sample;
    use protocol::{ImuFlags, Ticks};

    #[test]
    fn samples_marked_by_the_board_are_not_used_for_clock_relations() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = recording::writer::Writer::create(folder.path()).unwrap();
        let flags = [
            ImuFlags(0),
            ImuFlags::LATE,
            ImuFlags::FIRST,
            ImuFlags::SATURATED,
        ];
        for (number, flags) in (0..).zip(flags) {
            let sample = Sample {
                at: Ticks(48_000_000 + u64::from(number) * 96_000),
                flags,
                gyro: [f64::from(number), 0.0, 0.0],
                ..Sample::default()
            };
            writer.imu(&sample, number).unwrap();
        }
        writer.finish().unwrap();
        let path = folder.path().join(recording::MCAP_FILE);
        let span = Span {
            from: BoardNanos(0),
            to: BoardNanos(i64::MAX),
        };
        let monitor = ReadMonitor::default();
        let kept = board(&path, span, &monitor)
            .unwrap()
            .map(|sample| sample.unwrap().rate[0]);
        assert_eq!(kept.collect::<Vec<_>>(), [0.0, 2.0]);
        let imu = survey(&path, None, &monitor).unwrap().imu;
        assert_eq!((imu.samples, imu.marked), (4, 2));
    }
}
