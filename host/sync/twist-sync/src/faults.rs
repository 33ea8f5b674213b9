//! Types that report faults of a gyroscope's stream.

use std::fmt;

/// One of the two recordings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Stream {
    /// Recording a, the first argument.
    A,
    /// Recording b, the second argument.
    B,
}

impl fmt::Display for Stream {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::A => "stream a",
            Self::B => "stream b",
        })
    }
}

/// Kind of a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
#[non_exhaustive]
pub enum FaultKind {
    /// Times or rates that are not finite numbers.
    NotFinite,
    /// Timestamps that go back or repeat.
    TimestampOrder,
    /// Single timestamps that deviate from the regular sequence.
    TimestampOutlier,
    /// Small jumps of the timestamps, undone by a slow drift between them.
    TimestampSawtooth,
    /// A stretch of timestamps displaced against the rest.
    TimestampStep,
    /// Missing samples.
    Gap,
    /// Samples at the end of the sensor's range.
    Clipped,
    /// Samples that are exact copies of their neighbours.
    CopiedSample,
    /// Samples that recur with a fixed period and belong to another time than their timestamps
    /// say.
    DisplacedClass,
    /// Single samples that do not fit the motion.
    Outlier,
    /// Timestamps far from all others.
    TimestampFar,
    /// A stretch in which the two gyroscopes did not move as one body, or one was turned
    /// relative to the other.
    NotOneBody,
}

/// Reason for leaving out a stretch of both recordings.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Why {
    /// The two did not move as one body, or one was turned relative to the other.
    Apart,
    /// The offset (b − a) is larger than in the rest by this time in seconds; the two are fixed
    /// to each other as in the rest.
    TimeStep(f64),
}

/// A stretch of both recordings that was left out.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub struct LeftOut {
    /// Begin, in seconds from the first sample of recording a.
    pub from_s: f64,
    /// End, in seconds from the first sample of recording a.
    pub to_s: f64,
    /// Reason for leaving it out.
    pub why: Why,
}

impl fmt::Display for LeftOut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "left out from {:.1} s to {:.1} s: ",
            self.from_s, self.to_s
        )?;
        match self.why {
            Why::Apart => f.write_str("the two did not move as one body"),
            Why::TimeStep(by_s) => write!(
                f,
                "the clocks are {:.2} ms apart from the rest",
                by_s.abs() * 1e3
            ),
        }
    }
}

/// Treatment of a fault by the estimator.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Action {
    /// The samples were left out.
    LeftOut,
    /// The timestamps were corrected, keeping their mean and their rate.
    Corrected,
    /// Nothing was changed; the fault is reported for information.
    Noted,
}

/// One fault of one stream.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Fault {
    /// Stream with the fault.
    pub stream: Stream,
    /// Kind of the fault.
    pub kind: FaultKind,
    /// Number of affected samples; for a sawtooth, the number of its jumps.
    pub count: usize,
    /// Period of its recurrence in samples, if it recurs.
    pub period: Option<f64>,
    /// Displacement of the timestamps against the content in seconds, if the fault has one
    /// (positive: timestamps are later than the content).
    pub displacement_s: Option<f64>,
    /// Treatment of the fault.
    pub action: Action,
    /// Indices of the affected samples in the recording as given. They are not serialised.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub samples: Vec<usize>,
}

impl Fault {
    /// Creates a fault of `samples` that has neither a period nor a displacement.
    pub(crate) fn new(
        stream: Stream,
        kind: FaultKind,
        samples: Vec<usize>,
        action: Action,
    ) -> Self {
        Self {
            stream,
            kind,
            count: samples.len(),
            period: None,
            displacement_s: None,
            action,
            samples,
        }
    }
}

/// Returns the period, in samples, at which most of the indices recur: at least four
/// fifths are in one residue class, which chance would fill to `1/period` only.
pub(crate) fn recurrence(indices: &[usize]) -> Option<f64> {
    if indices.len() < 8 {
        return None;
    }
    let mut counts = [0_usize; 100];
    // The largest such period; its divisors hold them as well.
    let period = (2..=100_usize).rev().find(|&p| {
        counts[..p].fill(0);
        for &k in indices {
            counts[k % p] += 1;
        }
        counts[..p]
            .iter()
            .any(|&count| count * 5 >= indices.len() * 4)
    })?;
    Some(period as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recurrence_names_the_period() {
        let mut indices: Vec<usize> = (0..40).map(|k| 10 * k + 3).collect();
        assert_eq!(recurrence(&indices), Some(10.0));
        indices.extend([7, 91, 122]);
        assert_eq!(recurrence(&indices), Some(10.0));
        let random: Vec<usize> = (0..60).map(|k| k * k % 997).collect();
        assert_eq!(recurrence(&random), None);
    }
}
