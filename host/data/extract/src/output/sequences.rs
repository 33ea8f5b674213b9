//! Sequences: the parts into which marks divide a recording.
//!
//! Without marks the whole recording is one data set in the output folder itself.
//! With marks, the part before the first is in `seq_0`, and the part from the n-th on
//! in `seq_n`, as in the published system's splitter.

use std::path::PathBuf;

use crate::time::BoardNanos;

/// Division of a recording by its marks.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Sequences {
    marks: Vec<BoardNanos>,
}

impl Sequences {
    /// Creates the division by marks in any order; equal ones count once.
    pub(crate) fn new(mut marks: Vec<BoardNanos>) -> Self {
        marks.sort_unstable();
        marks.dedup();
        Self { marks }
    }

    /// Returns the number of sequences.
    pub(crate) fn count(&self) -> usize {
        self.marks.len() + 1
    }

    /// Returns the marks in order.
    pub(crate) fn marks(&self) -> &[BoardNanos] {
        &self.marks
    }

    /// Returns the sequence of an instant.
    pub(crate) fn at(&self, time: BoardNanos) -> usize {
        self.marks.partition_point(|&mark| mark <= time)
    }

    /// Returns the folder of a sequence, relative to the output.
    pub(crate) fn folder(&self, sequence: usize) -> PathBuf {
        if self.marks.is_empty() {
            PathBuf::new()
        } else {
            PathBuf::from(format!("seq_{sequence}"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_divide_a_recording() {
        let sequences = Sequences::new([30, 10, 10].map(BoardNanos).to_vec());
        assert_eq!(sequences.count(), 3);
        assert_eq!(
            [5, 10, 29, 30, 99].map(|t| sequences.at(BoardNanos(t))),
            [0, 1, 1, 2, 2]
        );
        assert_eq!(sequences.folder(2), PathBuf::from("seq_2"));
        let none = Sequences::default();
        assert_eq!(
            (none.at(BoardNanos(7)), none.folder(0)),
            (0, PathBuf::new())
        );
    }
}
