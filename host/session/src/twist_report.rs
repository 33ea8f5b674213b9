//! The report of a twist: what the estimator found on the way, with its stream a as the
//! board's gyroscope (`mcu`) and stream b as the phone's.

use serde::Serialize;
use twist_sync::{
    Action, Estimate, Fault, FaultKind, Gate, LeftOut, Refusal, Report, Stream, Warning, Why,
};

/// What was found on the way to an estimate or to a refusal.
pub const fn report_of(result: &Result<Estimate, Refusal>) -> &Report {
    match result {
        Ok(estimate) => &estimate.report,
        Err(refusal) => &refusal.report,
    }
}

/// Whose gyroscope a stream is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Device {
    Mcu,
    Phone,
}

impl Device {
    pub const fn name(self) -> &'static str {
        match self {
            Self::Mcu => "board",
            Self::Phone => "phone",
        }
    }
}

impl From<Stream> for Device {
    fn from(stream: Stream) -> Self {
        match stream {
            Stream::A => Self::Mcu,
            Stream::B => Self::Phone,
        }
    }
}

/// A [`Report`] as `offset --json` prints it and `session.json` holds it.
#[derive(Debug, Serialize)]
pub struct TwistReport {
    pub residual_rms: Option<f64>,
    pub motion_rms: Option<f64>,
    pub overlap_s: Option<f64>,
    faults: Vec<DeviceFault>,
    /// From, to, seconds from the board's first sample.
    pub together: Vec<(f64, f64)>,
    pub left_out: Vec<Stretch>,
    gates: Vec<Gate>,
    pub warnings: Vec<String>,
}

/// A stretch of both recordings that was left out.
#[derive(Debug, Serialize)]
pub struct Stretch {
    /// Begin and end, seconds from the board's first sample.
    from_s: f64,
    to_s: f64,
    /// `apart`, `slipped` or `time_step`.
    why: &'static str,
    turned_deg: Option<f64>,
    turned_sigma_deg: Option<f64>,
    step_s: Option<f64>,
    #[serde(skip)]
    pub text: String,
}

impl From<&LeftOut> for Stretch {
    fn from(left_out: &LeftOut) -> Self {
        let (why, turned, step_s) = match left_out.why {
            Why::Apart => ("apart", None, None),
            Why::Slipped { by, sigma } => ("slipped", Some((by, sigma)), None),
            Why::TimeStep(by_s) => ("time_step", None, Some(by_s)),
        };
        Self {
            from_s: left_out.from_s,
            to_s: left_out.to_s,
            why,
            turned_deg: turned.map(|(by, _)| by.to_degrees()),
            turned_sigma_deg: turned.map(|(_, sigma)| sigma.to_degrees()),
            step_s,
            text: left_out.to_string(),
        }
    }
}

#[derive(Debug, Serialize)]
struct DeviceFault {
    stream: Device,
    kind: FaultKind,
    count: usize,
    period: Option<f64>,
    displacement_s: Option<f64>,
    action: Action,
}

impl From<&Report> for TwistReport {
    fn from(report: &Report) -> Self {
        Self {
            residual_rms: report.residual_rms,
            motion_rms: report.motion_rms,
            overlap_s: report.overlap_s,
            faults: report.faults.iter().map(DeviceFault::from).collect(),
            together: report.together.clone(),
            left_out: report.left_out.iter().map(Stretch::from).collect(),
            gates: report.gates.clone(),
            warnings: report.warnings.iter().map(warning).collect(),
        }
    }
}

impl TwistReport {
    /// When the two moved as one body, in words; `None` where no part of them did.
    pub fn together_text(&self) -> Option<String> {
        let stretch = |(from, to): &(f64, f64)| format!("from {from:.1} s to {to:.1} s");
        let stretches: Vec<String> = self.together.iter().map(stretch).collect();
        (!stretches.is_empty()).then(|| {
            let stretches = stretches.join(", ");
            format!("board and phone moved as one body {stretches}")
        })
    }
}

impl From<&Fault> for DeviceFault {
    fn from(fault: &Fault) -> Self {
        Self {
            stream: fault.stream.into(),
            kind: fault.kind,
            count: fault.count,
            period: fault.period,
            displacement_s: fault.displacement_s,
            action: fault.action,
        }
    }
}

fn warning(warning: &Warning) -> String {
    match warning {
        Warning::ManyLeftOut { stream, part } => format!(
            "{:.0} % of the samples of the {} were left out; see faults",
            part * 100.0,
            Device::from(*stream).name()
        ),
        other => other.to_string(),
    }
}
