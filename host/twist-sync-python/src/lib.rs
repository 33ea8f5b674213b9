//! The Python package `twist-sync`: arrays in, numbers out. Everything with a name and a type
//! is in `python/twist_sync/__init__.py`; this is the way between it and the crate.
//!
//! Arrays come as bytes, little-endian, so that no version of numpy is built against.

// A refusal carries its report, and there is one a call.
#![allow(clippy::result_large_err)]

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use twist_sync::{
    ClockRelation, Fault, Gate, GyroTrack, LeftOut, Options, Prior, RecordingClock, Report, Wander,
    Why, course_of_tracks, estimate_offset,
};

/// Times (f64 seconds, or i64 nanoseconds), rates of three axes (f64), whether the times are
/// nanoseconds.
type Stream<'py> = (&'py [u8], &'py [u8], bool);

fn words<const N: usize>(bytes: &[u8]) -> impl Iterator<Item = [u8; N]> + '_ {
    bytes.as_chunks::<N>().0.iter().copied()
}

fn track((t, w, nanos): Stream<'_>) -> PyResult<GyroTrack> {
    let w: Vec<[f64; 3]> = words::<24>(w)
        .map(|row| {
            let mut axes = words::<8>(&row).map(f64::from_le_bytes);
            std::array::from_fn(|_| axes.next().unwrap_or(f64::NAN))
        })
        .collect();
    if t.len() / 8 != w.len() {
        return Err(PyValueError::new_err("as many rates as times are expected"));
    }
    Ok(if nanos {
        let t: Vec<i64> = words(t).map(i64::from_le_bytes).collect();
        GyroTrack::from_nanos(&t, w)
    } else {
        let t: Vec<f64> = words(t).map(f64::from_le_bytes).collect();
        GyroTrack::from_seconds(&t, w)
    })
}

/// What is not given is the crate's default.
#[derive(FromPyObject)]
struct Settings {
    #[pyo3(item)]
    low_pass_hz: Option<f64>,
    #[pyo3(item)]
    degree: Option<usize>,
    #[pyo3(item)]
    a_delay: f64,
    #[pyo3(item)]
    b_delay: f64,
    #[pyo3(item)]
    sigma_limit: Option<f64>,
    #[pyo3(item)]
    min_overlap: Option<f64>,
    #[pyo3(item)]
    handle_faults: bool,
    #[pyo3(item)]
    wander_ppm: Option<f64>,
    #[pyo3(item)]
    search: Option<(f64, f64)>,
}

impl Settings {
    fn over(&self, usual: Options) -> PyResult<Options> {
        let degree = self.degree.unwrap_or(usual.degree);
        if !matches!(degree, 3 | 5 | 7) {
            let message = format!("degree is {degree}; expected 3, 5 or 7");
            return Err(PyValueError::new_err(message));
        }
        let low_pass_hz = self.low_pass_hz.unwrap_or(usual.low_pass_hz);
        if !(5.0..=100.0).contains(&low_pass_hz) {
            let message = format!("low_pass_hz is {low_pass_hz}; expected 5 to 100");
            return Err(PyValueError::new_err(message));
        }
        Ok(Options {
            low_pass_hz,
            degree,
            a_delay_s: self.a_delay,
            b_delay_s: self.b_delay,
            sigma_limit_s: self.sigma_limit.unwrap_or(usual.sigma_limit_s),
            min_overlap_s: self.min_overlap.unwrap_or(usual.min_overlap_s),
            handle_faults: self.handle_faults,
            wander: self.wander_ppm.map_or(usual.wander, Wander::from_ppm),
            search: self.search,
        })
    }
}

#[derive(IntoPyObject)]
struct ClockOut {
    reference: f64,
    offset: f64,
    skew: f64,
    covariance: [[f64; 2]; 2],
}

impl From<&ClockRelation> for ClockOut {
    fn from(clock: &ClockRelation) -> Self {
        Self {
            reference: clock.reference,
            offset: clock.offset,
            skew: clock.skew,
            covariance: clock.covariance,
        }
    }
}

#[derive(IntoPyObject)]
struct FaultOut {
    stream: &'static str,
    kind: String,
    count: usize,
    period: Option<f64>,
    displacement: Option<f64>,
    action: String,
    samples: Vec<usize>,
}

/// `CopiedSample` as `copied_sample`.
fn snake(name: impl std::fmt::Debug) -> String {
    let mut out = String::new();
    for letter in format!("{name:?}").chars() {
        if letter.is_uppercase() && !out.is_empty() {
            out.push('_');
        }
        out.extend(letter.to_lowercase());
    }
    out
}

impl From<&Fault> for FaultOut {
    fn from(fault: &Fault) -> Self {
        Self {
            stream: match fault.stream {
                twist_sync::Stream::A => "a",
                twist_sync::Stream::B => "b",
            },
            kind: snake(fault.kind),
            count: fault.count,
            period: fault.period,
            displacement: fault.displacement_s,
            action: snake(fault.action),
            samples: fault.samples.clone(),
        }
    }
}

#[derive(IntoPyObject)]
struct LeftOutOut {
    start: f64,
    end: f64,
    why: &'static str,
    text: String,
}

impl From<&LeftOut> for LeftOutOut {
    fn from(left_out: &LeftOut) -> Self {
        Self {
            start: left_out.from_s,
            end: left_out.to_s,
            why: match left_out.why {
                Why::Apart => "apart",
                Why::Slipped { .. } => "slipped",
                Why::TimeStep(_) => "time_step",
            },
            text: left_out.to_string(),
        }
    }
}

#[derive(IntoPyObject)]
struct GateOut {
    name: &'static str,
    passed: bool,
    value: f64,
    limit: f64,
    unit: &'static str,
    text: String,
}

impl From<&Gate> for GateOut {
    fn from(gate: &Gate) -> Self {
        Self {
            name: gate.name,
            passed: gate.passed,
            value: gate.value,
            limit: gate.limit,
            unit: gate.unit,
            text: gate.to_string(),
        }
    }
}

#[derive(IntoPyObject)]
struct ReportOut {
    residual_rms: Option<f64>,
    motion_rms: Option<f64>,
    overlap: Option<f64>,
    together: Vec<(f64, f64)>,
    faults: Vec<FaultOut>,
    left_out: Vec<LeftOutOut>,
    gates: Vec<GateOut>,
    warnings: Vec<String>,
}

impl From<&Report> for ReportOut {
    fn from(report: &Report) -> Self {
        Self {
            residual_rms: report.residual_rms,
            motion_rms: report.motion_rms,
            overlap: report.overlap_s,
            together: report.together.clone(),
            faults: report.faults.iter().map(FaultOut::from).collect(),
            left_out: report.left_out.iter().map(LeftOutOut::from).collect(),
            gates: report.gates.iter().map(GateOut::from).collect(),
            warnings: report.warnings.iter().map(ToString::to_string).collect(),
        }
    }
}

/// Clock, calibration and bias; none of them if it was refused.
type Found = Option<(ClockOut, [[f64; 3]; 3], [f64; 3])>;

/// What was found, the reasons of a refusal, and the report.
#[pyfunction]
fn estimate(
    py: Python<'_>,
    a: Stream<'_>,
    b: Stream<'_>,
    settings: Settings,
) -> PyResult<(Found, String, ReportOut)> {
    let (a, b) = (track(a)?, track(b)?);
    let options = settings.over(Options::default())?;
    Ok(match py.detach(|| estimate_offset(&a, &b, &options)) {
        Ok(e) => (
            Some((ClockOut::from(&e.clock), e.calibration, e.bias)),
            String::new(),
            ReportOut::from(&e.report),
        ),
        Err(refusal) => (
            None,
            refusal.report.failures(),
            ReportOut::from(&refusal.report),
        ),
    })
}

/// The relation over whole recordings.
#[pyclass(frozen)]
struct Course(RecordingClock);

#[pymethods]
impl Course {
    /// The relation at each of these times of clock a.
    fn at(&self, times: Vec<f64>) -> Vec<ClockOut> {
        let there = times.iter().map(|&t| self.0.course.at(t));
        there.map(|relation| ClockOut::from(&relation)).collect()
    }

    fn b_to_a(&self, times: Vec<f64>) -> Vec<f64> {
        times.iter().map(|&t| self.0.course.b_to_a(t)).collect()
    }

    fn span(&self) -> (f64, f64) {
        self.0.course.span()
    }

    fn windows(&self) -> usize {
        self.0.windows
    }

    fn used(&self) -> usize {
        self.0.course.used
    }

    fn contradicting(&self) -> usize {
        self.0.course.contradicting
    }

    fn estimates(&self) -> Vec<ClockOut> {
        self.0.estimates.iter().map(ClockOut::from).collect()
    }
}

/// The course, or the reason why there is none.
#[pyfunction]
fn course(
    py: Python<'_>,
    a: Stream<'_>,
    b: Stream<'_>,
    settings: Settings,
) -> PyResult<(Option<Course>, String)> {
    let (a, b) = (track(a)?, track(b)?);
    let options = settings.over(Options::of_windows())?;
    let prior = options
        .search
        .map(|(offset, width)| Prior::Offset(offset, width));
    let found = py.detach(|| course_of_tracks(&a, &b, prior, &options));
    Ok(match found {
        Ok(clock) => (Some(Course(clock)), String::new()),
        Err(error) => (None, error.to_string()),
    })
}

#[pymodule]
mod _twist_sync {
    #[pymodule_export]
    use super::{Course, course, estimate};
}
