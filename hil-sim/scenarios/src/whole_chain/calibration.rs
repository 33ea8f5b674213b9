//! Calibration: a constant that nobody knows is measured from the strobes,
//! written into the profile, and gone in the next recording.

use std::path::Path;

use anyhow::{Context, Result};
use protocol::Ticks;
use serde::Serialize;
use session::alignment::phase_sigma_us_at;

use super::{Plan, Recorded, number, record};
use crate::programs::{Programs, ask};
use crate::whole_chain::evaluation::{Measured, bias, phase_at};
use stm32f4_sim::time::SimDuration;

/// Most that may be left of the bias in the middle of the next recording, in sigmas of what the
/// two sessions state of their phase.
const LIMIT_SIGMAS: f64 = 3.0;

/// Twists before the recording that is measured, and before the next one.
const TWISTS: u32 = 3;

/// Seconds of the recording from which the frame period is learnt, and the twists before it,
/// more than a minute from the first to the last, from which the skew is.
const LEARNT_S: u32 = 60;
const LEARNT_TWISTS: u32 = 4;

/// The figures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CalibrationFigures {
    /// The constant that was hidden in the camera, µs.
    pub hidden_us: f64,
    /// Bias of the recording before, as measured and by the ground truth, µs.
    pub before: Measured,
    /// The constant that was written into the profile, with its 1-sigma, µs.
    pub written_us: (f64, f64),
    /// Bias of the next recording, µs.
    pub after: Measured,
    /// Phase error in the middle of the next recording, by the ground truth, µs.
    pub left_us: f64,
    /// Phase that the first session states at its end, where the bias is measured, and
    /// the next of its own in the middle, together, 1-sigma, µs.
    pub sigma_us: f64,
}

impl CalibrationFigures {
    /// Tells whether the bias of the next recording is gone, by the ground truth.
    #[must_use]
    pub fn good(&self) -> bool {
        self.left_us.abs() <= LIMIT_SIGMAS * self.sigma_us
    }

    /// As text.
    #[must_use]
    pub fn table(&self) -> String {
        let row = |name: &str, m: &Measured| {
            format!(
                "{name:<22} measured {:+.3} ± {:.3} µs, by the truth {:+.3} µs\n",
                m.value, m.sigma, m.truth
            )
        };
        format!(
            "Simulated, whole chain, {:+.0} µs hidden in the camera\n{}\
             {:<22} {:+.3} ± {:.3} µs\n{}\
             {:<22} by the truth {:+.3} µs, both sessions state {:.3} µs (1 σ)\n",
            self.hidden_us,
            row("bias before", &self.before),
            "written",
            self.written_us.0,
            self.written_us.1,
            row("bias after", &self.after),
            "in its middle",
            self.left_us,
            self.sigma_us,
        )
    }
}

/// Records with a camera that flashes `hidden` later than anybody knows, learns
/// the clocks, calibrates, and records again.
///
/// One twist knows the skew of the clocks to 1 to 3 ppm, which is 10 to 30 µs
/// within a recording of ten seconds: as on a real rig, a longer recording comes
/// first, from which `profile learn` takes skew and frame period, and the recordings to
/// be compared have three twists each.
///
/// # Errors
///
/// A step fails.
pub fn check(
    plan: &Plan,
    hidden: SimDuration,
    programs: &Programs,
    out: &Path,
) -> Result<CalibrationFigures> {
    let session = |name: &str, seconds: u32, twists: u32, profile: Option<&Path>| {
        let plan = Plan {
            name: format!("{}_{name}", plan.name),
            seconds,
            twists,
            hidden_delay: hidden,
            profile: profile.map(Path::to_owned),
            ..plan.clone()
        };
        record(&plan, programs, out)
    };
    let long = session("long", LEARNT_S, LEARNT_TWISTS, None)?;
    let text = |path: &Path| path.to_string_lossy().into_owned();
    let files = phone::video_files::find(&long.phone, None)?;
    let timestamps = files.and_then(|files| files.frames);
    let timestamps = timestamps.context("the phone saved no frame timestamps")?;
    ask(
        programs,
        &[
            "profile",
            "learn",
            "--profile",
            &text(&long.profile),
            "--timestamps",
            &text(&timestamps),
        ],
        &[&long.folder],
    )?;
    let first = session("before", plan.seconds, TWISTS, Some(&long.profile))?;
    let before = bias(&first, programs)?;
    let json = ask(
        programs,
        &[
            "evaluate",
            "precision",
            "--calibrate",
            &text(&first.profile),
        ],
        &[&first.folder],
    )?;
    let written = json.get("calibrated").context("nothing was written")?;
    let second = session("after", plan.seconds, TWISTS, Some(&first.profile))?;
    let span = |recorded: &Recorded| recorded.session.recorded.context("nothing was recorded");
    let (measured, next) = (span(&first)?, span(&second)?);
    let middle = Ticks(u64::midpoint(next.from.0, next.to.0));
    Ok(CalibrationFigures {
        hidden_us: hidden.as_nanos() as f64 * 1e-3,
        before,
        written_us: (
            number(written, "bias_us")?,
            number(written, "bias_sigma_us")?,
        ),
        after: bias(&second, programs)?,
        left_us: phase_at(&second, middle)?,
        sigma_us: phase_sigma_us(&first, measured.to)?.hypot(phase_sigma_us(&second, middle)?),
    })
}

/// 1-sigma of the phase at a tick of a recording, as its session states it, µs.
fn phase_sigma_us(recorded: &Recorded, at: Ticks) -> Result<f64> {
    let alignment = recorded.session.alignment.as_ref();
    let alignment = alignment.context("it was not aligned")?;
    Ok(phase_sigma_us_at(alignment, at.into()))
}

/// Removes the recordings of a check.
pub fn discard(plan: &Plan, out: &Path) {
    for name in ["long", "before", "after"] {
        // What is left over does no harm.
        let _ = std::fs::remove_dir_all(out.join(format!("{}_{name}", plan.name)));
    }
}
