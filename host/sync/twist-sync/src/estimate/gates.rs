//! The quality gates that an estimate must pass, each with its limit, reason and advice.

use std::fmt;

/// Fewest usable samples of a stream.
const FEWEST_SAMPLES: f64 = 100.0;
/// Least rate of the samples, Hz.
const LEAST_RATE_HZ: f64 = 20.0;
/// Least rms of the in-band rate, rad/s: a hand at rest or a table stays below.
const LEAST_MOTION: f64 = 0.05;
/// Largest part of the motion's rms that the quick fit may leave unexplained,
/// faults not yet removed. Unrelated twists leave more than half.
const UNEXPLAINED_AT_FIRST: f64 = 0.2;
/// Least residual power of the best rival among the time shifts, over that of the best.
const WORSE_RIVAL: f64 = 4.0;
/// Largest residual: this part of the motion's rms plus this multiple of the in-band noise.
const RESIDUAL_OF_MOTION: f64 = 0.03;
const RESIDUAL_OF_NOISE: f64 = 3.0;
/// Least part of a stream's samples that must be usable.
const LEAST_USABLE: f64 = 0.5;
/// Least part of the motion that must be that of one body.
const LEAST_ONE_BODY: f64 = 1.0 / 3.0;
/// Least part of the information that one relation of the clocks must hold.
const LEAST_SHARE: f64 = 0.6;
/// Largest rms disagreement between parts of the overlap, seconds, or as a multiple of what
/// noise explains: with eight parts, chance exceeds it in one twist of a million.
const LOCAL_SCATTER_S: f64 = 400e-6;
const TIMES_BY_NOISE: f64 = 2.5;
/// Largest plausible rate difference of two crystal clocks.
const LARGEST_SKEW: f64 = 500e-6;

/// Kind of a quality gate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
#[non_exhaustive]
pub enum GateKind {
    /// As many rates as times in each recording.
    Lengths,
    /// Usable samples of the stream that has fewer.
    Samples,
    /// Rate of the samples of the stream where it is lower.
    Rate,
    /// Motion of the stream that moves less.
    Motion,
    /// Constant axes of the stream that has more of them.
    Axes,
    /// Ratio of the larger to the smaller motion of the two.
    Unit,
    /// Time that both recordings have in common.
    Overlap,
    /// Motion that the quick fit leaves unexplained.
    Explained,
    /// Residual power of the second best time shift over that of the best.
    UniquePeak,
    /// Residual of the fit.
    Residual,
    /// Part of the samples that is left, of the stream that lost more.
    Usable,
    /// Part of the motion that is that of one body.
    OneBody,
    /// Part of the information that is in one relation of the clocks.
    OneRelation,
    /// Disagreement of parts of the overlap about the offset.
    Consistent,
    /// Agreement of slow and fast motion.
    Bands,
    /// 1-sigma of the offset.
    Sigma,
    /// Difference of the clocks' rates.
    Skew,
    /// Convergence of the fit.
    Settled,
    /// Enough usable time for a fit.
    Solvable,
}

impl GateKind {
    /// Returns the short stable name, such as `unique_peak`.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.texts()[0]
    }

    /// Returns the unit of value and limit, followed by the quantity where it is not obvious;
    /// empty for a gate whose value is yes (1) or no (0).
    #[must_use]
    pub fn unit(self) -> &'static str {
        self.texts()[1]
    }

    /// Returns the meaning of a failure.
    #[must_use]
    pub fn reason(self) -> &'static str {
        self.texts()[2]
    }

    /// Returns the next step after a failure; empty if the reason implies it.
    #[must_use]
    pub fn advice(self) -> &'static str {
        self.texts()[3]
    }

    /// Returns true for the gates that fail if the true lag is outside of the search.
    pub(crate) fn is_about_lag(self) -> bool {
        matches!(
            self,
            Self::Overlap | Self::Explained | Self::UniquePeak | Self::OneBody | Self::OneRelation
        )
    }

    /// Name, unit, reason and advice.
    fn texts(self) -> [&'static str; 4] {
        match self {
            Self::Lengths => [
                "lengths",
                "samples without the other",
                "a recording does not have as many rates as times",
                "give a rate about three axes for each time",
            ],
            Self::Samples => [
                "samples",
                "samples",
                "a recording has too few usable samples",
                "record for some seconds at 100 samples a second or more",
            ],
            Self::Rate => [
                "rate",
                "Hz",
                "the samples are too far apart for a twist",
                "record 100 samples a second or more, and check the unit of the time",
            ],
            Self::Motion => [
                "motion",
                "rad/s rms",
                "too little motion",
                "twist the rig by hand for some seconds",
            ],
            Self::Axes => [
                "axes",
                "axes",
                "of a stream two axes are constant",
                "give the rates about all three axes, and check the columns",
            ],
            Self::Unit => [
                "unit",
                "times",
                "the rates of one are many times those of the other",
                "check the units: both must be in rad/s, which is 57.3 degrees a second",
            ],
            Self::Overlap => [
                "overlap",
                "s",
                "the recordings have too little time in common",
                "record both at the same time, and twist for some seconds",
            ],
            Self::Explained => [
                "explained",
                "% of the motion is unexplained",
                "the gyroscopes do not match at any time shift",
                SAME_TWIST,
            ],
            Self::UniquePeak => [
                "unique_peak",
                "times the residual power at the second best",
                "several time shifts explain the motion about equally well",
                "twist irregularly",
            ],
            Self::Residual => [
                "residual",
                "rad/s rms",
                "one motion does not explain both recordings",
                SAME_TWIST,
            ],
            Self::Usable => [
                "usable",
                "% of a stream is left",
                "too many samples had to be left out",
                "the list of faults says why; close other apps on its device, and twist again",
            ],
            Self::OneBody => [
                "one_body",
                "% of the motion is that of one body",
                "too little is left where the two moved as one body",
                "take a firm hold before the twist begins, and keep it to the end",
            ],
            Self::OneRelation => [
                "one_relation",
                "% of the information is in one relation",
                "the relation of the clocks jumps within the recording",
                "twist again; if it jumps again, the timestamps of a device are at fault",
            ],
            Self::Consistent => [
                "consistent",
                "µs rms between parts",
                "parts of the overlap disagree about the offset",
                "the timestamps of a device wander, or the two were not held firmly: twist again",
            ],
            Self::Bands => [
                "bands",
                "",
                "slow and fast motion show different offsets",
                "the two do not move as one body, or vibrate faster than they are sampled",
            ],
            Self::Sigma => [
                "sigma",
                "µs",
                "the 1-sigma of the offset is too large",
                "twist more, or about more axes",
            ],
            Self::Skew => [
                "skew",
                "ppm",
                "no two crystals differ that much",
                "a timestamp unit or a recording is wrong",
            ],
            Self::Settled => [
                "settled",
                "",
                "the fit did not settle",
                "twist again, about all axes",
            ],
            Self::Solvable => [
                "solvable",
                "",
                "the recordings share too little usable time for a fit",
                "twist for longer",
            ],
        }
    }
}

const SAME_TWIST: &str =
    "fix the gyroscopes rigidly to each other, and give recordings of the same twist";

/// One judged quality gate: a measured value against its limit.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Gate {
    /// Kind of the gate.
    pub kind: GateKind,
    /// True if the measured value is within the limit.
    pub passed: bool,
    /// Measured value, in the [unit](GateKind::unit) of the kind. JSON has no infinite number:
    /// null stands for it.
    #[cfg_attr(feature = "serde", serde(deserialize_with = "null_is_infinite"))]
    pub value: f64,
    /// Limit of the value, in the same unit.
    #[cfg_attr(feature = "serde", serde(deserialize_with = "null_is_infinite"))]
    pub limit: f64,
}

#[cfg(feature = "serde")]
fn null_is_infinite<'de, D: serde::Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    let number: Option<f64> = serde::Deserialize::deserialize(from)?;
    Ok(number.unwrap_or(f64::INFINITY))
}

impl Gate {
    /// Largest ratio of the motions of two recordings, one of which may be mostly at rest.
    const LARGEST_RATIO: f64 = 20.0;
    /// Part of the motion's rms below which an unexplained residual does not put the
    /// lag in doubt.
    pub(crate) const MOSTLY_EXPLAINED: f64 = UNEXPLAINED_AT_FIRST;

    fn at_least(kind: GateKind, value: f64, limit: f64) -> Self {
        Self {
            kind,
            passed: value >= limit,
            value,
            limit,
        }
    }

    fn at_most(kind: GateKind, value: f64, limit: f64) -> Self {
        Self {
            passed: value <= limit,
            ..Self::at_least(kind, value, limit)
        }
    }

    /// Like [`Self::at_least`], with value and limit as fractions that are shown in percent.
    fn part_at_least(kind: GateKind, value: f64, limit: f64) -> Self {
        Self::at_least(kind, 100.0 * value, 100.0 * limit)
    }

    /// `unequal` times or rates have no counterpart, of the recording where they are more.
    pub(crate) fn lengths(unequal: usize) -> Self {
        Self::at_most(GateKind::Lengths, unequal as f64, 0.0)
    }

    pub(crate) fn samples(fewest: usize) -> Self {
        Self::at_least(GateKind::Samples, fewest as f64, FEWEST_SAMPLES)
    }

    /// `step_s` is the distance of samples, of the stream where it is larger.
    pub(crate) fn rate(step_s: f64) -> Self {
        let rate_hz = step_s.max(f64::MIN_POSITIVE).recip();
        Self::at_least(GateKind::Rate, rate_hz, LEAST_RATE_HZ)
    }

    /// `rms` in rad/s, of the stream that moves less.
    pub(crate) fn motion(rms: f64) -> Self {
        Self::at_least(GateKind::Motion, rms, LEAST_MOTION)
    }

    /// `constant` axes have the same value all the time, of the stream that has more of them.
    pub(crate) fn axes(constant: usize) -> Self {
        Self::at_most(GateKind::Axes, constant as f64, 1.0)
    }

    /// `ratio` of the larger to the smaller motion of the two.
    pub(crate) fn unit(ratio: f64) -> Self {
        Self::at_most(GateKind::Unit, ratio, Self::LARGEST_RATIO)
    }

    pub(crate) fn overlap(common_s: f64, limit_s: f64) -> Self {
        Self::at_least(GateKind::Overlap, common_s, limit_s)
    }

    /// `unexplained` is a part of the motion's rms.
    pub(crate) fn explained(unexplained: f64) -> Self {
        let (value, limit) = (100.0 * unexplained, 100.0 * UNEXPLAINED_AT_FIRST);
        Self::at_most(GateKind::Explained, value, limit)
    }

    /// `worse` is the residual power of the best rival over that of the best.
    pub(crate) fn unique_peak(worse: f64) -> Self {
        Self::at_least(GateKind::UniquePeak, worse.min(1e6), WORSE_RIVAL)
    }

    /// All in rad/s rms.
    pub(crate) fn residual(residual: f64, motion: f64, noise: f64) -> Self {
        let allowed = RESIDUAL_OF_MOTION * motion + RESIDUAL_OF_NOISE * noise;
        Self::at_most(GateKind::Residual, residual, allowed)
    }

    /// `part` of the samples, of the stream that lost more.
    pub(crate) fn usable(part: f64) -> Self {
        Self::part_at_least(GateKind::Usable, part, LEAST_USABLE)
    }

    /// `share` is a part of the motion's power.
    pub(crate) fn one_body(share: f64) -> Self {
        Self::part_at_least(GateKind::OneBody, share, LEAST_ONE_BODY)
    }

    /// `share` is a part of the information.
    pub(crate) fn one_relation(share: f64) -> Self {
        Self::part_at_least(GateKind::OneRelation, share, LEAST_SHARE)
    }

    /// `by_noise_s` is the disagreement that the sigma explains.
    pub(crate) fn consistent(scatter_s: f64, by_noise_s: f64) -> Self {
        let limit_s = LOCAL_SCATTER_S.hypot(TIMES_BY_NOISE * by_noise_s);
        Self::at_most(GateKind::Consistent, 1e6 * scatter_s, 1e6 * limit_s)
    }

    pub(crate) fn bands() -> Self {
        Self::at_least(GateKind::Bands, 0.0, 1.0)
    }

    pub(crate) fn sigma(sigma_s: f64, limit_s: f64) -> Self {
        Self::at_most(GateKind::Sigma, 1e6 * sigma_s, 1e6 * limit_s)
    }

    pub(crate) fn skew(skew: f64, sigma: f64) -> Self {
        let limit = 1e6 * (LARGEST_SKEW + 3.0 * sigma);
        Self::at_most(GateKind::Skew, 1e6 * skew.abs(), limit)
    }

    pub(crate) fn settled(settled: bool) -> Self {
        Self::at_least(GateKind::Settled, f64::from(u8::from(settled)), 1.0)
    }

    pub(crate) fn unsolvable() -> Self {
        Self::at_least(GateKind::Solvable, 0.0, 1.0)
    }
}

/// Writes reason, value and limit, advice.
impl fmt::Display for Gate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [_, unit, reason, advice] = self.kind.texts();
        f.write_str(reason)?;
        if !unit.is_empty() {
            let (unit, of) = unit.split_at(unit.find(' ').unwrap_or(unit.len()));
            let (value, limit) = apart(self.value, self.limit, unit);
            write!(f, ": {value}{of} (limit {limit})")?;
        }
        if !advice.is_empty() {
            write!(f, "; {advice}")?;
        }
        Ok(())
    }
}

/// Formats two quantities with as few digits (at least two) as show that they differ.
fn apart(value: f64, limit: f64, unit: &str) -> (String, String) {
    let both = |digits| (quantity(value, digits, unit), quantity(limit, digits, unit));
    (2..6)
        .map(both)
        .find(|(value, limit)| value != limit)
        .unwrap_or_else(|| both(6))
}

/// Formats a number with its unit; long times in ms or s.
fn quantity(x: f64, digits: u8, unit: &str) -> String {
    match unit {
        "µs" if x.abs() >= 1e6 => rounded(x * 1e-6, digits) + " s",
        "µs" if x.abs() >= 1e3 => rounded(x * 1e-3, digits) + " ms",
        _ => rounded(x, digits) + " " + unit,
    }
}

/// Formats a number with `digits` significant digits, or all those before its point, and
/// without an exponent.
fn rounded(x: f64, digits: u8) -> String {
    let decimals = f64::from(digits) - 1.0 - x.abs().log10().floor();
    let decimals = decimals.clamp(0.0, 9.0) as usize;
    let text = format!("{x:.decimals$}");
    if decimals > 0 {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failure_is_said_with_its_figures() {
        assert_eq!(
            Gate::explained(0.7818).to_string(),
            "the gyroscopes do not match at any time shift: 78 % of the motion is unexplained \
             (limit 20 %); fix the gyroscopes rigidly to each other, and give recordings of the \
             same twist"
        );
        assert_eq!(
            Gate::sigma(100.4e-6, 100e-6).to_string(),
            "the 1-sigma of the offset is too large: 100.4 µs (limit 100 µs); twist more, or \
             about more axes"
        );
        assert_eq!(
            Gate::settled(false).to_string(),
            "the fit did not settle; twist again, about all axes"
        );
    }

    #[test]
    fn numbers_have_no_exponents() {
        let said = |value, limit, unit| {
            let (value, limit) = apart(value, limit, unit);
            format!("{value}, {limit}")
        };
        assert_eq!(said(0.012_34, 0.05, "rad/s"), "0.012 rad/s, 0.05 rad/s");
        assert_eq!(said(57.0, 100.0, "samples"), "57 samples, 100 samples");
        assert_eq!(said(0.0, 1.5, "s"), "0 s, 1.5 s");
        assert_eq!(said(20.04, 20.0, "%"), "20.04 %, 20 %");
        assert_eq!(said(1234.0, 100.0, "µs"), "1.2 ms, 100 µs");
        assert_eq!(said(2_345_678.0, 400.0, "µs"), "2.3 s, 400 µs");
        assert_eq!(said(f64::INFINITY, 100.0, "ppm"), "inf ppm, 100 ppm");
    }
}
