//! Bindings of the crate for the Python package `twist-sync`. They pass plain arrays and tuples;
//! the classes with names and types are in `python/twist_sync/__init__.py`.
//!
//! Arrays are passed as little-endian bytes, so that the package is not built against a version
//! of numpy.

// A refusal carries its report; there is only one for each call.
#![allow(clippy::result_large_err)]

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use twist_sync::{
    ClockRelation, Fault, Gate, GyroTrack, LeftOut, Options, Prior, RecordingClock, Refusal,
    Report, Wander, Why, course_of_tracks, estimate_offset,
};

/// Times (f64 seconds, or i64 nanoseconds), rates of three axes (f64), true if the times are
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

/// Settings from Python; the crate's defaults replace those that are `None`.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Settings {
    low_pass_hz: Option<f64>,
    a_delay: f64,
    b_delay: f64,
    sigma_limit: Option<f64>,
    min_overlap: Option<f64>,
    handle_faults: bool,
    exact_stamps: bool,
    wander_ppm: Option<f64>,
    search: Option<(f64, f64)>,
}

impl Settings {
    fn applied_to(&self, defaults: Options) -> PyResult<Options> {
        let low_pass_hz = self.low_pass_hz.unwrap_or(defaults.low_pass_hz);
        if !(5.0..=100.0).contains(&low_pass_hz) {
            let message = format!("low_pass_hz is {low_pass_hz}; expected 5 to 100");
            return Err(PyValueError::new_err(message));
        }
        Ok(Options {
            low_pass_hz,
            a_delay_s: self.a_delay,
            b_delay_s: self.b_delay,
            sigma_limit_s: self.sigma_limit.unwrap_or(defaults.sigma_limit_s),
            min_overlap_s: self.min_overlap.unwrap_or(defaults.min_overlap_s),
            handle_faults: self.handle_faults,
            exact_stamps: self.exact_stamps,
            wander: self.wander_ppm.map_or(defaults.wander, Wander::from_ppm),
            search: self.search,
            ..defaults
        })
    }
}

// Results as tuples, in the order of the fields of the classes in Python.
type ClockOut = (f64, f64, f64, [[f64; 2]; 2]);
type FaultOut = (
    String,
    String,
    usize,
    Option<f64>,
    Option<f64>,
    String,
    Vec<usize>,
);
type LeftOutOut = (f64, f64, &'static str, String);
type GateOut = (&'static str, bool, f64, f64, &'static str, String);
type ReportOut = (
    Option<f64>,
    Option<f64>,
    Option<f64>,
    Vec<(f64, f64)>,
    Vec<FaultOut>,
    Vec<LeftOutOut>,
    Vec<GateOut>,
    Vec<String>,
);

fn clock_out(clock: &ClockRelation) -> ClockOut {
    (clock.reference, clock.offset, clock.skew, clock.covariance)
}

/// Converts the name of a variant to snake case: `CopiedSample` to `copied_sample`.
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

fn fault_out(fault: &Fault) -> FaultOut {
    (
        snake(fault.stream),
        snake(fault.kind),
        fault.count,
        fault.period,
        fault.displacement_s,
        snake(fault.action),
        fault.samples.clone(),
    )
}

fn left_out_out(left_out: &LeftOut) -> LeftOutOut {
    let why = match left_out.why {
        Why::Apart => "apart",
        Why::TimeStep(_) => "time_step",
    };
    (left_out.from_s, left_out.to_s, why, left_out.to_string())
}

fn gate_out(gate: &Gate) -> GateOut {
    let text = gate.to_string();
    (
        gate.kind.name(),
        gate.passed,
        gate.value,
        gate.limit,
        gate.kind.unit(),
        text,
    )
}

fn report_out(report: &Report) -> ReportOut {
    (
        report.residual_rms,
        report.motion_rms,
        report.overlap_s,
        report.together.clone(),
        report.faults.iter().map(fault_out).collect(),
        report.left_out.iter().map(left_out_out).collect(),
        report.gates.iter().map(gate_out).collect(),
        report.warnings.iter().map(ToString::to_string).collect(),
    )
}

/// Clock, calibration and bias; `None` if the estimate was refused.
type Found = Option<(ClockOut, [[f64; 3]; 3], [f64; 3])>;

/// Estimates the relation of one twist. Returns the result, the reasons of a refusal, and the
/// report.
#[pyfunction]
fn estimate(
    py: Python<'_>,
    a: Stream<'_>,
    b: Stream<'_>,
    settings: Settings,
) -> PyResult<(Found, String, ReportOut)> {
    let (a, b) = (track(a)?, track(b)?);
    let options = settings.applied_to(Options::default())?;
    Ok(match py.detach(|| estimate_offset(&a, &b, &options)) {
        Ok(e) => {
            let found = (clock_out(&e.clock), e.calibration, e.bias);
            (Some(found), String::new(), report_out(&e.report))
        }
        Err(Refusal { report }) => (None, report.failures(), report_out(&report)),
    })
}

/// The relation over whole recordings.
#[pyclass(frozen)]
struct Course(RecordingClock);

#[pymethods]
impl Course {
    /// Returns offset, skew and the three numbers of their covariance at each of these times of
    /// clock a: an array of shape (n, 5).
    fn at<'py>(&self, py: Python<'py>, times: &[u8]) -> Bound<'py, PyBytes> {
        let out: Vec<u8> = py.detach(|| {
            let there = words(times).flat_map(|t| {
                let relation = self.0.course.at(f64::from_le_bytes(t));
                let [[oo, os], [_, ss]] = relation.covariance;
                [relation.offset, relation.skew, oo, os, ss]
            });
            there.flat_map(f64::to_le_bytes).collect()
        });
        PyBytes::new(py, &out)
    }

    /// Converts times of clock b to clock a.
    fn b_to_a<'py>(&self, py: Python<'py>, times: &[u8]) -> Bound<'py, PyBytes> {
        let out: Vec<u8> = py.detach(|| {
            let times = words(times).map(f64::from_le_bytes);
            times
                .flat_map(|t| self.0.course.b_to_a(t).to_le_bytes())
                .collect()
        });
        PyBytes::new(py, &out)
    }

    /// Returns everything else, in the order of the fields of the class in Python.
    fn details(&self) -> Details {
        let Self(RecordingClock { course, .. }) = self;
        let steps = course.steps.iter();
        let unsupported = course.unsupported.iter();
        let refused = self.0.refused.iter();
        let warnings = self.0.warnings.iter();
        (
            self.0.estimates.iter().map(clock_out).collect(),
            (self.0.windows, course.used, course.contradicting),
            refused
                .map(|own| (gate_out(&own.gate), own.count))
                .collect(),
            steps
                .map(|step| (step.from_s, step.to_s, step.by.value, step.by.sigma))
                .collect(),
            unsupported.map(|own| (own.from_s, own.to_s)).collect(),
            warnings
                .map(|(own, count)| (own.to_string(), *count))
                .collect(),
            course.span(),
        )
    }
}

/// Estimates; numbers of windows, of those used and of those that contradict; refusals; steps;
/// stretches that are not supported; warnings; first and last time.
type Details = (
    Vec<ClockOut>,
    (usize, usize, usize),
    Vec<(GateOut, usize)>,
    Vec<(f64, f64, f64, f64)>,
    Vec<(f64, f64)>,
    Vec<(String, usize)>,
    (f64, f64),
);

/// Estimates the relation over whole recordings. Returns the course, or `None` and the reason.
#[pyfunction]
fn course(
    py: Python<'_>,
    a: Stream<'_>,
    b: Stream<'_>,
    settings: Settings,
) -> PyResult<(Option<Course>, String)> {
    let (a, b) = (track(a)?, track(b)?);
    let options = settings.applied_to(Options::for_windows())?;
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

    /// The package's version.
    #[pymodule_export]
    #[allow(non_upper_case_globals)]
    const version: &str = env!("CARGO_PKG_VERSION");
}
