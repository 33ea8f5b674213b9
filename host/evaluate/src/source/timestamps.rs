//! When each frame was taken.
//!
//! The phone's app writes one integer of nanoseconds a frame into
//! `{VIDEO}_imu_timestamps.csv` (older versions: `{VIDEO}_timestamps.csv`), in a
//! folder named by the video's date. Without such a file frames are taken to
//! come at a constant rate. Only differences of these times are used.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

use crate::EvaluateError;

/// More frames than this are not read: 100 hours at 60 fps.
const MAX_TIMESTAMPS: usize = 21_600_000;

/// Times of the frames of one input.
#[derive(Debug, Clone, PartialEq)]
pub enum FrameTimes {
    /// One time a frame, nanoseconds of the camera's clock, ascending.
    Listed(Vec<i64>),
    /// Constant rate, frames per second.
    Rate(f64),
}

impl FrameTimes {
    /// Seconds from the first frame to frame `index`; `None` beyond a list's end.
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

/// Reads one integer a line; further columns after a comma are ignored, and a
/// first line that is a header is skipped.
pub fn read_timestamps(path: &Path) -> Result<Vec<i64>, EvaluateError> {
    let io = |source| EvaluateError::Io {
        path: path.to_owned(),
        source,
    };
    let file = std::fs::File::open(path).map_err(io)?;
    let mut times: Vec<i64> = Vec::new();
    for (i, line) in BufReader::new(file).lines().enumerate() {
        let line = line.map_err(io)?;
        let field = line.split(',').next().unwrap_or_default().trim();
        if field.is_empty() {
            continue;
        }
        let wrong = |found: &str| EvaluateError::Timestamps {
            path: path.to_owned(),
            line: i + 1,
            found: found.chars().take(60).collect(),
        };
        match field.parse::<i64>() {
            Ok(t) if times.last().is_none_or(|&before| t > before) => times.push(t),
            Ok(_) => return Err(wrong(&format!("{field} (not later than the line before)"))),
            // A header has no digit in front.
            Err(_) if i == 0 && !field.starts_with(|c: char| c.is_ascii_digit() || c == '-') => {}
            Err(_) => return Err(wrong(field)),
        }
        if times.len() > MAX_TIMESTAMPS {
            return Err(wrong("more timestamps than any recording has"));
        }
    }
    Ok(times)
}

/// The app's timestamp file of a video, if there is one.
pub(super) fn beside(video: &Path) -> Option<PathBuf> {
    let stem = video.file_stem()?.to_str()?;
    let folder = video.parent().unwrap_or(Path::new(""));
    // VID_20240131_120000 -> 20240131_120000
    let date = stem.trim_start_matches(|c: char| !c.is_ascii_digit());
    let mut folders = vec![folder.to_owned(), folder.join(stem)];
    if !date.is_empty() && date != stem {
        folders.push(folder.join(date));
    }
    folders
        .iter()
        .flat_map(|f| {
            ["_imu_timestamps.csv", "_timestamps.csv"].map(|end| f.join(format!("{stem}{end}")))
        })
        .find(|p| p.is_file())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<i64>, String> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("t.csv");
        std::fs::write(&path, text).unwrap();
        read_timestamps(&path).map_err(|e| e.to_string())
    }

    #[test]
    fn reads_integers_and_refuses_the_rest() {
        assert_eq!(read("1\n2\r\n\n5\n").unwrap(), [1, 2, 5]);
        assert_eq!(read("timestamp,x\n1,7\n").unwrap(), [1]);
        assert!(read("1\n3.5\n").unwrap_err().contains("line 2"));
        assert!(read("1\nx\n").unwrap_err().contains("`x`"));
        assert!(read("5\n5\n").unwrap_err().contains("not later"));
        assert!(read("99999999999999999999\n").is_err());
    }

    #[test]
    fn finds_the_app_s_files() {
        let dir = tempfile::tempdir().unwrap();
        let video = dir.path().join("VID_20240131_120000.mp4");
        assert_eq!(beside(&video), None);
        let folder = dir.path().join("20240131_120000");
        std::fs::create_dir(&folder).unwrap();
        let file = folder.join("VID_20240131_120000_imu_timestamps.csv");
        std::fs::write(&file, "1\n").unwrap();
        assert_eq!(beside(&video), Some(file));
        let near = dir.path().join("VID_20240131_120000_timestamps.csv");
        std::fs::write(&near, "1\n").unwrap();
        assert_eq!(beside(&video), Some(near));
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
