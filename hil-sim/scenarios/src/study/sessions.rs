//! Sessions through the firmware's binary, its link and the program's session, on rigs of the
//! model ranges: the phase of the frames when the trigger has arrived, over five minutes and over
//! the whole recording.
//!
//! Nothing is given: the constants between the exposures are drawn, and the owner begins with the
//! profile of a first set-up. A calibration with LED and photodiode teaches the profile, as on a
//! new rig; its own phase is that of a rig that is not calibrated. A longer session follows, with
//! the phone on a cable, so that the trigger follows its clock. The phase is that of the ground
//! truth; `evaluate precision` measures it on the video too, by a way that shares nothing with
//! LED, photodiode and gyroscopes.

use std::path::Path;

use anyhow::{Context, Result};
use evaluate::stats::{mean, quantile};
use rig::clocks::link_delay::LinkRanges;
use rig::motion::MotionSpec;
use rig::motion::gesture::Gesture;
use rig::phone::PhoneConfig;
use rig::random::Seed;
use rig::whole_rig::config::RigConfig;
use rig::wiring;
use session::options::{LED_TICKS, Track};

use super::launches::rms;
use super::{Figure, Specimen};
use crate::calibration;
use crate::frame_phase::{PhaseError, summarise};
use crate::judge::{Truth, Verdict};
use crate::programs::{Programs, ask};
use crate::virtual_session::SessionBench;
use crate::whole_chain::{new_folder, number};

/// Time over which a recording's phase is given besides the whole of it, seconds.
const FIVE_MINUTES_S: f64 = 300.0;
/// Frames in a mean, ten seconds of them: a seventeenth of the cameras' own jitter from frame to
/// frame is left in it.
const MEAN: usize = 300;

/// Records the sessions of a rig, `seconds` each, below `out`.
///
/// # Errors
///
/// A session fails or finishes with loss, or nothing can be learnt.
pub fn figures(
    rig: &Specimen,
    seconds: u32,
    programs: &Programs,
    out: &Path,
) -> Result<Vec<Figure>> {
    let seed = Seed(rig.seed);
    let mut config = RigConfig::published(seed).with_motion(MotionSpec::always(Gesture::Twist));
    let mut phone = PhoneConfig::draw(seed);
    // Rows as of a real phone, on which the LED's sigma depends; few columns.
    phone.camera.columns = 16;
    calibration::hide_constants(seed, &mut config, &mut phone);
    rig.values.apply(&mut config, &mut phone);
    let folder = new_folder(&out.join(format!("{} {}", rig.seed, rig.kind)))?;
    phone.storage = Some(folder.join("phone"));
    let true_center_us = config.center_offset_us().context("no depth camera")?;
    let true_delay_us = phone.gyroscope.low_pass.delay_s * 1e6;
    let true_readout_us = phone.camera.readout_ns() * 1e-3;
    let board = wiring::board_of(config.board, programs.elf.as_deref());
    let mut bench = SessionBench::new(config, board, vec![phone], &[], &folder)?;
    bench.phone_link = Some(LinkRanges::PHONE_USB);
    bench.copies_files = true;
    calibration::set_up(&mut bench, programs)?;
    let first = calibration::calibrate(&mut bench, Track::Never, LED_TICKS, programs)?;
    let (known, depth) = (&bench.profile.phone, &bench.profile.depth);
    let learnt = [
        stated(
            "phone's half (µs)",
            known.gyro_delay_us - true_delay_us,
            known.gyro_delay_sigma_us,
        ),
        stated(
            "readout (µs)",
            known.readout_us - true_readout_us,
            known.readout_sigma_us,
        ),
        stated(
            "depth's half (µs)",
            depth.center_offset_us - true_center_us,
            depth.center_offset_sigma_us,
        ),
    ];
    let mut wishes = calibration::wishes(&bench, "recording", seconds, Track::Always);
    wishes.second_twist = false;
    let next = bench.run(&wishes).good()?.folder;
    let truth = Truth::from_run(bench.stop()?)?;
    let mut figures = vec![at_start("not calibrated", &truth.judge(&first)?)];
    figures.extend(learnt);
    let verdict = truth.judge(&next)?;
    figures.extend(judged("calibrated", &verdict));
    // A video on which no flashes are found says so.
    match ask(programs, &["evaluate", "precision"], &[&next]) {
        Ok(answer) => {
            let found = &answer["recordings"][0];
            let sigma_us = number(found, "sigma_us")?.hypot(verdict.phase_sigma_us);
            let name = "calibrated: phase by the strobes on the video (µs)";
            figures.push(stated(name, number(found, "bias_us")?, sigma_us));
        }
        Err(error) => eprintln!("seed {}: {error:#}", rig.seed),
    }
    Ok(figures)
}

/// A figure with its stated 1-sigma.
fn stated(name: &str, error: f64, sigma: f64) -> Figure {
    Figure {
        name: name.to_owned(),
        error,
        sigma: Some(sigma),
    }
}

/// The phase of a recording at its start, and its stated 1-sigma with that of the line through the
/// true points.
fn at_start(name: &str, verdict: &Verdict) -> Figure {
    let sigma_us = (verdict.phase_sigma_us).hypot(2.0 * verdict.phase.mean_sigma_us());
    let name = format!("{name}: phase at the start (µs)");
    stated(&name, verdict.phase.start_us, sigma_us)
}

/// The figures of a recording.
fn judged(name: &str, verdict: &Verdict) -> Vec<Figure> {
    let phases = &verdict.phases[..];
    let begin_s = phases.first().map_or(0.0, |phase| phase.at_s);
    let count = phases.partition_point(|phase| phase.at_s <= begin_s + FIVE_MINUTES_S);
    let early = phases.get(..count).unwrap_or_default();
    let errors =
        |phases: &[PhaseError]| -> Vec<f64> { phases.iter().map(|phase| phase.error_us).collect() };
    let within = |errors: &[f64]| {
        let sizes: Vec<f64> = errors.iter().map(|error| error.abs()).collect();
        quantile(&sizes, 0.95).unwrap_or(f64::NAN)
    };
    let drift = summarise(early).map_or(f64::NAN, |line| line.drift_us_per_min);
    let tens = early.chunks_exact(MEAN);
    let means: Vec<f64> = tens.clone().map(|frames| mean(&errors(frames))).collect();
    let scatter = tens.filter_map(|frames| Some(summarise(frames)?.residual_us));
    let figure = |what: &str, error| Figure {
        name: format!("{name}: {what}"),
        error,
        sigma: None,
    };
    let mut figures = vec![
        at_start(name, verdict),
        figure(
            "95 % of the frames of five minutes (µs)",
            within(&errors(early)),
        ),
        figure("drift over five minutes (µs/min)", drift),
    ];
    if !means.is_empty() {
        figures.extend([
            figure("95 % of means over 300 frames (µs)", within(&means)),
            figure("scatter of frames about these, rms (µs)", rms(scatter)),
        ]);
    }
    if early.len() < phases.len() {
        let all = within(&errors(phases));
        figures.push(figure("95 % of all frames (µs)", all));
    }
    figures
}
