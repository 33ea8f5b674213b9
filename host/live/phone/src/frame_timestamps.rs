//! The app's file of frame timestamps, `{VIDEO}_imu_timestamps.csv` (older
//! versions: `{VIDEO}_timestamps.csv`).
//!
//! The app writes one line per frame, in the order of the frames: the start of exposure of the
//! first row in whole nanoseconds. Tables derived from such a file may have a heading in their
//! first line and further columns after a comma; both are skipped, and so are empty lines.
//! Anything else is damage: a fraction, a time that is not later than the one before, a line that
//! is not UTF-8.
//!
//! [`read`] is for callers that need the time of every frame: a frame that the app got twice has its
//! time twice, and any other damaged row ends the reading. [`Rows::next_timestamp`] reports a
//! damaged row, also one that repeats a time, and can go on after it.

use std::io::{BufRead, BufReader};
use std::path::Path;

use clock::PhoneNanos;
use system::ReadMonitor;

use crate::rows::{BadRow, RowError, Rows};

const EXPECTED: &str = "one timestamp in whole nanoseconds";

/// Most frames of a file: 100 hours at 60 fps.
const MAX_TIMESTAMPS: usize = 21_600_000;

impl<R: BufRead> Rows<R> {
    /// Reads the next frame's timestamp. Returns `None` at the end.
    ///
    /// # Errors
    ///
    /// Reading fails, or the row is damaged. The next call reads the row after it.
    pub fn next_timestamp(&mut self) -> Result<Option<PhoneNanos>, RowError> {
        let parse = |line, text: &str| {
            let field = text.split(',').next().unwrap_or_default().trim();
            let heading = line == 1 && !field.starts_with(|c: char| c.is_ascii_digit() || c == '-');
            match field.parse() {
                Ok(nanos) => Some(Some(PhoneNanos(nanos))),
                Err(_) if heading || field.is_empty() => Some(None),
                Err(_) => None,
            }
        };
        self.next_row(EXPECTED, parse, |&time| time)
    }
}

/// Reads the timestamps of all frames of a video.
///
/// # Errors
///
/// The file cannot be read, or a row is damaged.
pub fn read(path: &Path, monitor: &ReadMonitor) -> Result<Vec<PhoneNanos>, RowError> {
    let reader = BufReader::new(system::open(path, monitor)?.skipping_holes());
    let mut rows = Rows::new(reader).with_repeats();
    let mut times = Vec::new();
    while let Some(time) = rows.next_timestamp()? {
        if times.len() == MAX_TIMESTAMPS {
            return Err(RowError::Bad(BadRow {
                line: times.len() as u64 + 1,
                expected: "no more timestamps than any recording has",
                found: time.0.to_string(),
            }));
        }
        times.push(time);
    }
    Ok(times)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rows::LATER;

    fn read_text(text: &str) -> Result<Vec<i64>, BadRow> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.csv");
        std::fs::write(&path, text).unwrap();
        match read(&path, &ReadMonitor::default()) {
            Ok(times) => Ok(times.into_iter().map(|time| time.0).collect()),
            Err(RowError::Bad(row)) => Err(row),
            Err(RowError::Io(error)) => panic!("{error}"),
        }
    }

    #[test]
    fn timestamps_are_integers_a_line() {
        assert_eq!(read_text("1\n2\r\n\n 5 \n").unwrap(), [1, 2, 5]);
        assert_eq!(read_text("timestamp\n-3\n1").unwrap(), [-3, 1]);
        assert_eq!(read_text("timestamp,x\n1,7\n").unwrap(), [1]);
        assert_eq!(read_text("").unwrap(), Vec::<i64>::new());
        // The app got the second frame twice.
        assert_eq!(read_text("3\n5,1\n5,2\n9").unwrap(), [3, 5, 5, 9]);
    }

    #[test]
    fn the_first_damaged_row_is_named() {
        let bad = |text: &str| read_text(text).unwrap_err();
        let row = |line, expected, found: &str| BadRow {
            line,
            expected,
            found: found.to_owned(),
        };
        assert_eq!(bad("1\n2.5\nx\n"), row(2, EXPECTED, "2.5"));
        assert_eq!(bad("2.5\n"), row(1, EXPECTED, "2.5"));
        assert_eq!(bad("time\nx\n"), row(2, EXPECTED, "x"));
        assert_eq!(bad("5\n9\n3"), row(3, LATER, "3"));
        assert_eq!(bad("1\n99999999999999999999\n").line, 2);
    }

    #[test]
    fn reading_goes_on_after_a_damaged_row() {
        let mut rows = Rows::new("100\n133.3\n 200 \r\n".as_bytes());
        assert_eq!(rows.next_timestamp().unwrap(), Some(PhoneNanos(100)));
        let error = rows.next_timestamp().unwrap_err().to_string();
        assert_eq!(
            error,
            "line 2: expected one timestamp in whole nanoseconds, found `133.3`"
        );
        assert_eq!(rows.next_timestamp().unwrap(), Some(PhoneNanos(200)));
        assert_eq!(rows.next_timestamp().unwrap(), None);
    }
}
