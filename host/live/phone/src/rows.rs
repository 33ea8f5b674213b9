//! The rows of the app's files, as streams.
//!
//! Gyroscope and accelerometer: `x,y,z,timestamp_ns`, no header; frame
//! timestamps: one integer of nanoseconds a line ([`crate::frame_timestamps`]).
//! Timestamps must be integers. A row that is damaged, or whose time is not later than that of the
//! row before, is reported as a [`BadRow`] with its line number; the rows after it can still be
//! read. Memory is one line of limited length.

use std::io::{self, BufRead, Read};

use clock::PhoneNanos;

use crate::samples::{PhoneSample, parse_sample};

/// Longest line that is read, in bytes.
const MAX_LINE: u64 = 4096;

/// [`BadRow::expected`] of a row that is well-formed but out of order.
pub const LATER: &str = "a time later than that of the row before";

/// A row that differs from what the app writes.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: expected {expected}, found `{found}`")]
pub struct BadRow {
    /// Number of the line, from 1.
    pub line: u64,
    /// Form of a correct row, as a noun phrase.
    pub expected: &'static str,
    /// Beginning of the row.
    pub found: String,
}

/// Failure to read a row.
#[derive(Debug, thiserror::Error)]
pub enum RowError {
    /// The file cannot be read.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// The row is damaged. Reading can go on after it.
    #[error(transparent)]
    Bad(#[from] BadRow),
}

/// Reader of the rows of a file.
#[derive(Debug)]
pub struct Rows<R> {
    reader: R,
    line: u64,
    last: Option<PhoneNanos>,
    /// True if a row may repeat the time of the row before.
    repeats: bool,
    buffer: Vec<u8>,
}

impl<R: BufRead> Rows<R> {
    /// Creates a reader of rows from a reader at the beginning of a file.
    pub const fn new(reader: R) -> Self {
        Self {
            reader,
            line: 0,
            last: None,
            repeats: false,
            buffer: Vec::new(),
        }
    }

    /// Returns a reader to which a row that repeats the time of the row before is no damaged one.
    pub(crate) const fn with_repeats(mut self) -> Self {
        self.repeats = true;
        self
    }

    /// Reads the next sample of a gyroscope or accelerometer. Returns `None` at the end.
    ///
    /// # Errors
    ///
    /// Reading fails, or the row is damaged. The next call reads the row after it.
    pub fn next_sample(&mut self) -> Result<Option<PhoneSample>, RowError> {
        const EXPECTED: &str = "x,y,z,timestamp with finite numbers and whole nanoseconds";
        self.next_row(
            EXPECTED,
            |_, text| parse_sample(text).map(Some),
            |row| row.time,
        )
    }

    /// Reads the next row that `parse` accepts. `parse` receives the number of the line and its
    /// trimmed text; it returns `None` for a damaged row and `Some(None)` for one to skip.
    pub(crate) fn next_row<T>(
        &mut self,
        expected: &'static str,
        parse: impl Fn(u64, &str) -> Option<Option<T>>,
        time: impl Fn(&T) -> PhoneNanos,
    ) -> Result<Option<T>, RowError> {
        loop {
            self.buffer.clear();
            let mut limited = (&mut self.reader).take(MAX_LINE);
            let read = limited.read_until(b'\n', &mut self.buffer)? as u64;
            if read == 0 {
                return Ok(None);
            }
            self.line += 1;
            if read == MAX_LINE && self.buffer.last() != Some(&b'\n') {
                self.reader.skip_until(b'\n')?;
                return Err(self.bad("a line of at most 4096 bytes"));
            }
            let Ok(text) = std::str::from_utf8(&self.buffer) else {
                return Err(self.bad("text"));
            };
            let text = text.trim();
            if text.is_empty() {
                continue;
            }
            let Some(row) = parse(self.line, text) else {
                return Err(self.bad(expected));
            };
            let Some(row) = row else { continue };
            // A last row that was cut within its timestamp has a time ten times
            // smaller, or more: it is not later than the row before.
            let at = time(&row);
            let is_later = |last| at > last || self.repeats && at == last;
            if !self.last.is_none_or(is_later) {
                return Err(self.bad(LATER));
            }
            self.last = Some(at);
            return Ok(Some(row));
        }
    }

    fn bad(&self, expected: &'static str) -> RowError {
        let text = String::from_utf8_lossy(&self.buffer);
        BadRow {
            line: self.line,
            expected,
            found: text.trim().chars().take(60).collect(),
        }
        .into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(text: &str) -> (Vec<PhoneSample>, Vec<BadRow>) {
        let mut rows = Rows::new(text.as_bytes());
        let (mut samples, mut bad) = (Vec::new(), Vec::new());
        loop {
            match rows.next_sample() {
                Ok(Some(sample)) => samples.push(sample),
                Ok(None) => return (samples, bad),
                Err(RowError::Bad(row)) => bad.push(row),
                Err(RowError::Io(error)) => panic!("{error}"),
            }
        }
    }

    #[test]
    fn rows_keep_every_digit() {
        let (rows, bad) =
            samples("-4.092797E-05,-5.155703E-4,0,949113215987860\n\n1,2,3,9223372036854775807");
        assert_eq!(rows[0].time, PhoneNanos(949_113_215_987_860));
        assert_eq!(rows[0].xyz, [-4.092_797e-5, -5.155_703e-4, 0.0]);
        assert_eq!(rows[1].time, PhoneNanos(i64::MAX));
        assert_eq!(bad, []);
    }

    #[test]
    fn damaged_rows_are_named_and_can_be_left_out() {
        let long = "1".repeat(10_000);
        let text = format!(
            "x,y,z,t\n1,2,3,10\n1,2,3\n1,2,3,1.5e1\n1,NaN,3,20\n{long}\n1,2,3,5\n1,2,3,30\n"
        );
        let (rows, bad) = samples(&text);
        let times: Vec<i64> = rows.iter().map(|row| row.time.0).collect();
        assert_eq!(times, [10, 30]);
        let lines: Vec<u64> = bad.iter().map(|row| row.line).collect();
        assert_eq!(lines, [1, 3, 4, 5, 6, 7]);
        assert_eq!(
            bad[0].to_string(),
            "line 1: expected x,y,z,timestamp with finite numbers and whole nanoseconds, found `x,y,z,t`"
        );
        assert_eq!(bad[5].expected, LATER);
    }
}
