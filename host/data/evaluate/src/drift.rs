//! Drift: the line of the train's position over the time of a long recording.

use std::path::PathBuf;

use serde::Serialize;
use twist_sync::robust::mad_sigma;

use crate::footage::Footage;
use crate::shown::Shown;
use crate::stats::{COVERAGE_99, Line, median};
use crate::track::window::still;
use crate::track::{Choice, FrameCounts, FramePoint, Identity, Reference, evidence, track};
use crate::{EvaluateError, Settings};

/// Least number of frames for a regression.
pub(crate) const MIN_FRAMES: usize = 10;
/// Frames over which errors may be correlated: two seconds, two key frames.
const FRAME_LAG: usize = 64;
/// Distance from the line beyond which a frame is an outlier, in robust standard deviations.
const OUTLIER: f64 = 6.0;
/// Rounds in which outliers are removed.
const OUTLIER_ROUNDS: usize = 4;

/// Factor of the stated uncertainty of an encoded video over that of its residuals. Simulated
/// videos of the whole rig scatter by 1.4 times that (29 seeds). See [`crate::precision`].
const ENCODED: f64 = 1.5;

/// Result of a long recording.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Drift {
    /// Video that was measured.
    pub path: PathBuf,
    /// Drift of depth minus phone, µs/min; positive: the depth camera becomes later.
    pub drift_us_per_min: f64,
    /// Standard uncertainty of the drift, µs/min.
    pub drift_sigma_us_per_min: f64,
    /// Half width of the drift's 99 % interval, µs/min.
    pub drift_uncertainty_99_us_per_min: f64,
    /// Bias of the line in the middle of the used frames, µs; null if the assignment of flashes
    /// is ambiguous.
    pub bias_us: Option<f64>,
    /// Bias of the line at the first used frame, µs; null as above.
    pub bias_at_start_us: Option<f64>,
    /// Bias of the line at the last used frame, µs; null as above.
    pub bias_at_end_us: Option<f64>,
    /// Seconds from the first to the last used frame.
    pub span_s: f64,
    /// Begin and end, in seconds of the recording, of the window that was found automatically;
    /// null if the user chose one, or all frames are used. Outside of it the train does not move
    /// by its drift alone.
    pub window_s: Option<[f64; 2]>,
    /// Standard deviation of the frames about the line, µs.
    pub residual_sd_us: f64,
    /// Row time, µs.
    pub row_time_us: f64,
    /// Standard uncertainty of the row time, µs.
    pub row_time_sigma_us: f64,
    /// Exposure that fits the flashes, µs.
    pub exposure_us: f64,
    /// Number of frames that were left out because they are far from the line.
    pub outliers: usize,
    /// Assignment of flashes to bands.
    pub identity: Identity,
    /// Counts of the frames.
    pub frames: FrameCounts,
    /// Source of the scene's brightness without flashes.
    pub reference: Reference,
    /// Remarks for the user.
    pub notes: Vec<String>,
}

/// Result of a long recording, with the data that a report draws.
#[derive(Debug, Clone)]
pub struct EvaluatedDrift {
    /// The result.
    pub result: Drift,
    /// Time in seconds and bias in µs of the used frames.
    pub points: Vec<(f64, f64)>,
    /// Bias of the line at the first and at the last of them, µs, for the chosen assignment of
    /// flashes.
    pub line_us: [f64; 2],
    /// Profiles and a frame for the report.
    pub shown: Shown,
}

/// Measures the drift over all frames of a recording.
///
/// # Errors
///
/// Fails without flashes, with too few frames, or if nothing shows that the bands are flashes of
/// a camera in step with the phone.
pub fn evaluate(footage: Footage, settings: &Settings) -> Result<EvaluatedDrift, EvaluateError> {
    let settings = &settings.with_session(&footage);
    let mut seen = track(&footage, settings, Choice::All)?;
    let chosen = settings.from_s.is_some() || settings.to_s.is_some();
    let window = if chosen { None } else { still(&seen.points) };
    let window = window.and_then(|window| seen.points.get(window));
    let window_s = window.and_then(|used| Some([used.first()?.time_s, used.last()?.time_s]));
    if let Some([from, to]) = window_s {
        // A train that moves by a pitch between two frames is lost, so the flashes are assigned
        // by the used frames alone.
        seen = track(&footage, settings, Choice::Within(from, to))?;
    }
    let track = seen;
    let points = track.points.clone();
    let all = points.len();
    let too_few = |found| EvaluateError::TooFewFrames {
        path: footage.path.clone(),
        found,
    };
    let (line, points) = regression(points).map_err(too_few)?;
    let (first, last) = match (points.first(), points.last()) {
        (Some(a), Some(b)) => (a.time_s, b.time_s),
        _ => return Err(too_few(0)),
    };

    let evidence = track.evidence_or_earlier(&footage, settings);
    if let Some(doubt) = evidence::doubt(evidence, &footage, settings) {
        return Err(doubt);
    }
    evidence::in_step(&line, &footage, settings)?;

    let mut notes = footage.notes.clone();
    notes.extend(track.notes.iter().cloned());
    let typical = median(&points.iter().map(|p| p.sigma_us).collect::<Vec<_>>());
    if line.residual_sd > 20.0 * typical.max(0.05) {
        notes.push(format!(
            "the frames lie {:.1} µs off the line, each is known to {typical:.2} µs: the train did not move evenly (was the trigger aligned, or the period changed, during this time? choose it with --from and --to)",
            line.residual_sd
        ));
    }
    let outliers = all - points.len();
    if outliers * 10 > all {
        notes.push(format!(
            "{outliers} of {all} frames lie far off the line and were left out of it"
        ));
    }
    let per_minute = |v: f64| 60.0 * v;
    let allowance = if footage.encoded { ENCODED } else { 1.0 };
    let slope_sigma = allowance * line.slope_sigma;
    let bias_at = |at| track.identity.unique.then(|| line.at(at));
    let result = Drift {
        path: footage.path.clone(),
        drift_us_per_min: per_minute(line.slope),
        drift_sigma_us_per_min: per_minute(slope_sigma),
        drift_uncertainty_99_us_per_min: per_minute(COVERAGE_99 * slope_sigma),
        bias_us: bias_at(0.5 * (first + last)),
        bias_at_start_us: bias_at(first),
        bias_at_end_us: bias_at(last),
        span_s: last - first,
        window_s,
        residual_sd_us: line.residual_sd,
        row_time_us: track.joint.row_time_us,
        row_time_sigma_us: track.joint.row_time_sigma_us,
        exposure_us: track.joint.exposure_us,
        outliers,
        identity: track.identity.clone(),
        frames: track.counts,
        reference: track.reference,
        notes,
    };
    Ok(EvaluatedDrift {
        result,
        points: points.iter().map(|p| (p.time_s, p.bias_us)).collect(),
        line_us: [first, last].map(|at| line.at(at)),
        shown: Shown::new(&footage, &track, settings),
    })
}

/// Fits the line through the frames without outliers. Fails with the number of frames if there
/// are too few.
fn regression(mut points: Vec<FramePoint>) -> Result<(Line, Vec<FramePoint>), usize> {
    for round in 0.. {
        let places: Vec<(f64, f64)> = points.iter().map(|p| (p.time_s, p.bias_us)).collect();
        let line = Line::fit(&places, FRAME_LAG.min(points.len() / 6))
            .filter(|_| points.len() >= MIN_FRAMES)
            .ok_or(points.len())?;
        let off = |p: &FramePoint| p.bias_us - line.at(p.time_s);
        let residuals: Vec<f64> = points.iter().map(off).collect();
        let scatter = mad_sigma(residuals.clone()).unwrap_or(0.0);
        let limit = OUTLIER * scatter.max(0.02);
        if round == OUTLIER_ROUNDS || residuals.iter().all(|r| r.abs() <= limit) {
            return Ok((line, points));
        }
        points.retain(|p| off(p).abs() <= limit);
    }
    Err(points.len())
}
