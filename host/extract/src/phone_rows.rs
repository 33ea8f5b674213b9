//! The rows of the phone's files as streams; damaged rows are left out and named.

use std::fs::File;
use std::io::{self, BufReader};
use std::path::Path;

use phone::rows::{RowError, Rows};
use phone::samples::PhoneSample;

use crate::faults::Faults;
use crate::time::PhoneNanos;

/// How many damaged rows are kept with their text.
const MAX_FAULTS: usize = 20;

type FileRows = Rows<BufReader<File>>;

pub(crate) struct PhoneRows {
    rows: FileRows,
    faults: Faults,
}

impl PhoneRows {
    pub(crate) fn open(path: &Path) -> io::Result<Self> {
        let file = BufReader::with_capacity(256 * 1024, files::open(path)?);
        Ok(Self {
            rows: Rows::new(file),
            faults: Faults::new(MAX_FAULTS),
        })
    }

    /// The next sample of a gyroscope or accelerometer; `None` at the end.
    pub(crate) fn next_sample(&mut self) -> io::Result<Option<PhoneSample>> {
        self.next_whole(Rows::next_sample)
    }

    /// All timestamps of frames.
    pub(crate) fn timestamps(&mut self) -> io::Result<Vec<PhoneNanos>> {
        std::iter::from_fn(|| self.next_whole(Rows::next_timestamp).transpose()).collect()
    }

    pub(crate) fn faults(&self) -> &Faults {
        &self.faults
    }

    fn next_whole<T>(
        &mut self,
        next: fn(&mut FileRows) -> Result<Option<T>, RowError>,
    ) -> io::Result<Option<T>> {
        loop {
            match next(&mut self.rows) {
                Ok(row) => return Ok(row),
                Err(RowError::Bad(row)) => self.faults.add(row.to_string()),
                Err(RowError::Io(error)) => return Err(error),
            }
        }
    }
}
