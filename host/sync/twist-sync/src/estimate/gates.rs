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

/// One judged quality gate: a measured value against its limit.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Gate {
    /// Short stable name, such as `unique_peak`.
    pub name: &'static str,
    /// True if the measured value is within the limit.
    pub passed: bool,
    /// Measured value, in `unit`.
    pub value: f64,
    /// Limit of the value, in `unit`.
    pub limit: f64,
    /// Unit of value and limit, followed by the quantity where it is not obvious; empty for a
    /// gate whose value is yes (1) or no (0).
    pub unit: &'static str,
    /// Meaning of a failure.
    pub reason: &'static str,
    /// Next step after a failure; empty if the reason implies it.
    pub advice: &'static str,
}

impl Gate {
    /// Largest ratio of the motions of two recordings, one of which may be mostly at rest.
    const LARGEST_RATIO: f64 = 20.0;
    /// Part of the motion's rms below which an unexplained residual does not put the
    /// lag in doubt.
    pub(crate) const MOSTLY_EXPLAINED: f64 = UNEXPLAINED_AT_FIRST;

    /// Gates that fail if the true lag is outside of the search.
    pub(crate) const ABOUT_LAG: [&'static str; 5] = [
        "overlap",
        "explained",
        "unique_peak",
        "one_body",
        "one_relation",
    ];

    fn at_least(name: &'static str, value: f64, limit: f64, unit: &'static str) -> Self {
        Self {
            name,
            passed: value >= limit,
            value,
            limit,
            unit,
            reason: "",
            advice: "",
        }
    }

    fn at_most(name: &'static str, value: f64, limit: f64, unit: &'static str) -> Self {
        Self {
            passed: value <= limit,
            ..Self::at_least(name, value, limit, unit)
        }
    }

    /// Like [`Self::at_least`], with value and limit as fractions that are shown in percent.
    fn part_at_least(name: &'static str, value: f64, limit: f64, unit: &'static str) -> Self {
        Self::at_least(name, 100.0 * value, 100.0 * limit, unit)
    }

    fn or(self, reason: &'static str, advice: &'static str) -> Self {
        Self {
            reason,
            advice,
            ..self
        }
    }

    pub(crate) fn samples(fewest: usize) -> Self {
        Self::at_least("samples", fewest as f64, FEWEST_SAMPLES, "samples").or(
            "a recording has too few usable samples",
            "record for some seconds at 100 samples a second or more",
        )
    }

    /// `step_s` is the distance of samples, of the stream where it is larger.
    pub(crate) fn rate(step_s: f64) -> Self {
        let reason = "the samples are too far apart for a twist";
        let advice = "record 100 samples a second or more, and check the unit of the time";
        let rate_hz = step_s.max(f64::MIN_POSITIVE).recip();
        Self::at_least("rate", rate_hz, LEAST_RATE_HZ, "Hz").or(reason, advice)
    }

    /// `rms` in rad/s, of the stream that moves less.
    pub(crate) fn motion(rms: f64) -> Self {
        let advice = "twist the rig by hand for some seconds";
        Self::at_least("motion", rms, LEAST_MOTION, "rad/s rms").or("too little motion", advice)
    }

    /// `constant` axes have the same value all the time, of the stream that has more of them.
    pub(crate) fn axes(constant: usize) -> Self {
        let reason = "of a stream two axes are constant";
        let advice = "give the rates about all three axes, and check the columns";
        Self::at_most("axes", constant as f64, 1.0, "axes").or(reason, advice)
    }

    /// `ratio` of the larger to the smaller motion of the two.
    pub(crate) fn unit(ratio: f64) -> Self {
        let reason = "the rates of one are many times those of the other";
        let advice = "check the units: both must be in rad/s, which is 57.3 degrees a second";
        Self::at_most("unit", ratio, Self::LARGEST_RATIO, "times").or(reason, advice)
    }

    pub(crate) fn overlap(common_s: f64, limit_s: f64) -> Self {
        Self::at_least("overlap", common_s, limit_s, "s").or(
            "the recordings have too little time in common",
            "record both at the same time, and twist for some seconds",
        )
    }

    /// `unexplained` is a part of the motion's rms.
    pub(crate) fn explained(unexplained: f64) -> Self {
        let (value, limit) = (100.0 * unexplained, 100.0 * UNEXPLAINED_AT_FIRST);
        Self::at_most("explained", value, limit, "% of the motion is unexplained")
            .or("the gyroscopes do not match at any time shift", SAME_TWIST)
    }

    /// `worse` is the residual power of the best rival over that of the best.
    pub(crate) fn unique_peak(worse: f64) -> Self {
        let unit = "times the residual power at the second best";
        let reason = "several time shifts explain the motion about equally well";
        Self::at_least("unique_peak", worse.min(1e6), WORSE_RIVAL, unit)
            .or(reason, "twist irregularly")
    }

    /// All in rad/s rms.
    pub(crate) fn residual(residual: f64, motion: f64, noise: f64) -> Self {
        let allowed = RESIDUAL_OF_MOTION * motion + RESIDUAL_OF_NOISE * noise;
        let reason = "one motion does not explain both recordings";
        Self::at_most("residual", residual, allowed, "rad/s rms").or(reason, SAME_TWIST)
    }

    /// `part` of the samples, of the stream that lost more.
    pub(crate) fn usable(part: f64) -> Self {
        Self::part_at_least("usable", part, LEAST_USABLE, "% of a stream is left").or(
            "too many samples had to be left out",
            "the list of faults says why; close other apps on its device, and twist again",
        )
    }

    /// `share` is a part of the motion's power.
    pub(crate) fn one_body(share: f64) -> Self {
        let unit = "% of the motion is that of one body";
        Self::part_at_least("one_body", share, LEAST_ONE_BODY, unit).or(
            "too little is left where the two moved as one body",
            "take a firm hold before the twist begins, and keep it to the end",
        )
    }

    /// `share` is a part of the information.
    pub(crate) fn one_relation(share: f64) -> Self {
        let unit = "% of the information is in one relation";
        Self::part_at_least("one_relation", share, LEAST_SHARE, unit).or(
            "the relation of the clocks jumps within the recording",
            "twist again; if it jumps again, the timestamps of a device are at fault",
        )
    }

    /// `by_noise_s` is the disagreement that the sigma explains.
    pub(crate) fn consistent(scatter_s: f64, by_noise_s: f64) -> Self {
        let limit_s = LOCAL_SCATTER_S.hypot(TIMES_BY_NOISE * by_noise_s);
        let unit = "µs rms between parts";
        Self::at_most("consistent", 1e6 * scatter_s, 1e6 * limit_s, unit).or(
            "parts of the overlap disagree about the offset",
            "the timestamps of a device wander, or the two were not held firmly: twist again",
        )
    }

    pub(crate) fn bands() -> Self {
        Self::at_least("bands", 0.0, 1.0, "").or(
            "slow and fast motion show different offsets",
            "the two do not move as one body, or vibrate faster than they are sampled",
        )
    }

    pub(crate) fn sigma(sigma_s: f64, limit_s: f64) -> Self {
        let reason = "the 1-sigma of the offset is too large";
        Self::at_most("sigma", 1e6 * sigma_s, 1e6 * limit_s, "µs")
            .or(reason, "twist more, or about more axes")
    }

    pub(crate) fn skew(skew: f64, sigma: f64) -> Self {
        let limit = 1e6 * (LARGEST_SKEW + 3.0 * sigma);
        let reason = "no two crystals differ that much";
        Self::at_most("skew", 1e6 * skew.abs(), limit, "ppm")
            .or(reason, "a timestamp unit or a recording is wrong")
    }

    pub(crate) fn settled(settled: bool) -> Self {
        Self::at_least("settled", f64::from(u8::from(settled)), 1.0, "")
            .or("the fit did not settle", "twist again, about all axes")
    }

    pub(crate) fn unsolvable() -> Self {
        let reason = "the recordings share too little usable time for a fit";
        Self::at_least("solvable", 0.0, 1.0, "").or(reason, "twist for longer")
    }
}

const SAME_TWIST: &str =
    "fix the gyroscopes rigidly to each other, and give recordings of the same twist";

/// Writes reason, value and limit, advice.
impl fmt::Display for Gate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.reason)?;
        if !self.unit.is_empty() {
            let word = self.unit.find(' ').unwrap_or(self.unit.len());
            let (unit, of) = self.unit.split_at(word);
            let (value, limit) = apart(self.value, self.limit, unit);
            write!(f, ": {value}{of} (limit {limit})")?;
        }
        if !self.advice.is_empty() {
            write!(f, "; {}", self.advice)?;
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
