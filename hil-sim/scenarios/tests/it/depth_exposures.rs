//! The middle of the depth exposure as a photodiode sees it, against that of the camera's model.

use std::path::Path;

use recording::profile::measured::with_depth;
use recording::profile::{DEFAULT, Profile};
use rig::depth_camera::Family;
use rig::model_ranges::ModelValues;
use rig::random::{Seed, Stream};
use scenarios::judge::Truth;
use stm32f4_sim::time::SimDuration;

use crate::bench::Twisted;

/// A rig of this family with everything drawn that a photodiode sees, and the profile of somebody
/// who has measured nothing.
fn drawn(seed: u64, family: Family) -> Twisted {
    let mut truth = None;
    let mut rig = Twisted::with(seed, |rig, phone| {
        let mut random = Seed(seed).stream(Stream::Rig);
        let camera = rig.depth_camera.unwrap();
        let delay_us = random.uniform(350.0, 10_000.0);
        let mut camera = family.specimen(camera, Seed(seed));
        if family.writes_mkv() {
            camera.flash_delay = SimDuration::from_nanos((delay_us * 1e3) as u64);
        }
        rig.depth_camera = Some(camera);
        let motion = rig.motion.clone();
        ModelValues::drawn(Seed(seed)).apply(rig, &mut phone.clone());
        rig.motion = motion;
        let camera = rig.depth_camera.as_mut().unwrap();
        camera.photodiode = true;
        truth = rig.center_offset_us();
    });
    let depth = &mut rig.bench.profile.depth;
    depth.camera = family.word().to_owned();
    let model = depth.model().unwrap();
    depth.mode.clone_from(&model.default_mode.name);
    depth.pulse_width_us = model.pulse.width_us;
    depth.center_offset_us = model.default_mode.center_us(depth.fps, 8_000.0);
    depth.center_offset_sigma_us = model.default_mode.sigma_us;
    rig
}

/// Errors of the middle against the model of the camera, over cameras whose constant nobody knows;
/// the trigger is then aligned with it.
#[test]
fn a_photodiode_measures_the_middle_of_any_exposure_and_aligns_by_it() {
    let count = std::env::var("SMARTDEPTHSYNC_DRAWN").ok();
    let count: u64 = count.and_then(|text| text.parse().ok()).unwrap_or(3);
    let mut squares = 0.0;
    for seed in 0..count {
        let family = [Family::AzureKinect, Family::RealSense, Family::Femto][seed as usize % 3];
        let mut rig = drawn(40 + seed, family);
        let options = rig.options("seen", 4);
        let ended = rig.bench.run(&options).ended().unwrap();
        let config = rig.bench.with(|rig| rig.parts().config.clone());
        let truth_us = config.center_offset_us().unwrap();
        let seen = ended.file.exposures.unwrap();
        // The light of what was recorded: its jitter is no error of the measurement.
        let jitter_us = config.depth_camera.unwrap().flash_jitter.as_nanos() as f64 * 1e-3;
        let of_mean = jitter_us / (seen.used as f64).sqrt();
        let (error, sigma) = (seen.center_us - truth_us, seen.sigma_us);
        squares += (error / sigma).powi(2);
        println!("{family:?}: {error:7.3} ± {sigma:6.3} µs, {}", seen.text());
        assert!(error.abs() < 1.0 + 4.0 * of_mean, "{error} ± {sigma}");
        let alignment = ended.file.alignment.unwrap();
        let off = (alignment.center_offset_us - truth_us).abs();
        assert!(off < 1.0 + 4.0 * jitter_us / 60_f64.sqrt(), "{alignment:?}");
        let verdict = Truth::from_run(rig.bench.stop().unwrap()).unwrap();
        let phase = verdict.judge(&ended.folder).unwrap().phase;
        let phase_sigma = alignment
            .plan
            .phase_sigma_us_at(alignment.arrival.unwrap().into());
        let most = 5.0 * phase_sigma.hypot(jitter_us);
        assert!(phase.start_us.abs() < most, "{phase:?}, ± {phase_sigma}");
    }
    println!(
        "error over sigma, rms: {:.2}",
        (squares / count as f64).sqrt()
    );
}

#[test]
fn the_total_with_a_bias_that_was_measured_stays() {
    let path = Path::new("rig.toml");
    let date = jiff::civil::date(2026, 11, 29);
    let biased = DEFAULT.replace("bias_us = 0.0", "bias_us = 100.0").replace(
        "bias_sigma_us = 0.0",
        "bias_sigma_us = 2.0\nbias_measured = 2026-01-31",
    );
    let text = with_depth(&biased, path, [6_000.0, 0.5], date).unwrap();
    let profile = Profile::parse(&text, None).unwrap();
    let total = profile.depth.center_offset_us + profile.frame_sync.bias_us;
    assert!((total - 6_462.5).abs() < 1e-6, "{total}");
    assert!(text.contains("# From the trigger's edge to the middle of exposure"));
    let stale = text.replace("mode = \"NFOV_UNBINNED\"\n", "mode = \"NFOV_2X2BINNED\"\n");
    let stale = Profile::parse(&stale, None).unwrap();
    assert_eq!(profile.depth.center_part().1, 0.5);
    assert_eq!(stale.depth.center_part().1, 5_000.0);
}
