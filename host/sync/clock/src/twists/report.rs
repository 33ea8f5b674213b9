//! Findings of the estimator about one twist, as the session file stores them: stream a is called
//! the board, stream b the phone.

use serde::{Deserialize, Serialize};
use twist_sync::{Action, Fault, FaultKind, Gate, LeftOut, Report, Stream, Warning};

/// Findings of the estimator about one twist.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct TwistReport {
    /// Rms of the in-band residual, rad/s.
    pub residual_rms: Option<f64>,
    /// Rms of the motion, rad/s.
    pub motion_rms: Option<f64>,
    /// Time that both recordings have in common and that was used, s.
    pub overlap_s: Option<f64>,
    /// Faults of both streams, those of the board first.
    pub faults: Vec<TwistFault>,
    /// Stretches (from, to) in which board and phone moved as one body, s from the board's first
    /// sample.
    pub together: Vec<(f64, f64)>,
    /// Stretches of both recordings that were left out.
    pub left_out: Vec<LeftOut>,
    /// Gates that could be judged.
    pub gates: Vec<TwistGate>,
    /// Remarks about an estimate that is accepted nevertheless, as sentences.
    pub warnings: Vec<String>,
}

/// Device whose samples a stream holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Device {
    /// The board, stream a.
    Board,
    /// The phone, stream b.
    Phone,
}

/// One fault of one stream; see [`Fault`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TwistFault {
    /// The stream.
    pub stream: Device,
    /// Kind of the fault.
    pub kind: FaultKind,
    /// Number of samples (of a sawtooth: jumps).
    pub count: usize,
    /// Period of the recurrence in samples, if the fault recurs.
    pub period: Option<f64>,
    /// Displacement of the samples' content or time, s.
    pub displacement_s: Option<f64>,
    /// Treatment of the samples.
    pub action: Action,
}

/// One gate; see [`Gate`]. Figures that are not finite are missing in a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TwistGate {
    /// Short stable name.
    pub name: String,
    /// True if the measured value is within the limit.
    pub passed: bool,
    /// Measured value, in `unit`.
    pub value: Option<f64>,
    /// Limit of the value, in `unit`.
    pub limit: Option<f64>,
    /// Unit of value and limit.
    pub unit: String,
    /// Meaning of a failure.
    pub reason: String,
    /// Next step after a failure; empty where the reason is enough.
    pub advice: String,
}

/// Returns the sentence of a warning with the names of the two devices.
#[must_use]
pub fn warning_text(warning: &Warning) -> String {
    warning.named("the board's stream", "the phone's stream")
}

impl TwistReport {
    /// Jump of the sawtooth in the phone's timestamps, s, if they showed one.
    #[must_use]
    pub fn phone_sawtooth_s(&self) -> Option<f64> {
        let is_sawtooth = |fault: &&TwistFault| {
            fault.stream == Device::Phone && fault.kind == FaultKind::TimestampSawtooth
        };
        self.faults.iter().rfind(is_sawtooth)?.displacement_s
    }
}

impl From<&Report> for TwistReport {
    fn from(report: &Report) -> Self {
        Self {
            residual_rms: report.residual_rms,
            motion_rms: report.motion_rms,
            overlap_s: report.overlap_s,
            faults: report.faults.iter().map(TwistFault::from).collect(),
            together: report.together.clone(),
            left_out: report.left_out.clone(),
            gates: report.gates.iter().map(TwistGate::from).collect(),
            warnings: report.warnings.iter().map(warning_text).collect(),
        }
    }
}

impl From<&Fault> for TwistFault {
    fn from(fault: &Fault) -> Self {
        Self {
            stream: match fault.stream {
                Stream::A => Device::Board,
                Stream::B => Device::Phone,
            },
            kind: fault.kind,
            count: fault.count,
            period: fault.period,
            displacement_s: fault.displacement_s,
            action: fault.action,
        }
    }
}

impl From<&Gate> for TwistGate {
    fn from(gate: &Gate) -> Self {
        Self {
            name: gate.name.to_owned(),
            passed: gate.passed,
            value: Some(gate.value),
            limit: Some(gate.limit),
            unit: gate.unit.to_owned(),
            reason: gate.reason.to_owned(),
            advice: gate.advice.to_owned(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The last of two sawteeth of the phone counts, and a gate survives without a finite value.
    #[test]
    fn a_report_is_read_as_it_was_written() {
        let fault = |stream, kind, displacement_s| Fault {
            stream,
            kind,
            count: 3,
            period: None,
            displacement_s,
            action: Action::Corrected,
            samples: vec![1, 2, 3],
        };
        let sawtooth = FaultKind::TimestampSawtooth;
        let gate = Gate {
            name: "unit",
            passed: false,
            value: f64::INFINITY,
            limit: 20.0,
            unit: "times",
            reason: "reason",
            advice: "",
        };
        let report = Report {
            faults: vec![
                fault(Stream::A, sawtooth, Some(1e-3)),
                fault(Stream::B, sawtooth, Some(2e-3)),
                fault(Stream::B, sawtooth, Some(4e-3)),
                fault(Stream::B, FaultKind::Outlier, None),
            ],
            gates: vec![gate],
            warnings: vec![Warning::Held {
                stream: Stream::B,
                rate_hz: 50.0,
            }],
            ..Report::default()
        };
        let stored = TwistReport::from(&report);
        assert_eq!(stored.phone_sawtooth_s(), Some(4e-3));
        assert!(stored.warnings[0].starts_with("the phone's stream holds samples"));
        let text = serde_json::to_string(&stored).unwrap();
        assert!(text.contains(r#""stream":"phone","kind":"timestamp_sawtooth""#));
        let read: TwistReport = serde_json::from_str(&text).unwrap();
        assert_eq!((read.gates[0].value, &read.faults), (None, &stored.faults));
    }
}
