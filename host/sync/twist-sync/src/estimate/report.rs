//! The outcome of an estimate: accepted or refused, with the figures, faults and gates that it
//! is based on.

use std::fmt;

use super::gates::{Gate, GateKind};
use crate::clock::{ClockRelation, WithSigma};
use crate::faults::{Fault, FaultKind, LeftOut, Stream};
use crate::signal::interpolant::Vec3;

/// An accepted estimate.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Estimate {
    /// The relation of the clocks with its covariance. Its reference is the centroid of the
    /// information about the offset.
    pub clock: ClockRelation,
    /// Rotation, scale and cross-axis errors of both sensors, as rows:
    /// `rate of b = calibration · rate of a + bias`.
    pub calibration: [[f64; 3]; 3],
    /// Difference of the gyroscopes' biases in the axes of b, rad/s.
    pub bias: Vec3,
    /// Figures, faults and gates on which the estimate is based.
    pub report: Report,
}

impl Estimate {
    /// Returns the 1-sigma of the offset at the reference, in seconds.
    #[must_use]
    pub fn offset_sigma_s(&self) -> f64 {
        self.clock.covariance[0][0].sqrt()
    }

    /// Returns the 1-sigma of the skew at the reference.
    #[must_use]
    pub fn skew_sigma(&self) -> f64 {
        self.clock.covariance[1][1].sqrt()
    }
}

/// Refusal of an estimate, with the gates that were not passed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("no trustworthy clock relation: {}", .report.failures())]
pub struct Refusal {
    /// Figures and gates; at least one gate is not passed.
    pub report: Report,
}

impl Refusal {
    /// Returns true if both gyroscopes move, but do not match at any lag that was tried.
    pub(crate) fn is_about_lag(&self) -> bool {
        let is_about_lag = |gate: &Gate| !gate.passed && gate.kind.is_about_lag();
        self.report.gates.iter().any(is_about_lag)
    }
}

/// Figures on which an estimate or a refusal is based.
#[derive(Debug, Clone, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(default))]
pub struct Report {
    /// Rms of the in-band residual over the overlap and the axes, in rad/s.
    pub residual_rms: Option<f64>,
    /// Rms of the motion over the overlap and the axes, in rad/s.
    pub motion_rms: Option<f64>,
    /// Part of the offset's 1-sigma that all estimates of these streams share, in seconds: due
    /// to the filters' dispersion and the resolution of coarse stamps.
    pub common_s: f64,
    /// Time that both recordings have in common and that was used, in seconds.
    pub overlap_s: Option<f64>,
    /// Faults of both streams, those of a first.
    pub faults: Vec<Fault>,
    /// Stretches (from, to) that the estimate is from, in which the two moved as one body, in
    /// seconds from the first sample of a.
    pub together: Vec<(f64, f64)>,
    /// Stretches of both streams that were left out.
    pub left_out: Vec<LeftOut>,
    /// All gates that could be judged.
    pub gates: Vec<Gate>,
    /// Warnings; they do not prevent an estimate.
    pub warnings: Vec<Warning>,
}

impl Report {
    /// Returns the reasons of the gates that were not passed, with their figures.
    #[must_use]
    pub fn failures(&self) -> String {
        let reasons: Vec<String> = self
            .gates
            .iter()
            .filter(|gate| !gate.passed)
            .map(Gate::to_string)
            .collect();
        reasons.join("; ")
    }

    /// Returns the jump of the sawtooth in a stream's timestamps, in seconds, if they show one.
    #[must_use]
    pub fn sawtooth_s(&self, stream: Stream) -> Option<f64> {
        let is_sawtooth =
            |fault: &&Fault| fault.stream == stream && fault.kind == FaultKind::TimestampSawtooth;
        self.faults.iter().rfind(is_sawtooth)?.displacement_s
    }

    /// Records a judged gate; returns `None` if it is not passed.
    pub(crate) fn judge(&mut self, gate: Gate) -> Option<()> {
        let passed = gate.passed;
        self.gates.push(gate);
        passed.then_some(())
    }

    /// Judges the offset's sigma by another limit, seconds.
    pub(super) fn limit_sigma(&mut self, limit_s: f64) {
        self.rejudge_sigma(|gate| Gate::sigma(gate.value * 1e-6, limit_s));
    }

    /// Replaces the judgement of the offset's sigma, if there is one.
    pub(super) fn rejudge_sigma(&mut self, judged: impl Fn(&Gate) -> Gate) {
        let known = self.gates.iter_mut();
        let known = known.filter(|gate| gate.kind == GateKind::Sigma);
        known.for_each(|gate| *gate = judged(gate));
    }

    pub(super) fn is_passed(&self) -> bool {
        self.gates.iter().all(|gate| gate.passed)
    }
}

/// A limitation of an accepted estimate. [`Display`](fmt::Display) explains it in a sentence.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
#[non_exhaustive]
pub enum Warning {
    /// The motion was about one axis only.
    OneAxis,
    /// Faults of the timestamps cause an additional uncertainty of the offset.
    TimeLeftOpen {
        /// Its 1-sigma in seconds, which is part of the offset's.
        sigma_s: f64,
    },
    /// The timestamps of a stream are multiples of a coarse step, half of which is part of the
    /// offset's sigma.
    CoarseStamps {
        /// Stream with these timestamps.
        stream: Stream,
        /// The step in seconds.
        resolution_s: f64,
    },
    /// The samples of a stream lie on straight lines between slower samples.
    Interpolated {
        /// Stream with these samples.
        stream: Stream,
        /// Rate of the slower samples in Hz.
        rate_hz: f64,
    },
    /// The samples of a stream are slower samples, each of which is repeated.
    Held {
        /// Stream with these samples.
        stream: Stream,
        /// Rate of the slower samples in Hz.
        rate_hz: f64,
    },
    /// One axis of a gyroscope is late against the other two, to which the offset belongs.
    LateAxis {
        /// Stream with the late axis.
        stream: Stream,
        /// The axis: 0 to 2 for x to z.
        axis: usize,
        /// Its lateness in seconds.
        by: WithSigma,
    },
    /// Faster motion shows another relation, as vibration that is aliased does: the estimate is
    /// from a low band.
    LowBand {
        /// −3 dB frequency of the low band, Hz.
        low_pass_hz: f64,
    },
}

impl Warning {
    /// Returns the sentence with these names in place of "stream a" and "stream b".
    #[must_use]
    pub fn named(&self, a: &str, b: &str) -> String {
        let name = |stream: &Stream| match stream {
            Stream::A => a,
            Stream::B => b,
        };
        match self {
            Self::OneAxis => String::from(
                "motion about one axis only: the offset is good, the calibration is known for \
                 that axis alone",
            ),
            Self::TimeLeftOpen { sigma_s } => format!(
                "the timestamps leave {:.1} µs open (few resets of a sawtooth, or two equal \
                 classes of samples); it is part of the sigma",
                sigma_s * 1e6
            ),
            Self::CoarseStamps {
                stream,
                resolution_s,
            } => format!(
                "the timestamps of {} have steps of {} ms; half a step is part of the sigma",
                name(stream),
                resolution_s * 1e3
            ),
            Self::Interpolated { stream, rate_hz } => format!(
                "{} is interpolated between samples of about {rate_hz:.0} Hz",
                name(stream)
            ),
            Self::Held { stream, rate_hz } => format!(
                "{} holds samples of about {rate_hz:.0} Hz; only the first of each is used",
                name(stream)
            ),
            Self::LowBand { low_pass_hz } => format!(
                "the estimate is from motion below {low_pass_hz:.1} Hz: faster motion shows another \
                 relation, as vibration does that is faster than half the samples"
            ),
            Self::LateAxis { stream, axis, by } => format!(
                "axis {} of {} comes {:.0} ± {:.0} µs later than its other two, to which \
                 the offset belongs",
                ["x", "y", "z"][*axis % 3],
                name(stream),
                by.value * 1e6,
                by.sigma * 1e6
            ),
        }
    }
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.named("stream a", "stream b"))
    }
}
