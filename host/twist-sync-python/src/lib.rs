//! The Python package `twist-sync`: arrays in, numbers out. Everything with a name and a type
//! is in `python/twist_sync/__init__.py`; this is the way between it and the crate.
//!
//! Arrays come as bytes, little-endian, so that no version of numpy is built against.

// A refusal carries its report, and there is one a call.
#![allow(clippy::result_large_err)]

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
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
#[pyo3(from_item_all)]
struct Settings {
    low_pass_hz: Option<f64>,
    a_delay: f64,
    b_delay: f64,
    sigma_limit: Option<f64>,
    min_overlap: Option<f64>,
    handle_faults: bool,
    wander_ppm: Option<f64>,
    search: Option<(f64, f64)>,
}

impl Settings {
    fn over(&self, usual: Options) -> PyResult<Options> {
        let low_pass_hz = self.low_pass_hz.unwrap_or(usual.low_pass_hz);
        if !(5.0..=100.0).contains(&low_pass_hz) {
            let message = format!("low_pass_hz is {low_pass_hz}; expected 5 to 100");
            return Err(PyValueError::new_err(message));
        }
        Ok(Options {
            low_pass_hz,
            a_delay_s: self.a_delay,
            b_delay_s: self.b_delay,
            sigma_limit_s: self.sigma_limit.unwrap_or(usual.sigma_limit_s),
            min_overlap_s: self.min_overlap.unwrap_or(usual.min_overlap_s),
            handle_faults: self.handle_faults,
            wander: self.wander_ppm.map_or(usual.wander, Wander::from_ppm),
            search: self.search,
            ..usual
        })
    }
}

type Dict<'py> = Bound<'py, PyDict>;

fn clock_out<'py>(py: Python<'py>, clock: &ClockRelation) -> PyResult<Dict<'py>> {
    let out = PyDict::new(py);
    out.set_item("reference", clock.reference)?;
    out.set_item("offset", clock.offset)?;
    out.set_item("skew", clock.skew)?;
    out.set_item("covariance", clock.covariance)?;
    Ok(out)
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

fn fault_out<'py>(py: Python<'py>, fault: &Fault) -> PyResult<Dict<'py>> {
    let out = PyDict::new(py);
    out.set_item("stream", snake(fault.stream))?;
    out.set_item("kind", snake(fault.kind))?;
    out.set_item("count", fault.count)?;
    out.set_item("period", fault.period)?;
    out.set_item("displacement", fault.displacement_s)?;
    out.set_item("action", snake(fault.action))?;
    out.set_item("samples", &fault.samples)?;
    Ok(out)
}

fn left_out_out<'py>(py: Python<'py>, left_out: &LeftOut) -> PyResult<Dict<'py>> {
    let out = PyDict::new(py);
    let why = match left_out.why {
        Why::Apart => "apart",
        Why::Slipped { .. } => "slipped",
        Why::TimeStep(_) => "time_step",
    };
    out.set_item("start", left_out.from_s)?;
    out.set_item("end", left_out.to_s)?;
    out.set_item("why", why)?;
    out.set_item("text", left_out.to_string())?;
    Ok(out)
}

fn gate_out<'py>(py: Python<'py>, gate: &Gate) -> PyResult<Dict<'py>> {
    let out = PyDict::new(py);
    out.set_item("name", gate.name)?;
    out.set_item("passed", gate.passed)?;
    out.set_item("value", gate.value)?;
    out.set_item("limit", gate.limit)?;
    out.set_item("unit", gate.unit)?;
    out.set_item("text", gate.to_string())?;
    Ok(out)
}

fn report_out<'py>(py: Python<'py>, report: &Report) -> PyResult<Dict<'py>> {
    let faults = report.faults.iter().map(|fault| fault_out(py, fault));
    let left_out = report.left_out.iter().map(|part| left_out_out(py, part));
    let gates = report.gates.iter().map(|gate| gate_out(py, gate));
    let warnings: Vec<String> = report.warnings.iter().map(ToString::to_string).collect();
    let out = PyDict::new(py);
    out.set_item("residual_rms", report.residual_rms)?;
    out.set_item("motion_rms", report.motion_rms)?;
    out.set_item("overlap", report.overlap_s)?;
    out.set_item("together", &report.together)?;
    out.set_item("faults", faults.collect::<PyResult<Vec<_>>>()?)?;
    out.set_item("left_out", left_out.collect::<PyResult<Vec<_>>>()?)?;
    out.set_item("gates", gates.collect::<PyResult<Vec<_>>>()?)?;
    out.set_item("warnings", warnings)?;
    Ok(out)
}

/// Clock, calibration and bias; none of them if it was refused.
type Found<'py> = Option<(Dict<'py>, [[f64; 3]; 3], [f64; 3])>;

/// What was found, the reasons of a refusal, and the report.
#[pyfunction]
fn estimate<'py>(
    py: Python<'py>,
    a: Stream<'_>,
    b: Stream<'_>,
    settings: Settings,
) -> PyResult<(Found<'py>, String, Dict<'py>)> {
    let (a, b) = (track(a)?, track(b)?);
    let options = settings.over(Options::default())?;
    Ok(match py.detach(|| estimate_offset(&a, &b, &options)) {
        Ok(e) => (
            Some((clock_out(py, &e.clock)?, e.calibration, e.bias)),
            String::new(),
            report_out(py, &e.report)?,
        ),
        Err(refusal) => (
            None,
            refusal.report.failures(),
            report_out(py, &refusal.report)?,
        ),
    })
}

/// The relation over whole recordings.
#[pyclass(frozen)]
struct Course(RecordingClock);

#[pymethods]
impl Course {
    /// Offset, skew and the three numbers of their covariance at each of these times of
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

    /// Times of clock a at times of clock b.
    fn b_to_a<'py>(&self, py: Python<'py>, times: &[u8]) -> Bound<'py, PyBytes> {
        let out: Vec<u8> = py.detach(|| {
            let times = words(times).map(f64::from_le_bytes);
            times
                .flat_map(|t| self.0.course.b_to_a(t).to_le_bytes())
                .collect()
        });
        PyBytes::new(py, &out)
    }

    /// Steps of one clock against the other: from, to, by and its 1-sigma.
    fn steps(&self) -> Vec<(f64, f64, f64, f64)> {
        let steps = self.0.course.steps.iter();
        steps
            .map(|step| (step.from_s, step.to_s, step.by.value, step.by.sigma))
            .collect()
    }

    fn unsupported(&self) -> Vec<(f64, f64)> {
        let stretches = self.0.course.unsupported.iter();
        stretches.map(|own| (own.from_s, own.to_s)).collect()
    }

    /// Gates that refused windows, with the number of windows.
    fn refusals<'py>(&self, py: Python<'py>) -> PyResult<Vec<(Dict<'py>, usize)>> {
        let refused = self.0.refused.iter();
        refused
            .map(|windows| Ok((gate_out(py, &windows.gate)?, windows.count)))
            .collect()
    }

    fn warnings(&self) -> Vec<(String, usize)> {
        let warnings = self.0.warnings.iter();
        warnings
            .map(|(warning, count)| (warning.to_string(), *count))
            .collect()
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

    fn estimates<'py>(&self, py: Python<'py>) -> PyResult<Vec<Dict<'py>>> {
        let estimates = self.0.estimates.iter();
        estimates.map(|clock| clock_out(py, clock)).collect()
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

    /// The package's version.
    #[pymodule_export]
    #[allow(non_upper_case_globals)]
    const version: &str = env!("CARGO_PKG_VERSION");
}
