//! Evaluation: bias and drift that are measured on the phone's videos, against
//! the phase of the frames by the ground truth, over many seeds; and whether the stated
//! uncertainties are honest.

use std::ops::Range;
use std::path::Path;

use anyhow::{Context, Result};
use protocol::Ticks;
use rig::phone::VideoTruth;
use serde::Serialize;
use serde_json::Value;

use super::{Plan, Recorded, number, record};
use crate::frame_phase::{phase_errors, summarise};
use crate::programs::{Programs, ask};

/// Frames that `evaluate precision` uses, the last ones.
const FRAMES: usize = 16;
/// Share of the seeds that must be right within the stated uncertainty.
pub(crate) const REQUIRED_SHARE: f64 = 0.95;

/// A measured value against the ground truth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Measured {
    /// As measured.
    pub value: f64,
    /// Stated 1-sigma.
    pub sigma: f64,
    /// Stated half width of the 99 % interval.
    pub uncertainty_99: f64,
    /// By the truth.
    pub truth: f64,
}

impl Measured {
    /// Measured minus true.
    #[must_use]
    pub fn error(&self) -> f64 {
        self.value - self.truth
    }

    /// Tells whether the truth is within the stated uncertainty (99 %).
    #[must_use]
    pub fn within(&self) -> bool {
        self.error().abs() <= self.uncertainty_99
    }
}

/// One recording.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SeedFigures {
    /// Its seed.
    pub seed: u64,
    /// Bias of the last frames, µs.
    pub bias: Measured,
    /// Drift over the recorded span, µs/min.
    pub drift: Measured,
}

/// All recordings.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct EvaluationFigures {
    /// Each.
    pub seeds: Vec<SeedFigures>,
}

/// Share within the stated uncertainty, and root mean squares of the error and of
/// error over sigma.
fn summary(all: &[Measured]) -> (f64, f64, f64) {
    let n = all.len().max(1) as f64;
    let rms =
        |f: &dyn Fn(&Measured) -> f64| (all.iter().map(|m| f(m).powi(2)).sum::<f64>() / n).sqrt();
    (
        all.iter().filter(|m| m.within()).count() as f64 / n,
        rms(&|m| m.error()),
        rms(&|m| m.error() / m.sigma),
    )
}

impl EvaluationFigures {
    fn columns(&self) -> [(&'static str, &'static str, Vec<Measured>); 2] {
        let column = |f: fn(&SeedFigures) -> Measured| self.seeds.iter().map(f).collect();
        [
            ("bias", "µs", column(|s| s.bias)),
            ("drift", "µs/min", column(|s| s.drift)),
        ]
    }

    /// Tells whether enough seeds are right within the stated uncertainty.
    #[must_use]
    pub fn good(&self) -> bool {
        self.columns()
            .iter()
            .all(|(_, _, all)| summary(all).0 >= REQUIRED_SHARE)
    }

    /// As text.
    #[must_use]
    pub fn table(&self) -> String {
        let mut text = format!("Simulated, whole chain, {} seeds\n", self.seeds.len());
        for (name, unit, all) in self.columns() {
            let (share, error, sigmas) = summary(&all);
            text += &format!(
                "{name:<6} within the stated uncertainty (99 %): {:.0} % of the seeds \
                 (required {:.0} %); error {error:.3} {unit} rms, error over sigma {sigmas:.2} rms\n",
                100.0 * share,
                100.0 * REQUIRED_SHARE,
            );
        }
        text
    }
}

/// Makes a recording, evaluates its video, and compares.
///
/// # Errors
///
/// A step fails.
pub fn check(plan: &Plan, programs: &Programs, out: &Path) -> Result<SeedFigures> {
    measured(plan.seed, &record(plan, programs, out)?, programs)
}

/// Evaluates the video of a recording, and compares.
pub(super) fn measured(seed: u64, recorded: &Recorded, programs: &Programs) -> Result<SeedFigures> {
    Ok(SeedFigures {
        seed,
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
pub(super) fn phase_at(recorded: &Recorded, at: Ticks) -> Result<f64> {
    let video = recorded.truth.videos.last().context("no video")?;
    let truth = &recorded.truth;
    let at = truth.board.true_at(recorded.base.time(at));
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
        let board = recorded.base.time(at);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_outside_the_uncertainty_counts_against_it() {
        let measured = |value| Measured {
            value,
            sigma: 1.0,
            uncertainty_99: 2.6,
            truth: 10.0,
        };
        let seed = |seed, bias| SeedFigures {
            seed,
            bias: measured(bias),
            drift: measured(10.0),
        };
        let mut figures = EvaluationFigures {
            seeds: (0..20).map(|s| seed(s, 11.0)).collect(),
        };
        assert!(figures.good());
        figures.seeds[0].bias.value = 13.0;
        assert!(figures.good(), "19 of 20 are 95 %");
        figures.seeds[1].bias.value = 7.0;
        assert!(!figures.good());
    }
}
