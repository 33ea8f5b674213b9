//! Sessions on rigs of which other things may be true than what its models have, from the twist
//! to the data set: phase, drift and clocks against what the session states of them, the
//! times of the data set against what `extract` states.

use std::path::Path;

use anyhow::{Context, Result};
use clock::BoardSeconds;

use super::{Plan, evaluation, extraction, record};
use crate::programs::Programs;
use crate::study::{Figure, Specimen};

/// Makes a recording of this length on a rig of the study.
#[must_use]
pub fn plan(rig: &Specimen, seconds: u32) -> Plan {
    let name = format!("{} {}", rig.seed, rig.kind);
    Plan {
        values: rig.values,
        // A folder: no unit may divide it.
        name: name.replace('/', " per "),
        ..Plan::new(rig.seed, seconds)
    }
}

/// Makes the recording, extracts and evaluates it, and compares.
///
/// # Errors
///
/// A step fails, or what is exact on any rig is not: a frame has a wrong pulse, a pair is
/// wrong, a dropped frame is not named.
pub fn figures(plan: &Plan, programs: &Programs, out: &Path) -> Result<Vec<Figure>> {
    let (_, phone) = plan.parts();
    let recorded = record(plan, programs, out)?;
    let extraction = extraction::extracted(&recorded, programs)?;
    let verdict = recorded.truth.judge(&recorded.folder)?;
    let session = &recorded.session;
    let alignment = session.alignment.as_ref().context("it was not aligned")?;
    let span = session.recorded.context("nothing was recorded")?;
    let start = BoardSeconds(span.from.as_secs_f64());
    // Errors of the line through the true points: of its start, and of its slope.
    let phase = &verdict.phase;
    let of_mean = phase.mean_sigma_us();
    let of_slope = 12.0_f64.sqrt() * of_mean * 60.0 / verdict.recorded_s;
    let jitter_us = phone.camera.timestamp_jitter_ns * 1e-3;
    let figure = |name: &str, error, sigma| Figure {
        name: name.to_owned(),
        error,
        sigma,
    };
    let mut figures = vec![
        figure(
            "phase at the start (µs)",
            phase.start_us,
            Some(alignment.plan.phase_sigma_us_at(start).hypot(2.0 * of_mean)),
        ),
        figure(
            "drift (µs/min)",
            phase.drift_us_per_min,
            Some(alignment.drift_sigma_us_per_min.hypot(of_slope)),
        ),
        figure(
            "clock offset (µs)",
            verdict.offset_start.error_us,
            Some(verdict.offset_start.sigma_us),
        ),
        // The jitter of a timestamp cannot be separated from the rest.
        figure(
            "phone's times in the data set, rms (µs)",
            extraction.phone_middle.rms_us,
            Some(extraction.phone_sigma_us.hypot(jitter_us)),
        ),
        figure(
            "depth times in the data set, rms (µs)",
            extraction.depth.rms_us,
            None,
        ),
    ];
    // A video that cannot be evaluated says so, and the session's figures stay.
    match evaluation::evaluated(&recorded, programs) {
        Ok(found) => figures.extend([
            figure(
                "bias as measured (µs)",
                found.bias.error(),
                Some(found.bias.sigma),
            ),
            figure(
                "drift as measured (µs/min)",
                found.drift.error(),
                Some(found.drift.sigma),
            ),
        ]),
        Err(error) => eprintln!("{}: {error:#}", plan.name),
    }
    Ok(figures)
}
