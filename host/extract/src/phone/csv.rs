//! Rows of the phone's files, as streams.
//!
//! Gyroscope and accelerometer: `x,y,z,timestamp_ns`, no header; frame
//! timestamps: one integer a line. Timestamps are read as integers and nothing
//! else. A row that is damaged, or whose time does not lie after the row before,
//! is left out, counted, and named with its line number and what was expected.
//! Memory is one line, of limited length.

use std::io::{self, BufRead, Read};

use crate::time::PhoneNanos;

/// Longest line that is read.
const MAX_LINE: u64 = 4096;
/// How many faults are kept with their text.
const MAX_FAULTS: usize = 20;

/// A sample of a sensor with three axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// When, on the phone's clock.
    pub at: PhoneNanos,
    /// rad/s or m/s².
    pub value: [f64; 3],
}

/// Rows that were left out.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Faults {
    /// How many.
    pub count: u64,
    /// The first of them, in words with line numbers.
    pub first: Vec<String>,
}

impl Faults {
    fn add(&mut self, line: u64, what: &str) {
        self.count += 1;
        if self.first.len() < MAX_FAULTS {
            self.first.push(format!("line {line}: {what}"));
        }
    }
}

/// The rows of a file.
pub struct Rows<R> {
    reader: R,
    line: u64,
    last: Option<PhoneNanos>,
    faults: Faults,
    buffer: Vec<u8>,
}

impl<R: BufRead> Rows<R> {
    /// Takes a reader at its beginning.
    pub fn new(reader: R) -> Self {
        Self {
            reader,
            line: 0,
            last: None,
            faults: Faults::default(),
            buffer: Vec::new(),
        }
    }

    /// What was left out so far.
    #[must_use]
    pub fn faults(&self) -> &Faults {
        &self.faults
    }

    /// The next sample of a gyroscope or accelerometer; `None` at the end.
    ///
    /// # Errors
    ///
    /// Reading fails.
    pub fn next_sample(&mut self) -> io::Result<Option<Sample>> {
        self.next_row(parse_sample, |sample| sample.at)
    }

    /// The next frame timestamp; `None` at the end.
    ///
    /// # Errors
    ///
    /// Reading fails.
    pub fn next_frame(&mut self) -> io::Result<Option<PhoneNanos>> {
        self.next_row(parse_frame, |&at| at)
    }

    fn next_row<T>(
        &mut self,
        parse: fn(&str) -> Result<T, &'static str>,
        time: impl Fn(&T) -> PhoneNanos,
    ) -> io::Result<Option<T>> {
        loop {
            self.buffer.clear();
            let read = (&mut self.reader)
                .take(MAX_LINE)
                .read_until(b'\n', &mut self.buffer)? as u64;
            if read == 0 {
                return Ok(None);
            }
            self.line += 1;
            let ended = self.buffer.last() == Some(&b'\n');
            if !ended && read == MAX_LINE {
                self.faults
                    .add(self.line, "the line is longer than any row");
                self.skip_line()?;
                continue;
            }
            // A last row that was cut within its timestamp has a time ten times
            // smaller, or more: it does not lie after the row before.
            let Ok(text) = std::str::from_utf8(&self.buffer) else {
                self.faults.add(self.line, "the line is no text");
                continue;
            };
            let text = text.trim();
            if text.is_empty() {
                continue;
            }
            match parse(text) {
                Ok(row) => {
                    let at = time(&row);
                    if self.last.is_some_and(|last| at <= last) {
                        self.faults
                            .add(self.line, "its time does not lie after the row before");
                        continue;
                    }
                    self.last = Some(at);
                    return Ok(Some(row));
                }
                Err(what) => self.faults.add(self.line, what),
            }
        }
    }

    fn skip_line(&mut self) -> io::Result<()> {
        loop {
            let available = self.reader.fill_buf()?;
            if available.is_empty() {
                return Ok(());
            }
            let end = available.iter().position(|&byte| byte == b'\n');
            let length = end.map_or(available.len(), |end| end + 1);
            self.reader.consume(length);
            if end.is_some() {
                return Ok(());
            }
        }
    }
}

fn parse_sample(text: &str) -> Result<Sample, &'static str> {
    const EXPECTED: &str = "expected four columns: x,y,z,timestamp in whole nanoseconds";
    let mut columns = text.split(',').map(str::trim);
    let mut value = [0.0_f64; 3];
    for axis in &mut value {
        let number = columns.next().ok_or(EXPECTED)?;
        *axis = number.parse().map_err(|_| EXPECTED)?;
        if !axis.is_finite() {
            return Err("expected finite numbers");
        }
    }
    let at = columns.next().ok_or(EXPECTED)?;
    if columns.next().is_some() {
        return Err(EXPECTED);
    }
    Ok(Sample {
        at: PhoneNanos(at.parse().map_err(|_| EXPECTED)?),
        value,
    })
}

fn parse_frame(text: &str) -> Result<PhoneNanos, &'static str> {
    let parsed = text.parse();
    parsed
        .map(PhoneNanos)
        .map_err(|_| "expected one timestamp in whole nanoseconds")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(text: &str) -> (Vec<Sample>, Faults) {
        let mut rows = Rows::new(text.as_bytes());
        let mut samples = Vec::new();
        while let Some(sample) = rows.next_sample().unwrap() {
            samples.push(sample);
        }
        (samples, rows.faults().clone())
    }

    #[test]
    fn rows_keep_every_digit() {
        let (rows, faults) =
            samples("-4.092797E-05,-5.155703E-4,0,949113215987860\n\n1,2,3,9223372036854775807");
        assert_eq!(rows[0].at, PhoneNanos(949_113_215_987_860));
        assert_eq!(rows[0].value, [-4.092_797e-5, -5.155_703e-4, 0.0]);
        assert_eq!(rows[1].at, PhoneNanos(i64::MAX));
        assert_eq!(faults.count, 0);
    }

    #[test]
    fn damaged_rows_are_named_and_left_out() {
        let long = "1".repeat(10_000);
        let text = format!(
            "x,y,z,t\n1,2,3,10\n1,2,3\n1,2,3,1.5e1\n1,NaN,3,20\n{long}\n1,2,3,5\n1,2,3,30\n"
        );
        let (rows, faults) = samples(&text);
        assert_eq!(
            rows.iter().map(|row| row.at.0).collect::<Vec<_>>(),
            [10, 30]
        );
        assert_eq!(faults.count, 6);
        assert!(faults.first[0].starts_with("line 1: expected four columns"));
        assert!(faults.first[5].starts_with("line 7: its time"));
    }

    #[test]
    fn frames_are_integers_only() {
        let mut rows = Rows::new("100\n133.3\n 200 \r\n".as_bytes());
        assert_eq!(rows.next_frame().unwrap(), Some(PhoneNanos(100)));
        assert_eq!(rows.next_frame().unwrap(), Some(PhoneNanos(200)));
        assert_eq!(rows.next_frame().unwrap(), None);
        assert_eq!(
            rows.faults().first,
            ["line 2: expected one timestamp in whole nanoseconds"]
        );
    }
}
