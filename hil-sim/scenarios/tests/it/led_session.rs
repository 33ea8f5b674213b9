//! A calibration with LED and photodiode on rigs whose constants nobody knows, and the session after
//! it: the distance of the two exposures against the ground truth.

use std::path::Path;

use recording::error_budget::ErrorPart;
use recording::profile::measured::{MeasuredPhone, PhoneRows, with_phone};
use recording::profile::{DEFAULT, Direction, Phone, Profile};
use rig::led::LedConfig;
use rig::random::{Seed, Stream};
use rig::wiring::OUTPUTS;
use scenarios::judge::Truth;
use scenarios::programs::ask;
use session::options::seconds;
use stm32f4_sim::time::SimDuration;
use test_support::TestFolder;

use crate::bench::Twisted;
use crate::whole_chain::programs;

/// A rig with constants from their whole ranges, which its owner does not know, and with the
/// profile of a first set-up.
fn unknown(seed: u64, storage: &Path) -> Twisted {
    let mut rig = Twisted::with(seed, |rig, phone| {
        let mut random = Seed(seed).stream(Stream::ModelRanges);
        let mut draw = |from: f64, to: f64| random.uniform(from, to);
        let flash_us = draw(350.0, 10_000.0);
        phone.gyroscope.low_pass.delay_s = draw(1e-3, 8e-3);
        phone.storage = Some(storage.to_owned());
        phone.camera.rows = 270;
        let readout_ns = draw(5e6, 33e6_f64.min(0.98 * phone.camera.frame_period_ns));
        phone.camera.row_time_ns = readout_ns / (phone.camera.rows - 1) as f64;
        phone.camera.exposure_ns = (draw(0.1_f64.ln(), 12_f64.ln()).exp() * 1e6) as u64;
        rig.led = Some(LedConfig {
            pin: OUTPUTS[2],
            rise: SimDuration::from_nanos(draw(20.0, 500.0) as u64),
            persistence: SimDuration::from_nanos(draw(20.0, 1_000.0) as u64),
        });
        let camera = rig.depth_camera.as_mut().unwrap();
        camera.flash_delay = SimDuration::from_nanos((flash_us * 1e3) as u64);
        let [rise, fall] = [(); 2].map(|()| SimDuration::from_nanos(draw(50.0, 1_000.0) as u64));
        camera.photodiode_delay = (rise, fall);
    });
    let mut profile = Profile::published().unwrap();
    let owners = &rig.bench.profile;
    profile.phone.address.clone_from(&owners.phone.address);
    profile.phone.exposure_locked = true;
    (profile.phone.twist_s, profile.align.slew_us) = (9, 1_000.0);
    rig.bench.profile = profile;
    rig
}

/// Errors in µs, each with its 1-sigma.
#[derive(Debug)]
struct Errors {
    phone: [f64; 2],
    row_time_ppm: f64,
    depth: [f64; 2],
    /// Of the session after the calibration, at its start.
    all_in: [f64; 2],
}

fn calibrated(seed: u64, led: u64) -> Errors {
    let storage = TestFolder::new();
    let mut rig = unknown(seed, storage.path());
    let mut options = rig.options("calibration", 5);
    options.led = led;
    options.second_twist = true;
    options.fetch_video = true;
    let ended = rig.bench.run(&options).good().unwrap();
    // As its owner fetches them.
    let files = phone::video_files::find(storage.path(), None).unwrap();
    let stamps = files.unwrap().frames.unwrap();
    let to = ended.folder.join(stamps.file_name().unwrap());
    std::fs::copy(&stamps, to).unwrap();
    let path = rig.folder.path().join("rig.toml");
    std::fs::write(&path, rig.bench.profile.to_toml().unwrap()).unwrap();
    let arguments = ["profile", "learn", "--profile", path.to_str().unwrap()];
    let answer = ask(&programs(), &arguments, &[&ended.folder]).unwrap();
    println!("{answer}");
    let row_time_us = answer["rows"]["row_time_us"].as_f64().unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    let profile = Profile::parse(&text, None).unwrap();
    let (phone, depth) = (profile.phone.clone(), profile.depth.clone());
    rig.bench.profile = profile;

    let config = rig.bench.with(|rig| rig.parts().config.clone());
    let camera = rig.bench.with(|rig| rig.phones[0].app.config.clone());
    let next = rig.options("next", 5);
    let next = rig.bench.run(&next).good().unwrap();
    let alignment = next.file.alignment.unwrap();
    assert!(alignment.bias_is_measured, "{alignment:?}");
    let truth = Truth::from_run(rig.bench.stop().unwrap()).unwrap();
    let phase = truth.judge(&next.folder).unwrap().phase;
    let delay_us = camera.gyroscope.low_pass.delay_s * 1e6;
    Errors {
        phone: [phone.gyro_delay_us - delay_us, phone.gyro_delay_sigma_us],
        row_time_ppm: (row_time_us * 1e3 / camera.camera.row_time_ns - 1.0) * 1e6,
        depth: [
            depth.center_offset_us - config.center_offset_us().unwrap(),
            depth.center_offset_sigma_us,
        ],
        all_in: [phase.start_us, alignment.phase_sigma_us],
    }
}

/// The re-transmitted flashes of the depth camera light the picture as well as the LED.
#[test]
fn nothing_is_given_and_the_exposures_meet() {
    all_in_bounds(&calibrated(300, seconds(22)));
}

fn all_in_bounds(errors: &Errors) {
    println!("{errors:?}");
    for [error, sigma] in [errors.phone, errors.depth, errors.all_in] {
        assert!(error.abs() < 4.0 * sigma, "{errors:?}");
    }
    assert!(errors.all_in[0].abs() < 100.0, "{errors:?}");
}

/// `cargo test --release -p hil-sim --test it drawn_rigs_that_nobody -- --ignored --nocapture`
#[test]
#[ignore = "minutes; prints the figures of the book for 12 rigs, or SMARTDEPTHSYNC_DRAWN"]
fn drawn_rigs_that_nobody_knows_are_calibrated() {
    let count = std::env::var("SMARTDEPTHSYNC_DRAWN").ok();
    let count: u64 = count.and_then(|text| text.parse().ok()).unwrap_or(12);
    let all: Vec<Errors> = (0..count)
        .map(|seed| calibrated(400 + seed, seconds(60)))
        .inspect(all_in_bounds)
        .collect();
    let figure = |name: &str, of: fn(&Errors) -> [f64; 2]| {
        let mut sizes: Vec<f64> = all.iter().map(|errors| of(errors)[0].abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let most = sizes[(0.95 * (sizes.len() - 1) as f64).round() as usize];
        let z = all
            .iter()
            .map(|errors| (of(errors)[0] / of(errors)[1]).powi(2))
            .sum::<f64>();
        println!(
            "{name}: 95 % below {most:.2}, over sigma {:.2}",
            (z / sizes.len() as f64).sqrt()
        );
    };
    figure("phone's half, µs", |errors| errors.phone);
    figure("row time, ppm", |errors| [errors.row_time_ppm, 1.0]);
    figure("depth's half, µs", |errors| errors.depth);
    figure("all-in at the start, µs", |errors| errors.all_in);
}

/// A measurement holds for its phone, exposure and app alone.
#[test]
fn a_measurement_of_the_phone_goes_stale() {
    let measured = MeasuredPhone {
        date: jiff::civil::date(2026, 11, 29),
        phone: "phone".to_owned(),
        exposure_us: 2_000.0,
        app: Some("v.0.1.1".to_owned()),
    };
    let rows = PhoneRows {
        gyro_delay_us: [3_200.0, 8.0],
        readout_us: [11_000.0, 2.0],
        direction: Direction::Down,
    };
    let path = Path::new("rig.toml");
    let text = with_phone(DEFAULT, path, &rows, &measured).unwrap();
    let profile = Profile::parse(&text, None).unwrap();
    let part = |phone: &Phone, exposure_us: f64| match phone.own_parts(exposure_us)[..] {
        [part] => part,
        ref parts => panic!("{parts:?}"),
    };
    let phone = profile.phone;
    let sigma_us = 8.0_f64.hypot(1.0);
    assert_eq!(part(&phone, 2_000.0), (ErrorPart::MeasuredPhone, sigma_us));
    assert_eq!(part(&phone, 4_000.0).0, ErrorPart::StalePhone);
    assert!(part(&phone, 4_000.0).1 > 999.0);
    let mut other = phone.clone();
    other.name = "another".to_owned();
    assert_eq!(part(&other, 2_000.0).0, ErrorPart::StalePhone);
    assert!(part(&other, 2_000.0).1 >= 2_000.0);
    let mut same = phone.clone();
    assert_eq!(same.forget_if_other_app(Some("v.0.1.1")), None);
    assert_eq!(same.forget_if_other_app(None), None);
    assert_eq!(same, phone);
    assert!(same.forget_if_other_app(Some("v.0.2.0")).is_some());
    assert!(same.measured.is_none() && same.gyro_delay_sigma_us >= 2_000.0);
}
