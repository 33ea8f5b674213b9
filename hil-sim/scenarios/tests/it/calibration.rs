//! A constant that nobody knows is measured from the strobes, written into the profile, and
//! gone in the next recording.

use std::path::Path;

use crate::whole_chain::programs;
use protocol::Ticks;
use scenarios::programs::ask;
use scenarios::whole_chain::{self, Plan, Recorded, evaluation};
use stm32f4_sim::time::SimDuration;

/// Twists before the recording that is measured, and before the next one, whose skew is learnt.
const TWISTS: u32 = 1;

/// Seconds of the recording from which the frame period is learnt, and the twists before it,
/// more than a minute from the first to the last, from which the skew is.
const LEARNT_S: u32 = 10;
const LEARNT_TWISTS: u32 = 4;

/// 1-sigma of the phase at a tick, as the recording's session states it, µs.
fn phase_sigma_us(recorded: &Recorded, at: Ticks) -> f64 {
    let alignment = recorded.session.alignment.as_ref().unwrap();
    alignment.plan.phase_sigma_us_at(at.into())
}

/// One twist knows the skew of the clocks to 1 to 3 ppm, which is 10 to 30 µs within a
/// recording of ten seconds: as on a real rig, a longer recording comes first, from which
/// `profile learn` takes skew and frame period.
#[test]
fn a_hidden_constant_is_gone_after_calibration() {
    let out = tempfile::tempdir().unwrap();
    let programs = programs();
    let session = |name: &str, seconds: u32, twists: u32, profile: Option<&Path>| {
        let plan = Plan {
            name: name.to_owned(),
            twists,
            hidden_delay: SimDuration::from_millis(3),
            profile: profile.map(Path::to_owned),
            ..Plan::new(5, seconds)
        };
        whole_chain::record(&plan, &programs, out.path()).unwrap()
    };
    let text = |path: &Path| path.to_string_lossy().into_owned();
    let long = session("long", LEARNT_S, LEARNT_TWISTS, None);
    let files = phone::video_files::find(&long.phone, None).unwrap();
    let timestamps = files.unwrap().frames.unwrap();
    let (profile, timestamps) = (text(&long.profile), text(&timestamps));
    let learn = ["profile", "learn", "--profile", &profile, "--timestamps"];
    ask(&programs, &learn, &[Path::new(&timestamps), &long.folder]).unwrap();

    let first = session("before", 8, TWISTS, Some(&long.profile));
    let before = evaluation::bias(&first, &programs).unwrap();
    assert!((before.truth - 3000.0).abs() < 50.0, "{before:?}");
    let profile = text(&first.profile);
    let calibrate = ["evaluate", "precision", "--calibrate", &profile];
    let answer = ask(&programs, &calibrate, &[&first.folder]).unwrap();
    let written = answer["calibrated"]["bias_us"].as_f64().unwrap();
    assert!((written.abs() - 3000.0).abs() < 60.0, "{answer}");

    let second = session("after", 8, TWISTS, Some(&first.profile));
    let measured = first.session.recorded.unwrap();
    let next = second.session.recorded.unwrap();
    let middle = Ticks(u64::midpoint(next.from.0, next.to.0));
    let left_us = evaluation::phase_at(&second, middle).unwrap();
    // The phase that the first session states at its end, where the bias is measured, and the
    // next one in its middle.
    let sigma_us = phase_sigma_us(&first, measured.to).hypot(phase_sigma_us(&second, middle));
    println!("{left_us} ± {sigma_us} µs left; {answer}");
    assert!(left_us.abs() <= 3.0 * sigma_us, "{left_us} ± {sigma_us}");
    assert!(left_us.abs() < 60.0, "{left_us}");
}
