//! Bias of each recording, and its statistics over recordings.

use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::footage::Footage;
use crate::shown::Shown;
use crate::stats::{COVERAGE_99, Line, mean, quantile, standard_deviation};
use crate::track::{Choice, Evidence, FrameCounts, Identity, Reference, Track, evidence, track};
use crate::train::TrainGeometry;
use crate::{EvaluateError, Settings};

/// Motion of the train within a recording's frames above which there is a note, µs.
const NOTABLE_MOTION_US: f64 = 20.0;

/// Factor of the stated uncertainty of an encoded video over that of its residuals.
///
/// An encoder's errors follow the picture: a part of them looks like a shift of the
/// flashes' edges, which the fit follows and which leaves no residual.
/// Simulated videos (x264 at constant quality 18) scatter by 1.7 times the uncertainty of
/// their residuals, over 29 seeds of the whole rig.
const ENCODED: f64 = 2.0;

/// Result of one recording.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecordingResult {
    /// Video that was measured.
    pub path: PathBuf,
    /// Width of the image, pixels.
    pub width: usize,
    /// Height of the image, pixels.
    pub height: usize,
    /// Bias that the session of the recording subtracted, µs.
    pub applied_bias_us: Option<f64>,
    /// Part of that by which the trigger was shifted on purpose, µs.
    pub shift_us: f64,
    /// 1-sigma of the clocks by the session of the recording, µs; 0 without one.
    pub clocks_sigma_us: f64,
    /// Bias from perfect sync, µs; positive: the depth camera is exposed later.
    pub bias_us: f64,
    /// Standard uncertainty of the bias, µs.
    pub sigma_us: f64,
    /// Half width of the 99 % interval, µs.
    pub uncertainty_99_us: f64,
    /// Row, counted from 0, on which the centre of the train falls.
    pub row: f64,
    /// Row time, µs.
    pub row_time_us: f64,
    /// Standard uncertainty of the row time, µs.
    pub row_time_sigma_us: f64,
    /// Exposure that fits the flashes, µs.
    pub exposure_us: f64,
    /// Standard uncertainty of the exposure, µs.
    pub exposure_sigma_us: f64,
    /// Grey levels that a whole flash adds.
    pub amplitude: f64,
    /// Standard deviation between the frames, µs; null with one frame.
    pub frame_sd_us: Option<f64>,
    /// Assignment of flashes to bands.
    pub identity: Identity,
    /// Evidence that the bands are flashes; results without evidence are left out.
    pub evidence: Option<Evidence>,
    /// Counts of the frames.
    pub frames: FrameCounts,
    /// Source of the scene's brightness without flashes.
    pub reference: Reference,
    /// Remarks for the user.
    pub notes: Vec<String>,
}

/// A recording that gave no result.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct FailedRecording {
    /// Input that was given.
    pub path: PathBuf,
    /// Reason why there is no result.
    pub reason: String,
}

impl RecordingResult {
    /// Returns the bias without the intended shift, µs.
    #[must_use]
    pub fn unshifted_us(&self) -> f64 {
        self.bias_us + self.shift_us
    }
}

/// Statistics of the bias over recordings.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct BiasStatistics {
    /// Number of recordings.
    pub count: usize,
    /// Mean, µs.
    pub mean_us: f64,
    /// Standard uncertainty of the mean, µs.
    pub mean_sigma_us: f64,
    /// Median, µs.
    pub median_us: f64,
    /// Standard deviation over recordings, µs; null for a single one.
    pub sd_us: Option<f64>,
    /// Standard uncertainty of the standard deviation, µs.
    pub sd_sigma_us: Option<f64>,
    /// Interquartile range over recordings, µs; null for a single one.
    pub iqr_us: Option<f64>,
    /// Standard uncertainty of the interquartile range, µs.
    pub iqr_sigma_us: Option<f64>,
}

impl BiasStatistics {
    /// Computes the statistics of values with their own standard uncertainties, all in µs;
    /// `None` without values.
    ///
    /// The uncertainties of standard deviation and interquartile range are those
    /// of normally distributed launches, SD/√(2(n-1)) and 1.573·SD/√n.
    pub fn from_values(values: &[f64], sigmas: &[f64]) -> Option<Self> {
        let n = values.len();
        let median_us = quantile(values, 0.5)?;
        let sd = standard_deviation(values);
        // The uncertainty of each value, and the scatter between launches.
        let own = sigmas.iter().map(|s| s * s).sum::<f64>().sqrt() / n as f64;
        let between = sd.map_or(0.0, |sd| sd / (n as f64).sqrt());
        let iqr = sd.and_then(|_| Some(quantile(values, 0.75)? - quantile(values, 0.25)?));
        Some(Self {
            count: n,
            mean_us: mean(values),
            mean_sigma_us: own.max(between),
            median_us,
            sd_us: sd,
            sd_sigma_us: sd.map(|sd| sd / (2.0 * (n as f64 - 1.0)).sqrt()),
            iqr_us: iqr,
            iqr_sigma_us: sd.map(|sd| 1.573 * sd / (n as f64).sqrt()),
        })
    }
}

/// Results over all recordings.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Precision {
    /// Results of the recordings.
    pub recordings: Vec<RecordingResult>,
    /// Inputs without a result.
    pub left_out: Vec<FailedRecording>,
    /// Statistics of the bias over recordings, without intended shifts; null without any result.
    pub bias: Option<BiasStatistics>,
    /// Weighted mean of the row time over recordings, µs.
    pub row_time_us: f64,
    /// Standard uncertainty of the row time, µs.
    pub row_time_sigma_us: f64,
}

/// Callback after each input, with its path and its result, or the reason why there is none.
pub type Progress<'a> = dyn FnMut(&Path, &Result<RecordingResult, String>) + 'a;

/// Result of one recording, with the data that a report draws.
#[derive(Debug, Clone)]
pub struct Evaluated {
    /// The result.
    pub result: RecordingResult,
    /// Profiles and a frame for the report.
    pub shown: Shown,
}

/// Measures one recording from its last `frames` frames with flashes.
///
/// # Errors
///
/// Fails without flashes, if they are not in step with the phone, or if nothing shows that the
/// bands are flashes.
pub fn evaluate_recording(
    footage: Footage,
    settings: &Settings,
    frames: usize,
) -> Result<Evaluated, EvaluateError> {
    let (evaluated, doubt) = measure(footage, settings, frames)?;
    doubt.map_or(Ok(evaluated), Err)
}

/// Measures one recording. If nothing in it shows that the bands are flashes, the error for that
/// is returned beside the result.
fn measure(
    footage: Footage,
    settings: &Settings,
    frames: usize,
) -> Result<(Evaluated, Option<EvaluateError>), EvaluateError> {
    let settings = &settings.with_session(&footage);
    let (footage, track) = settled(footage, settings, frames.max(1))?;
    let biases: Vec<f64> = track.points.iter().map(|p| p.bias_us).collect();
    let places: Vec<(f64, f64)> = track.points.iter().map(|p| (p.time_s, p.bias_us)).collect();
    let line = Line::fit(&places, 1);
    let evidence = track.evidence_or_earlier(&footage, settings);
    if let Some(line) = &line {
        evidence::in_step(line, &footage, settings)?;
    }
    let scatter = line.map_or(0.0, |l| l.residual_sd / (biases.len() as f64).sqrt());
    let allowance = if footage.encoded { ENCODED } else { 1.0 };
    let sigma_us = allowance * track.joint.mean_sigma_us.max(scatter);
    let mut notes = footage.notes.clone();
    notes.extend(track.notes.iter().cloned());
    let low = biases.iter().copied().fold(f64::MAX, f64::min);
    let high = biases.iter().copied().fold(f64::MIN, f64::max);
    if high - low > NOTABLE_MOTION_US {
        notes.push(format!(
            "the train moved by {:.0} µs within the {} frames used: the cameras are not in step, or the trigger was still being aligned (choose the time with --from and --to)",
            high - low,
            biases.len()
        ));
    }
    let middle = footage.middle_row;
    let amplitudes: Vec<f64> = track.points.iter().map(|p| p.amplitude).collect();
    let joint = &track.joint;
    let result = RecordingResult {
        path: footage.path.clone(),
        width: footage.reducer.width,
        height: footage.reducer.height,
        applied_bias_us: footage.applied.map(|a| a.bias_us),
        shift_us: footage.applied.map_or(0.0, |a| a.shift_us),
        clocks_sigma_us: footage.applied.map_or(0.0, |a| a.clocks_sigma_us),
        bias_us: joint.mean_us,
        sigma_us,
        uncertainty_99_us: COVERAGE_99 * sigma_us,
        row: middle + (joint.mean_us + settings.path_delay_us) / joint.row_time_us,
        row_time_us: joint.row_time_us,
        row_time_sigma_us: joint.row_time_sigma_us,
        exposure_us: joint.exposure_us,
        exposure_sigma_us: joint.exposure_sigma_us,
        amplitude: mean(&amplitudes),
        frame_sd_us: standard_deviation(&biases),
        identity: track.identity.clone(),
        evidence,
        frames: track.counts,
        reference: track.reference,
        notes,
    };
    let rows = footage.reducer.sensor_rows();
    let known = settings.known_readout.and_then(|known| {
        known.contradicts(joint.row_time_us, joint.row_time_sigma_us * allowance, rows)
    });
    if let Some((expected_us, expected_sigma_us)) = known {
        return Err(EvaluateError::RowTime {
            path: footage.path,
            found_us: joint.row_time_us,
            expected_us,
            expected_sigma_us,
        });
    }
    let doubt = evidence::doubt(evidence, &footage, settings);
    let evaluated = Evaluated {
        result,
        shown: Shown::new(&footage, &track, settings),
    };
    Ok((evaluated, doubt))
}

/// Finds the train in the last `frames` frames with flashes.
///
/// While the trigger is still being aligned the train runs through the picture,
/// and row time and exposure from that part may be wrong: then most frames seem to
/// have another room light than the rest. In this case the first half is left out,
/// at most twice.
fn settled(
    mut footage: Footage,
    settings: &Settings,
    frames: usize,
) -> Result<(Footage, Track), EvaluateError> {
    let doubtful = |track: &Track| {
        let counts = &track.counts;
        counts.flicker > counts.used + counts.spare
    };
    let mut found = track(&footage, settings, Choice::Last(frames))?;
    let evidence = found.evidence;
    let mut left_out = 0;
    for _ in 0..2 {
        let half = footage.frames.len() / 2;
        if !doubtful(&found) || half < frames {
            break;
        }
        let late = footage.frames.split_off(half);
        let early = std::mem::replace(&mut footage.frames, late);
        match track(&footage, settings, Choice::Last(frames)) {
            Ok(track) => {
                found = track;
                left_out += half;
            }
            Err(_) => {
                let late = std::mem::replace(&mut footage.frames, early);
                footage.frames.extend(late);
                break;
            }
        }
    }
    if left_out > 0 {
        footage.notes.push(format!(
            "the first {left_out} frames were left out: they do not fit the later ones"
        ));
    }
    // All frames count as evidence, including those in which the train was still moved.
    found.evidence = found.evidence.or(evidence);
    Ok((footage, found))
}

/// Measures recordings of one camera, one after the other; only one is in memory at a time.
///
/// Inputs that give no result are left out with the reason. `each` is called after each input.
/// Returns the results and, for the pictures, the first recording that gave one.
///
/// # Errors
///
/// Fails if the settings are wrong, for errors that concern all recordings, and if the only input
/// gives no result.
pub fn evaluate(
    inputs: &[PathBuf],
    settings: &Settings,
    frames: usize,
    each: &mut Progress<'_>,
) -> Result<(Precision, Option<Evaluated>), EvaluateError> {
    settings.check()?;
    let mut measured: Vec<(Evaluated, Option<EvaluateError>)> = Vec::new();
    let mut left_out = Vec::new();
    for path in inputs {
        let proven = measured.iter().find(|(_, doubt)| doubt.is_none());
        // The recordings are of one camera.
        let settings = &Settings {
            row_time_hint_us: proven.map(|(first, _)| first.result.row_time_us),
            ..settings.clone()
        };
        let expected = measured
            .first()
            .map(|(m, _)| (m.result.width, m.result.height));
        let found = Footage::read(path, settings, expected)
            .and_then(|footage| measure(footage, settings, frames));
        match found {
            Ok((evaluated, doubt)) => {
                if doubt.is_none() {
                    each(path, &Ok(evaluated.result.clone()));
                }
                measured.push((evaluated, doubt));
            }
            Err(error) if inputs.len() == 1 || concerns_all(&error) => return Err(error),
            Err(error) => leave_out(path, &error, each, &mut left_out),
        }
    }
    compare(&mut measured, &settings.train);
    let (mut results, mut shown) = (Vec::new(), None);
    for (evaluated, doubt) in measured {
        let path = evaluated.result.path.clone();
        match doubt {
            Some(error) if inputs.len() == 1 => return Err(error),
            Some(error) => leave_out(&path, &error, each, &mut left_out),
            None => {
                if evaluated.result.evidence == Some(Evidence::Shift) {
                    each(&path, &Ok(evaluated.result.clone()));
                }
                results.push(evaluated.result.clone());
                shown.get_or_insert(evaluated);
            }
        }
    }
    Ok((summarise(results, left_out), shown))
}

/// Clears the doubt about recordings if the trigger was moved between two of them and their
/// bands moved by as much.
fn compare(measured: &mut [(Evaluated, Option<EvaluateError>)], train: &TrainGeometry) {
    let places: Vec<(f64, f64, f64)> = measured
        .iter()
        .map(|(m, _)| &m.result)
        .map(|r| (r.applied_bias_us.unwrap_or(f64::NAN), r.bias_us, r.sigma_us))
        .collect();
    let off = |us| evidence::off_pitch(us, train.pitch_us);
    for ((evaluated, doubt), &(applied, bias, sigma)) in measured.iter_mut().zip(&places) {
        let moved_with = |&(other_applied, other_bias, other_sigma): &(f64, f64, f64)| {
            let shift = applied - other_applied;
            let unlike = off(bias - other_bias + shift);
            off(shift).abs() > evidence::MOVED * train.pitch_us
                && unlike.abs()
                    < 0.25 * evidence::MOVED * train.pitch_us + 4.0 * sigma.hypot(other_sigma)
        };
        if doubt.is_some() && places.iter().any(moved_with) {
            evaluated.result.evidence = Some(Evidence::Shift);
            *doubt = None;
        }
    }
}

fn leave_out(
    path: &Path,
    error: &EvaluateError,
    each: &mut Progress<'_>,
    left_out: &mut Vec<FailedRecording>,
) {
    let reason = error.to_string();
    each(path, &Err(reason.clone()));
    left_out.push(FailedRecording {
        path: path.to_owned(),
        reason,
    });
}

fn concerns_all(error: &EvaluateError) -> bool {
    matches!(
        error,
        EvaluateError::Ffmpeg(_)
            | EvaluateError::Setting(_)
            | EvaluateError::RegionOutside { .. }
            | EvaluateError::TooFewRows { .. }
    )
}

/// Combines the recordings' results.
fn summarise(recordings: Vec<RecordingResult>, left_out: Vec<FailedRecording>) -> Precision {
    let values: Vec<f64> = recordings
        .iter()
        .map(RecordingResult::unshifted_us)
        .collect();
    let sigmas: Vec<f64> = recordings.iter().map(|r| r.sigma_us).collect();
    let weights: Vec<f64> = recordings
        .iter()
        .map(|r| r.row_time_sigma_us.max(1e-9).powi(-2))
        .collect();
    let total: f64 = weights.iter().sum();
    let row_time_us = recordings
        .iter()
        .zip(&weights)
        .map(|(r, w)| r.row_time_us * w)
        .sum::<f64>()
        / total;
    Precision {
        bias: BiasStatistics::from_values(&values, &sigmas),
        row_time_us,
        row_time_sigma_us: total.powf(-0.5),
        recordings,
        left_out,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_of_known_numbers() {
        let spread = BiasStatistics::from_values(&[1.0, 2.0, 3.0, 4.0, 5.0], &[0.1; 5]).unwrap();
        assert_eq!((spread.mean_us, spread.median_us), (3.0, 3.0));
        assert_eq!(spread.iqr_us, Some(2.0));
        assert!((spread.sd_us.unwrap() - 2.5f64.sqrt()).abs() < 1e-12);
        assert!((spread.mean_sigma_us - 0.5f64.sqrt()).abs() < 1e-12);
        let single = BiasStatistics::from_values(&[7.0], &[0.3]).unwrap();
        assert_eq!((single.sd_us, single.iqr_us), (None, None));
        assert_eq!(single.mean_sigma_us, 0.3);
        assert_eq!(BiasStatistics::from_values(&[], &[]), None);
    }
}
