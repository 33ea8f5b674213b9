//! Rows of the phone's CSV files as streams; damaged rows are left out and listed.

use std::io::{self, BufReader};
use std::path::Path;

use phone::rows::{RowError, Rows};
use phone::samples::PhoneSample;
use system::{Input, ReadMonitor};

use crate::faults::Faults;
use crate::time::PhoneNanos;

/// Largest number of damaged rows that are described.
const MAX_FAULTS: usize = 20;

type FileRows = Rows<BufReader<Input>>;

/// Rows of one of the phone's files.
pub(crate) struct PhoneRows {
    rows: FileRows,
    faults: Faults,
}

impl PhoneRows {
    /// Opens a file at its first row.
    pub(crate) fn open(path: &Path, monitor: &ReadMonitor) -> io::Result<Self> {
        let file = system::open(path, monitor)?.skipping_holes();
        let file = BufReader::with_capacity(256 * 1024, file);
        Ok(Self {
            rows: Rows::new(file),
            faults: Faults::new(MAX_FAULTS),
        })
    }

    /// Reads the next sample of a gyroscope or accelerometer; `None` at the end.
    pub(crate) fn next_sample(&mut self) -> io::Result<Option<PhoneSample>> {
        loop {
            if let Some(sample) = self.next(Rows::next_sample)? {
                return Ok(sample);
            }
        }
    }

    /// Reads the timestamps of all frames, in the order of the rows; `None` for a damaged row.
    pub(crate) fn timestamps(&mut self) -> io::Result<Vec<Option<PhoneNanos>>> {
        let mut stamps = Vec::new();
        loop {
            match self.next(Rows::next_timestamp)? {
                Some(None) => return Ok(stamps),
                Some(stamp) => stamps.push(stamp),
                None => stamps.push(None),
            }
        }
    }

    /// Returns the damaged rows so far.
    pub(crate) fn faults(&self) -> &Faults {
        &self.faults
    }

    /// Reads a row by `next`; `None` for a damaged row, which is added to the faults.
    fn next<T>(&mut self, next: fn(&mut FileRows) -> Result<T, RowError>) -> io::Result<Option<T>> {
        match next(&mut self.rows) {
            Ok(row) => Ok(Some(row)),
            Err(RowError::Bad(row)) => {
                self.faults.add(row.to_string());
                Ok(None)
            }
            Err(RowError::Io(error)) => Err(error),
        }
    }
}
