//! Evaluation: bias and drift that are measured on the phone's videos, against
//! the phase of the frames by the ground truth.

use std::ops::Range;

use anyhow::{Context, Result};
use protocol::Ticks;
use rig::phone::VideoTruth;
use serde_json::Value;

use super::{Recorded, number};
use crate::frame_phase::{phase_errors, summarise};
use crate::programs::{Programs, ask};

/// Frames that `evaluate precision` uses, the last ones.
const FRAMES: usize = 16;

/// A measured value against the ground truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// As measured.
    pub value: f64,
    /// Stated 1-sigma.
    pub sigma: f64,
    /// Stated half width of the 99 % interval.
    pub uncertainty_99: f64,
    /// By the ground truth.
    pub truth: f64,
}

impl Measured {
    /// Measured minus true.
    #[must_use]
    pub fn error(&self) -> f64 {
        self.value - self.truth
    }
}

/// Results of `evaluate` on a recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EvaluationFigures {
    /// Bias of the last frames, µs.
    pub bias: Measured,
    /// Drift over the recorded span, µs/min.
    pub drift: Measured,
}

/// Evaluates the video of a recording, and compares.
///
/// # Errors
///
/// A step fails.
pub fn evaluated(recorded: &Recorded, programs: &Programs) -> Result<EvaluationFigures> {
    Ok(EvaluationFigures {
        bias: bias(recorded, programs)?,
        drift: drift(recorded, programs)?,
    })
}

/// Bias of the last frames, as `evaluate precision` measures it.
///
/// # Errors
///
/// The program fails, or the rig has no such frames.
pub fn bias(recorded: &Recorded, programs: &Programs) -> Result<Measured> {
    let json = ask(programs, &["evaluate", "precision"], &[&recorded.folder])?;
    let result = json["recordings"]
        .get(0)
        .context("no recording in the answer")?;
    let frames = number(&result["frames"], "used")? as usize;
    anyhow::ensure!(
        frames == FRAMES,
        "{frames} frames were used for the bias, not {FRAMES}"
    );
    Ok(Measured {
        value: number(result, "bias_us")?,
        sigma: number(result, "sigma_us")?,
        uncertainty_99: number(result, "uncertainty_99_us")?,
        truth: true_bias(recorded)?,
    })
}

/// Mean phase error of the last frames of the video, by the ground truth, µs.
fn true_bias(recorded: &Recorded) -> Result<f64> {
    let video = recorded.truth.videos.last().context("no video")?;
    let count = video.count.context("the video was not stopped")?;
    Ok(mean_phase(
        recorded,
        video,
        count.saturating_sub(FRAMES)..count,
    ))
}

/// Mean phase error of as many frames around a tick, by the ground truth, µs.
///
/// # Errors
///
/// The phone has recorded no video.
pub fn phase_at(recorded: &Recorded, at: Ticks) -> Result<f64> {
    let video = recorded.truth.videos.last().context("no video")?;
    let truth = &recorded.truth;
    let at = truth.board.true_at(recorded.truth.timebase.time(at));
    let middle = video.frames.complete_at(truth.phone.nanos_at(at));
    let first = middle.saturating_sub(FRAMES / 2);
    Ok(mean_phase(recorded, video, first..first + FRAMES))
}

fn mean_phase(recorded: &Recorded, video: &VideoTruth, frames: Range<usize>) -> f64 {
    let truth = &recorded.truth;
    let errors = phase_errors(&video.frames, frames, &truth.phone, &truth.depth);
    errors.iter().map(|e| e.error_us).sum::<f64>() / errors.len().max(1) as f64
}

/// Drift over the recorded span, as `evaluate drift` measures it.
fn drift(recorded: &Recorded, programs: &Programs) -> Result<Measured> {
    let video = recorded.truth.videos.last().context("no video")?;
    let count = video.count.context("the video was not stopped")?;
    let span = recorded.session.recorded.context("nothing was recorded")?;
    let phone_ns = |at| {
        let board = recorded.truth.timebase.time(at);
        let truth = &recorded.truth;
        truth.phone.nanos_at(truth.board.true_at(board))
    };
    // Whole frames inside the span, in seconds of the video.
    let first = video.frames.complete_at(phone_ns(span.from)) + 1;
    let last = video.frames.complete_at(phone_ns(span.to)).min(count) - 1;
    let period_s = video.frames.period_ns() * 1e-9;
    let at = |n: usize, part: f64| format!("{:.4}s", (n as f64 + part) * period_s);
    let json: Value = ask(
        programs,
        &[
            "evaluate",
            "drift",
            "--from",
            &at(first, -0.5),
            "--to",
            &at(last, -0.5),
        ],
        &[&recorded.folder],
    )?;
    let errors = phase_errors(
        &video.frames,
        first..last,
        &recorded.truth.phone,
        &recorded.truth.depth,
    );
    let truth = summarise(&errors).context("the recorded span has no frames")?;
    Ok(Measured {
        value: number(&json, "drift_us_per_min")?,
        sigma: number(&json, "drift_sigma_us_per_min")?,
        uncertainty_99: number(&json, "drift_uncertainty_99_us_per_min")?,
        truth: truth.drift_us_per_min,
    })
}
