//! Times of the frames.
//!
//! The phone's app writes them beside the video ([`phone::frame_timestamps`]).
//! Without such a file a constant frame rate is assumed. Only differences
//! of these times are used, and in a recording their distance from the board's pulses.

use std::path::{Path, PathBuf};

use phone::rows::{LATER, RowError};
use phone::{frame_timestamps, video_files};
use system::ReadMonitor;

use crate::EvaluateError;

/// Times of the frames of one input.
#[derive(Debug, Clone, PartialEq)]
pub enum FrameTimes {
    /// One time for each frame in nanoseconds of the camera's clock, ascending.
    Listed(Vec<i64>),
    /// A constant rate in frames per second.
    Rate(f64),
}

impl FrameTimes {
    /// Returns the time of the first frame, ns of the camera's clock, if it is known.
    pub(crate) fn first_ns(&self) -> Option<i64> {
        match self {
            Self::Listed(times) => times.first().copied(),
            Self::Rate(_) => None,
        }
    }

    /// Returns the seconds from the first frame to frame `index`, or `None` beyond the end of a
    /// list.
    pub fn seconds(&self, index: usize) -> Option<f64> {
        match self {
            Self::Listed(times) => {
                let (first, this) = (times.first()?, times.get(index)?);
                Some(this.checked_sub(*first)? as f64 * 1e-9)
            }
            Self::Rate(rate) => Some(index as f64 / rate),
        }
    }
}

/// Reads a file of frame times in nanoseconds, one integer on each line, ascending: see
/// [`phone::frame_timestamps`].
///
/// # Errors
///
/// Fails if the file cannot be read, or has a line that is not an integer or earlier than the one
/// before.
pub fn read_timestamps(path: &Path, monitor: &ReadMonitor) -> Result<Vec<i64>, EvaluateError> {
    let times = frame_timestamps::read(path, monitor).map_err(|error| match error {
        RowError::Io(source) => EvaluateError::io(path)(source),
        RowError::Bad(row) => EvaluateError::Timestamps {
            path: path.to_owned(),
            line: usize::try_from(row.line).unwrap_or(usize::MAX),
            found: match row.expected {
                LATER => format!("{} (not later than the line before)", row.found),
                _ => row.found,
            },
        },
    })?;
    Ok(times.into_iter().map(|time| time.0).collect())
}

/// Returns the app's timestamp file of a video, if there is one.
pub(super) fn beside(video: &Path) -> Option<PathBuf> {
    video_files::of_video(video).ok().flatten()?.frames
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<i64>, String> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("t.csv");
        std::fs::write(&path, text).unwrap();
        read_timestamps(&path, &ReadMonitor::default()).map_err(|e| e.to_string())
    }

    #[test]
    fn reads_integers_and_refuses_the_rest() {
        assert_eq!(read("1\n2\r\n\n5\n").unwrap(), [1, 2, 5]);
        assert!(read("1\n3.5\n").unwrap_err().contains("line 2"));
        assert!(read("1\nx\n").unwrap_err().contains("`x`"));
        assert_eq!(read("5\n5\n").unwrap(), [5, 5]);
        assert!(read("5\n3\n").unwrap_err().contains("not later"));
    }

    #[test]
    fn seconds_start_at_the_first_frame() {
        let listed = FrameTimes::Listed(vec![5_000_000_000, 5_500_000_000]);
        assert_eq!(listed.seconds(1), Some(0.5));
        assert_eq!(listed.seconds(2), None);
        assert_eq!(FrameTimes::Rate(25.0).seconds(50), Some(2.0));
        assert_eq!(
            FrameTimes::Listed(vec![i64::MIN, i64::MAX]).seconds(1),
            None
        );
    }
}
