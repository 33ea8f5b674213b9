//! Writes tables of IMU samples in a stream.
//!
//! Rows are formatted in parallel, a block at a time, and written in order, one file per
//! sequence.

use std::io::{self, Write};
use std::path::Path;

use rayon::prelude::*;

use super::sequences::Sequences;
use super::whole_file::WholeFile;
use crate::layout::{ImuRow, ImuTable};
use crate::time::{BoardNanos, PhoneNanos, PiecewiseMap};
use phone::samples::PhoneSample;

/// Number of rows that are formatted at a time.
const BLOCK: usize = 32_768;
/// Number of rows in one piece of work.
const PIECE: usize = 2_048;
/// Largest distance of accelerations for interpolation, ns.
const MAX_GAP: i64 = 50_000_000;

/// Table under construction.
pub(crate) struct TableWriter<'a> {
    table: ImuTable,
    out: &'a Path,
    sequences: &'a Sequences,
    delay: i64,
    rows: Vec<ImuRow>,
    files: Vec<Option<WholeFile>>,
    written: u64,
}

impl<'a> TableWriter<'a> {
    /// Begins a table below `out`. `delay` (ns) is subtracted from the times if the format wants
    /// it.
    pub(crate) fn new(
        table: ImuTable,
        out: &'a Path,
        sequences: &'a Sequences,
        delay: i64,
    ) -> Self {
        Self {
            delay: if table.subtract_delay { delay } else { 0 },
            table,
            out,
            sequences,
            rows: Vec::with_capacity(BLOCK),
            files: (0..sequences.count()).map(|_| None).collect(),
            written: 0,
        }
    }

    /// Adds a row.
    ///
    /// # Errors
    ///
    /// Fails if a file cannot be written.
    pub(crate) fn push(&mut self, mut row: ImuRow) -> io::Result<()> {
        row.at = BoardNanos(row.at.0.saturating_sub(self.delay));
        self.rows.push(row);
        if self.rows.len() == BLOCK {
            self.flush_rows()?;
        }
        Ok(())
    }

    /// Formats and writes the pending rows.
    fn flush_rows(&mut self) -> io::Result<()> {
        let make = self.table.row;
        let sequences = self.sequences;
        let pieces: Vec<Vec<(usize, String)>> = self
            .rows
            .par_chunks(PIECE)
            .map(|rows| {
                let mut texts: Vec<(usize, String)> = Vec::new();
                for row in rows {
                    let sequence = sequences.at(row.at);
                    if texts.last().is_none_or(|(last, _)| *last != sequence) {
                        texts.push((sequence, String::with_capacity(rows.len() * 128)));
                    }
                    if let Some((_, text)) = texts.last_mut() {
                        make(text, row);
                    }
                }
                texts
            })
            .collect();
        self.written += self.rows.len() as u64;
        self.rows.clear();
        for (sequence, text) in pieces.into_iter().flatten() {
            self.file(sequence)?.write_all(text.as_bytes())?;
        }
        Ok(())
    }

    /// Returns the file of a sequence; creates it at its first row.
    fn file(&mut self, sequence: usize) -> io::Result<&mut WholeFile> {
        let slot = &mut self.files[sequence];
        if slot.is_none() {
            let folder = self.out.join(self.sequences.folder(sequence));
            let mut file = WholeFile::create(&folder.join(self.table.path))?;
            file.write_all(self.table.header.as_bytes())?;
            *slot = Some(file);
        }
        slot.as_mut().ok_or_else(|| io::Error::other("no file"))
    }

    /// Finishes the files, and returns the number of rows.
    ///
    /// # Errors
    ///
    /// Fails if a file cannot be written.
    pub(crate) fn finish(mut self) -> io::Result<u64> {
        self.flush_rows()?;
        for file in self.files.into_iter().flatten() {
            file.finish()?;
        }
        Ok(self.written)
    }
}

/// Interpolates accelerations to the times of a phone's gyroscope.
///
/// Times are compared as integers; only the accelerations are floats.
#[derive(Debug)]
pub(crate) struct AccelInterpolator<A> {
    accel: A,
    before: Option<PhoneSample>,
    after: Option<PhoneSample>,
    ended: bool,
    /// Number of times without accelerations around them.
    pub(crate) without_accel: u64,
}

impl<A: FnMut() -> io::Result<Option<PhoneSample>>> AccelInterpolator<A> {
    /// Creates an interpolator of samples that `accel` returns in order of time.
    pub(crate) fn new(accel: A) -> Self {
        Self {
            accel,
            before: None,
            after: None,
            ended: false,
            without_accel: 0,
        }
    }

    /// Returns the acceleration at a time, or `None` without accelerations around it. Times must
    /// not decrease.
    ///
    /// # Errors
    ///
    /// Fails if a sample cannot be read.
    pub(crate) fn at(&mut self, time: PhoneNanos) -> io::Result<Option<[f64; 3]>> {
        while !self.ended && self.after.is_none_or(|after| after.time < time) {
            match (self.accel)()? {
                Some(sample) => {
                    self.before = self.after;
                    self.after = Some(sample);
                }
                None => self.ended = true,
            }
        }
        let value = match (self.before, self.after) {
            (_, Some(after)) if after.time == time => Some(after.xyz),
            (Some(before), Some(after)) => between(&before, &after, time),
            _ => None,
        };
        if value.is_none() {
            self.without_accel += 1;
        }
        Ok(value)
    }
}

/// Interpolates linearly between two samples; `None` outside of them or in a gap.
fn between(before: &PhoneSample, after: &PhoneSample, time: PhoneNanos) -> Option<[f64; 3]> {
    let run = after.time.0.checked_sub(before.time.0)?;
    let since = time.0.checked_sub(before.time.0)?;
    if !(0..=run).contains(&since) || run > MAX_GAP || run == 0 {
        return None;
    }
    let share = since as f64 / run as f64;
    let mut value = [0.0; 3];
    for (axis, slot) in value.iter_mut().enumerate() {
        *slot = before.xyz[axis] + (after.xyz[axis] - before.xyz[axis]) * share;
    }
    Some(value)
}

/// Converts a phone's sample to board time; `None` without a relation of the clocks.
pub(crate) fn in_board_time(
    clock: &PiecewiseMap<PhoneNanos, BoardNanos>,
    gyro: &PhoneSample,
    accel: [f64; 3],
) -> Option<ImuRow> {
    Some(ImuRow {
        at: clock.apply(gyro.time)?,
        gyro: gyro.xyz,
        accel,
        temperature: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(at: i64, x: f64) -> PhoneSample {
        PhoneSample {
            time: PhoneNanos(at),
            xyz: [x, -x, 0.0],
        }
    }

    #[test]
    fn accelerations_are_interpolated_but_not_extrapolated() {
        let mut samples = [
            sample(10_000_000, 1.0),
            sample(20_000_000, 2.0),
            sample(200_000_000, 3.0),
        ]
        .into_iter();
        let mut interpolator = AccelInterpolator::new(|| Ok(samples.next()));
        let mut x = |ms: i64| {
            interpolator
                .at(PhoneNanos(ms * 1_000_000))
                .unwrap()
                .map(|v| v[0])
        };
        assert_eq!(x(5), None);
        assert_eq!(x(10), Some(1.0));
        assert_eq!(x(15), Some(1.5));
        assert_eq!(x(20), Some(2.0));
        assert_eq!(x(100), None);
        assert_eq!(x(200), Some(3.0));
        assert_eq!(x(201), None);
        assert_eq!(interpolator.without_accel, 3);
    }
}
