//! A twist through the app's port: what the host estimates from the simulated
//! phone's answer and a board's gyroscope is the truth about their clocks.

use std::sync::Arc;
use std::time::Duration;

use crate::turn;
use phone::{PhoneClient, Settings};
use rig::flash_log::Dark;
use rig::inertial_channel::{Channel, ChannelConfig, LowPass, quantise};
use rig::motion::MotionSpec;
use rig::oscillator::{BoardTime, OscillatorConfig, TrueTime};
use rig::phone::{PhoneConfig, SimPhone, Surroundings};
use rig::random::{Seed, Stream, rotation};
use rig::true_clock::TrueClock;
use stm32f4_sim::time::SimTime;
use timebase::phone_track;
use twist_sync::{GyroTrack, Options, estimate_offset};

/// When the phone begins, and for how long, in true seconds.
const BEGIN: u64 = 3;
const LENGTH: u64 = 9;

/// Error of the offset at the reference and its stated sigma, in µs.
fn twist(seed: u64) -> (f64, f64) {
    let seed = Seed(seed);
    let spec: MotionSpec = "twist".parse().unwrap();
    let motion = spec.build(seed.stream(Stream::Motion));
    let clock = TrueClock::new();
    let config = PhoneConfig::draw(seed);
    let phone_delay_s = config.gyroscope.low_pass.delay_s;
    let surroundings = Surroundings {
        clock: clock.clone(),
        motion: Arc::clone(&motion),
        light: Arc::new(Dark),
    };
    let phone = SimPhone::start(config, surroundings, 0).unwrap();
    let mut client =
        PhoneClient::connect(&phone.address().to_string(), Settings::default()).unwrap();
    clock.publish(TrueTime::from_nanos(BEGIN * 1_000_000_000));
    let samples = std::thread::scope(|scope| {
        let asked = scope.spawn(|| {
            let length = Duration::from_secs(LENGTH);
            client.gyroscope(length).unwrap()
        });
        while clock.waiters() == 0 {
            std::thread::sleep(Duration::from_millis(1));
        }
        clock.publish(TrueTime::from_nanos((BEGIN + LENGTH + 1) * 1_000_000_000));
        asked.join().unwrap()
    });
    let times: Vec<_> = samples.iter().map(|s| s.time).collect();
    let phone_track = phone_track(&times, samples.iter().map(|s| s.xyz).collect());

    // A board with a crystal of its own that samples every 2 ms of its time.
    let mut random = seed.stream(Stream::Rig);
    let crystal = OscillatorConfig {
        offset_ns: 0,
        rate_ppm: random.uniform(-30.0, 30.0),
        wander: 1e-9,
        ..OscillatorConfig::default()
    };
    let board = BoardTime::new(crystal, seed.stream(Stream::BoardClock));
    let pass = LowPass {
        bandwidth_hz: 188.0,
        delay_s: 1.9e-3,
    };
    let imu = ChannelConfig {
        rotation: rotation(&mut random),
        bias: [0.01, -0.02, 0.03],
        noise_density: 8.7e-5,
        ..ChannelConfig::ideal()
    };
    let mut channel = Channel::new(imu, pass, 2e-3, seed.stream(Stream::ImuGyro));
    let per_unit = 65.5 * 180.0 / std::f64::consts::PI;
    let (times, rates): (Vec<f64>, Vec<[f64; 3]>) = ((BEGIN - 1) * 500..(BEGIN + LENGTH + 1) * 500)
        .enumerate()
        .map(|(n, k)| {
            let at = board.true_at(SimTime::from_nanos(k * 2_000_000));
            let w = channel.sample(at.as_secs_f64(), n as u64, 2e-3, |t| motion.angular_rate(t));
            let w = w.map(|w| f64::from(quantise(w, per_unit)) / per_unit);
            (k as f64 * 2e-3, w)
        })
        .unzip();
    let board_track = GyroTrack::from_seconds(&times, rates);

    let options = Options {
        a_delay_s: pass.delay_s,
        b_delay_s: phone_delay_s,
        ..Options::default()
    };
    let estimate = estimate_offset(&board_track, &phone_track, &options).unwrap();
    let reference = estimate.clock.reference;
    let at = board.true_at(SimTime::from_nanos((reference * 1e9) as u64));
    let truth = phone.oscillator().nanos_at(at) as f64 * 1e-9 - reference;
    (
        (estimate.clock.offset - truth) * 1e6,
        estimate.offset_sigma_s() * 1e6,
    )
}

#[test]
fn the_estimate_is_the_truth_about_the_clocks() {
    let _turn = turn::beside_others();
    let results: Vec<(f64, f64)> = (0..12).map(twist).collect();
    let n = results.len() as f64;
    let rms = (results.iter().map(|(e, _)| e * e).sum::<f64>() / n).sqrt();
    let normalised = (results.iter().map(|(e, s)| (e / s).powi(2)).sum::<f64>() / n).sqrt();
    println!("offset errors: RMS {rms:.2} us, {normalised:.2} sigma RMS");
    for (seed, (error, sigma)) in results.iter().enumerate() {
        println!("  seed {seed}: {error:+.2} us, sigma {sigma:.2} us");
    }
    assert!(rms < 12.0, "RMS {rms} us");
    // Chi-squared of 12 values: within 0.4 and 1.7 with 99.9 %.
    assert!((0.4..1.7).contains(&normalised), "{normalised} sigma RMS");
}
