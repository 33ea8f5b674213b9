//! Sessions through the firmware's binary, its link and the program's session, on rigs of the
//! model ranges: the phase of the frames when the trigger has arrived, over five minutes and over
//! the whole recording.
//!
//! A first session of a minute teaches the profile frame period and skew, as on a new rig. Two
//! longer ones follow: with the phone on a cable, so that the trigger follows its clock, and
//! without. Nothing is rendered and no video is read: the phase is that of the ground truth. The
//! constant between the cameras is not part of it, since the owner's profile holds the rig's true
//! delays.

use std::path::Path;

use anyhow::Result;
use evaluate::stats::{mean, quantile};
use rig::clocks::link_delay::LinkRanges;
use rig::motion::MotionSpec;
use rig::motion::gesture::Gesture;
use rig::phone::PhoneConfig;
use rig::random::Seed;
use rig::whole_rig::config::RigConfig;
use rig::wiring;
use session::options::Track;

use super::launches::rms;
use super::{Figure, Specimen};
use crate::demo::{teach, wishes};
use crate::frame_phase::{PhaseError, summarise};
use crate::judge::{Truth, Verdict};
use crate::programs::Programs;
use crate::virtual_session::SessionBench;
use crate::whole_chain::new_folder;

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
    rig.values.apply(&mut config, &mut phone);
    let folder = new_folder(&out.join(format!("{} {}", rig.seed, rig.kind)))?;
    phone.storage = Some(folder.join("phone"));
    let board = wiring::board_of(config.board, programs.elf.as_deref());
    let mut bench = SessionBench::new(config, board, vec![phone], &[], &folder)?;
    bench.phone_link = Some(LinkRanges::PHONE_USB);
    teach(&mut bench, Track::Never, programs)?;
    let kinds = [
        ("with a cable", Track::Always),
        ("without a cable", Track::Never),
    ];
    let recordings = kinds.map(|(name, track)| {
        let mut wishes = wishes(&bench, name, seconds, track);
        (wishes.second_twist, wishes.fetch_video) = (false, false);
        let folder = bench.run(&wishes).good()?.folder;
        anyhow::Ok((name, folder))
    });
    let truth = Truth::from_run(bench.stop()?)?;
    let mut figures = Vec::new();
    for recording in recordings {
        let (name, folder) = recording?;
        figures.extend(judged(name, &truth.judge(&folder)?));
    }
    Ok(figures)
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
        figure("phase at the start (µs)", verdict.phase.start_us),
        figure(
            "95 % of the frames of five minutes (µs)",
            within(&errors(early)),
        ),
        figure("95 % of their means over 300 frames (µs)", within(&means)),
        figure("scatter of frames about these, rms (µs)", rms(scatter)),
        figure("drift over five minutes (µs/min)", drift),
    ];
    if early.len() < phases.len() {
        let all = within(&errors(phases));
        figures.push(figure("95 % of all frames (µs)", all));
    }
    figures
}
