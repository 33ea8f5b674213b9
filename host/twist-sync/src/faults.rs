//! What can be wrong with a gyroscope's stream, and how it is reported.

use serde::Serialize;

/// Which of the two recordings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Stream {
    /// The board's gyroscope.
    Mcu,
    /// The phone's gyroscope.
    Phone,
}

/// Kind of a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FaultKind {
    /// Time or rate is not a finite number.
    NotFinite,
    /// Timestamps that go back or repeat.
    TimestampOrder,
    /// Single timestamps that stand off from the regular sequence.
    TimestampOutlier,
    /// Small jumps of the timestamps that a slow drift in between undoes.
    TimestampSawtooth,
    /// A stretch of timestamps displaced against the rest.
    TimestampStep,
    /// Missing samples.
    Gap,
    /// The sensor was at the end of its range.
    Clipped,
    /// A sample that is an exact copy of its neighbour.
    CopiedSample,
    /// Samples that recur with a fixed period and belong to another time than stated.
    DisplacedClass,
    /// Single samples that do not fit to the motion.
    Outlier,
}

/// What was done about it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Action {
    /// The samples were left out.
    LeftOut,
    /// The timestamps were corrected, keeping their mean and their rate.
    Corrected,
    /// Nothing needed doing; said for information.
    Noted,
}

/// One fault of one stream.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Fault {
    /// The stream.
    pub stream: Stream,
    /// The kind.
    pub kind: FaultKind,
    /// How many samples (timestamps for a sawtooth: jumps).
    pub count: usize,
    /// Period of the recurrence in samples, if it recurs.
    pub period: Option<f64>,
    /// By how much the samples' content or time is displaced, in seconds
    /// (positive: the timestamp is later than the content).
    pub displacement_s: Option<f64>,
    /// What was done.
    pub action: Action,
    /// Indices of the samples in the recording as given.
    #[serde(skip)]
    pub samples: Vec<usize>,
}

/// The period, in samples, at which most of the indices recur: at least four
/// fifths on one residue class, which chance would fill to `1/period` only.
#[must_use]
pub fn recurrence(indices: &[usize]) -> Option<(usize, usize)> {
    if indices.len() < 8 {
        return None;
    }
    let mut counts = [0_usize; 100];
    // The largest period that still holds them; its divisors hold them as well.
    let period = (2..=100_usize).rev().find(|&p| {
        counts[..p].fill(0);
        for &k in indices {
            counts[k % p] += 1;
        }
        let best = counts[..p].iter().copied().max().unwrap_or(0);
        best * 5 >= indices.len() * 4
    })?;
    counts[..period].fill(0);
    for &k in indices {
        counts[k % period] += 1;
    }
    let class = (0..period).max_by_key(|&c| counts[c])?;
    Some((period, class))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recurrence_names_the_period() {
        let mut indices: Vec<usize> = (0..40).map(|k| 10 * k + 3).collect();
        assert_eq!(recurrence(&indices), Some((10, 3)));
        indices.extend([7, 91, 122]);
        assert_eq!(recurrence(&indices), Some((10, 3)));
        let random: Vec<usize> = (0..60).map(|k| k * k % 997).collect();
        assert_eq!(recurrence(&random), None);
    }
}
