//! The quality gates: what an estimate must pass, each with its limit and reason.

use std::fmt;

use serde::Serialize;

/// Fewest usable samples of a stream.
const FEWEST_SAMPLES: f64 = 100.0;
/// Least rms of the in-band rate, rad/s: a hand at rest or a table stays below.
const LEAST_MOTION: f64 = 0.05;
/// Largest part of the motion's rms that the quick fit may leave unexplained,
/// faults not yet removed. Unrelated twists leave more than half.
const UNEXPLAINED_AT_FIRST: f64 = 0.2;
/// By how much worse the best rival among the time shifts must explain the motion,
/// as a ratio of the residual power.
const WORSE_RIVAL: f64 = 4.0;
/// Residual that is allowed: this part of the motion's rms, and so many times the
/// in-band noise.
const RESIDUAL_OF_MOTION: f64 = 0.03;
const RESIDUAL_OF_NOISE: f64 = 3.0;
/// Least part of a stream's samples that must be usable.
const LEAST_USABLE: f64 = 0.5;
/// Least part of the information that one relation of the clocks must hold.
const LEAST_SHARE: f64 = 0.6;
/// Largest rms disagreement between parts of the overlap, seconds.
const LOCAL_SCATTER_S: f64 = 400e-6;
/// Largest plausible rate difference of two crystal clocks.
const LARGEST_SKEW: f64 = 500e-6;

/// One gate.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Gate {
    /// Short stable name.
    pub name: &'static str,
    /// Whether it was passed.
    pub passed: bool,
    /// What was measured, in `unit`.
    pub value: f64,
    /// What it is compared with, in `unit`.
    pub limit: f64,
    /// Unit of value and limit.
    pub unit: &'static str,
    /// What a failure means.
    pub reason: &'static str,
    /// What to do about a failure; empty where the reason says it.
    pub advice: &'static str,
    /// Value and limit in a sentence; empty where they say nothing.
    #[serde(skip)]
    figures: String,
}

/// The texts of a gate.
struct Texts {
    name: &'static str,
    unit: &'static str,
    reason: &'static str,
    /// The unit in a sentence.
    short_unit: &'static str,
    /// What the value is, after its unit in a sentence.
    measured: &'static str,
    advice: &'static str,
}

impl Gate {
    fn new(texts: &Texts, passed: bool, value: f64, limit: f64) -> Self {
        let (value_text, limit_text) = apart(value, limit, texts.short_unit);
        Self {
            name: texts.name,
            passed,
            value,
            limit,
            unit: texts.unit,
            reason: texts.reason,
            advice: texts.advice,
            figures: format!("{value_text}{} (limit {limit_text})", texts.measured),
        }
    }

    fn at_least(texts: &Texts, value: f64, limit: f64) -> Self {
        Self::new(texts, value >= limit, value, limit)
    }

    fn at_most(texts: &Texts, value: f64, limit: f64) -> Self {
        Self::new(texts, value <= limit, value, limit)
    }

    /// A gate that says yes or no.
    fn holds(name: &'static str, holds: bool, reason: &'static str) -> Self {
        Self {
            name,
            passed: holds,
            value: f64::from(u8::from(holds)),
            limit: 1.0,
            unit: "",
            reason,
            advice: "",
            figures: String::new(),
        }
    }

    pub(crate) fn samples(fewest: usize) -> Self {
        let texts = Texts {
            name: "samples",
            unit: "samples",
            reason: "a recording has too few usable samples",
            short_unit: "",
            measured: "",
            advice: "",
        };
        Self::at_least(&texts, fewest as f64, FEWEST_SAMPLES)
    }

    /// `rms` in rad/s, of the stream that moves less.
    pub(crate) fn motion(rms: f64) -> Self {
        let texts = Texts {
            name: "motion",
            unit: "rad/s rms",
            reason: "too little motion",
            short_unit: " rad/s",
            measured: " rms",
            advice: "twist the rig by hand for some seconds",
        };
        Self::at_least(&texts, rms, LEAST_MOTION)
    }

    pub(crate) fn overlap(common_s: f64, limit_s: f64) -> Self {
        let texts = Texts {
            name: "overlap",
            unit: "s",
            reason: "the recordings have too little time in common",
            short_unit: " s",
            measured: "",
            advice: "",
        };
        Self::at_least(&texts, common_s, limit_s)
    }

    /// `unexplained` is a part of the motion's rms.
    pub(crate) fn explained(unexplained: f64) -> Self {
        let texts = Texts {
            name: "explained",
            unit: "% of the motion's rms",
            reason: "the gyroscopes do not match at any time shift",
            short_unit: " %",
            measured: " of the motion is unexplained",
            advice: SAME_TWIST,
        };
        Self::at_most(&texts, 100.0 * unexplained, 100.0 * UNEXPLAINED_AT_FIRST)
    }

    /// `worse` is the residual power of the best rival over that of the best.
    pub(crate) fn unique_peak(worse: f64) -> Self {
        let texts = Texts {
            name: "unique_peak",
            unit: "times the residual power",
            reason: "several time shifts explain the motion about equally well",
            short_unit: " times",
            measured: " the residual power at the second best",
            advice: "twist irregularly",
        };
        Self::at_least(&texts, worse.min(1e6), WORSE_RIVAL)
    }

    /// All in rad/s rms.
    pub(crate) fn residual(residual: f64, motion: f64, noise: f64) -> Self {
        let texts = Texts {
            name: "residual",
            unit: "rad/s rms",
            reason: "one motion does not explain both recordings",
            short_unit: " rad/s",
            measured: " rms is unexplained",
            advice: SAME_TWIST,
        };
        let allowed = RESIDUAL_OF_MOTION * motion + RESIDUAL_OF_NOISE * noise;
        Self::at_most(&texts, residual, allowed)
    }

    /// `kept` is a part of the samples of the stream that lost more.
    pub(crate) fn usable(kept: f64) -> Self {
        let texts = Texts {
            name: "usable",
            unit: "% of a stream",
            reason: "too many samples had to be left out",
            short_unit: " %",
            measured: " of a stream is left",
            advice: "",
        };
        Self::at_least(&texts, 100.0 * kept, 100.0 * LEAST_USABLE)
    }

    /// `share` is a part of the information.
    pub(crate) fn one_relation(share: f64) -> Self {
        let texts = Texts {
            name: "one_relation",
            unit: "% of the information",
            reason: "the relation of the clocks jumps within the recording and no part prevails",
            short_unit: " %",
            measured: " of the information is in one relation",
            advice: "",
        };
        Self::at_least(&texts, 100.0 * share, 100.0 * LEAST_SHARE)
    }

    pub(crate) fn consistent(scatter_s: f64) -> Self {
        let texts = Texts {
            name: "consistent",
            unit: "µs rms between parts",
            reason: "parts of the overlap disagree about the offset",
            short_unit: " µs",
            measured: " rms",
            advice: "",
        };
        Self::at_most(&texts, 1e6 * scatter_s, 1e6 * LOCAL_SCATTER_S)
    }

    pub(crate) fn sigma(sigma_s: f64, limit_s: f64) -> Self {
        let texts = Texts {
            name: "sigma",
            unit: "µs",
            reason: "the offset is not known well enough",
            short_unit: " µs",
            measured: " 1-sigma",
            advice: "twist more, or about more axes",
        };
        Self::at_most(&texts, 1e6 * sigma_s, 1e6 * limit_s)
    }

    pub(crate) fn skew(skew: f64, sigma: f64) -> Self {
        let texts = Texts {
            name: "skew",
            unit: "ppm",
            reason: "no two crystals differ that much",
            short_unit: " ppm",
            measured: "",
            advice: "a timestamp unit or a recording is wrong",
        };
        Self::at_most(&texts, 1e6 * skew.abs(), 1e6 * (LARGEST_SKEW + 3.0 * sigma))
    }

    pub(crate) fn settled(settled: bool) -> Self {
        Self::holds("settled", settled, "the fit did not settle")
    }

    pub(crate) fn unsolvable() -> Self {
        let reason = "the recordings share too little usable time for a fit";
        Self::holds("solvable", false, reason)
    }
}

const SAME_TWIST: &str =
    "fix the gyroscopes rigidly to each other, and give recordings of the same twist";

/// Reason, figures and advice.
impl fmt::Display for Gate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.reason)?;
        if !self.figures.is_empty() {
            write!(f, ": {}", self.figures)?;
        }
        if !self.advice.is_empty() {
            write!(f, "; {}", self.advice)?;
        }
        Ok(())
    }
}

/// Two quantities, rounded to as few digits (two at least) as show that they differ.
fn apart(value: f64, limit: f64, unit: &str) -> (String, String) {
    let both = |digits| (quantity(value, digits, unit), quantity(limit, digits, unit));
    (2..6)
        .map(both)
        .find(|(value, limit)| value != limit)
        .unwrap_or_else(|| both(6))
}

/// A number with its unit; long times in ms or s.
fn quantity(x: f64, digits: u8, unit: &str) -> String {
    match unit {
        " µs" if x.abs() >= 1e6 => rounded(x * 1e-6, digits) + " s",
        " µs" if x.abs() >= 1e3 => rounded(x * 1e-3, digits) + " ms",
        _ => rounded(x, digits) + unit,
    }
}

/// A number with so many significant digits, or all those before its point, and
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
            "the offset is not known well enough: 100.4 µs 1-sigma (limit 100 µs); \
             twist more, or about more axes"
        );
        assert_eq!(Gate::settled(false).to_string(), "the fit did not settle");
    }

    #[test]
    fn numbers_have_no_exponents() {
        let said = |value, limit, unit| {
            let (value, limit) = apart(value, limit, unit);
            format!("{value}, {limit}")
        };
        assert_eq!(said(0.012_34, 0.05, " rad/s"), "0.012 rad/s, 0.05 rad/s");
        assert_eq!(said(57.0, 100.0, ""), "57, 100");
        assert_eq!(said(0.0, 1.5, " s"), "0 s, 1.5 s");
        assert_eq!(said(20.04, 20.0, " %"), "20.04 %, 20 %");
        assert_eq!(said(1234.0, 100.0, " µs"), "1.2 ms, 100 µs");
        assert_eq!(said(2_345_678.0, 400.0, " µs"), "2.3 s, 400 µs");
        assert_eq!(said(f64::INFINITY, 100.0, " ppm"), "inf ppm, 100 ppm");
    }
}
