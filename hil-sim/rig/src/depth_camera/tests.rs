use super::config::PULSE_TOO_SHORT;
use super::*;
use crate::clocks::oscillator::OscillatorConfig;
use stm32f4_sim::model_bench::ModelBench;

const US: SimDuration = SimDuration::from_micros(1);

/// A camera on a board that is 20 ppm fast.
fn camera(config: DepthCameraConfig) -> ModelBench<DepthCamera> {
    let seed = Seed(6);
    ModelBench::new(DepthCamera::new(config, board(), seed))
}

fn board() -> BoardTime {
    BoardTime::new(
        OscillatorConfig {
            rate_ppm: 20.0,
            ..OscillatorConfig::default()
        },
        Seed(6).stream(Stream::BoardClock),
    )
}

fn steady() -> DepthCameraConfig {
    DepthCameraConfig {
        clock: OscillatorConfig {
            offset_ns: 2_500_000_000,
            rate_ppm: 300.0,
            wander: 0.0,
            ..OscillatorConfig::default()
        },
        ..DepthCameraConfig::default()
    }
}

/// A pulse whose rising edge is at `at`.
fn pulse(bench: &mut ModelBench<DepthCamera>, at: SimTime, width: SimDuration) {
    bench.run_until(at);
    bench.set_pin(Pin::PA5, Level::High);
    bench.run_until(at + width);
    bench.set_pin(Pin::PA5, Level::Low);
}

fn ms(ms: f64) -> SimTime {
    SimTime::from_nanos((ms * 1e6).round() as u64)
}

/// Pulses of 12 µs at the given milliseconds, and 30 ms after the last.
fn train(bench: &mut ModelBench<DepthCamera>, at: impl IntoIterator<Item = f64>) {
    let mut last = SimTime::ZERO;
    for at in at {
        last = ms(at);
        pulse(bench, last, SimDuration::from_micros(12));
    }
    bench.run_until(last + SimDuration::from_millis(30));
}

const PERIOD_MS: f64 = 33.330_652;

fn times(n: u32) -> impl Iterator<Item = f64> {
    (1..=n).map(|k| f64::from(k) * PERIOD_MS)
}

#[test]
fn a_pulse_of_8_us_is_too_short_and_one_unit_more_is_enough() {
    for (width, counts) in [
        (US.saturating_mul(2), false),
        (PULSE_TOO_SHORT, false),
        (PULSE_TOO_SHORT + SimDuration::from_units(1), true),
        (US.saturating_mul(9), true),
        (US.saturating_mul(5000), true),
    ] {
        let mut bench = camera(steady());
        for k in 1..=5u64 {
            pulse(&mut bench, ms(k as f64 * PERIOD_MS), width);
        }
        bench.run(SimDuration::from_millis(10));
        assert_eq!(bench.model.pulses == 5, counts, "{width:?}");
        assert_eq!(bench.model.frame_count == 4, counts);
        assert_eq!(bench.model.short_pulses == 0, counts);
    }
}

#[test]
fn it_keeps_streaming_on_its_own_clock_when_the_pulses_stop() {
    let mut bench = camera(steady());
    train(&mut bench, times(10));
    bench.run(SimDuration::from_secs(10));
    let frames = bench.model.take_frames();
    let (driven, free): (Vec<FrameRecord>, Vec<FrameRecord>) = frames
        .iter()
        .copied()
        .partition(|f| matches!(f.source, Source::Pulse { .. }));
    assert_eq!(driven.len(), 9);
    assert!((300..=301).contains(&free.len()), "{}", free.len());
    let own = (1.0 + 20e-6) / (1.0 + 300e-6);
    for pair in frames[8..].windows(2) {
        let period = (pair[1].center - pair[0].center).as_secs_f64() * 1e6;
        assert!((period - 1e6 / 30.0 * own).abs() < 1e-4, "{period}");
        let ticks = pair[1].device_ticks - pair[0].device_ticks;
        assert_eq!(ticks, 3000);
    }
    assert!(frames.iter().all(|f| !f.bad));
    assert_eq!(bench.model.disturbances, 0);
}

#[test]
fn steps_within_the_tolerance_disturb_nothing_and_are_followed() {
    let mut bench = camera(steady());
    // 150 µs later each frame.
    train(
        &mut bench,
        (1..=60).map(|k| f64::from(k) * (PERIOD_MS + 0.150)),
    );
    let frames = bench.model.take_frames();
    assert_eq!(frames.len(), 59);
    assert!(frames.iter().all(|f| !f.bad && f.source != Source::FreeRun));
}

#[test]
fn a_jump_spoils_the_frames_of_that_time_and_the_new_phase_is_taken_up() {
    for jump_ms in [0.3, 5.0, 14.0, 20.0, 30.0, -0.3, -5.0, -14.0, -20.0] {
        let mut bench = camera(steady());
        let at = (1..=60).map(|k| f64::from(k) * PERIOD_MS + if k > 30 { jump_ms } else { 0.0 });
        train(&mut bench, at);
        assert!(bench.model.disturbances >= 1, "{jump_ms}");
        assert!(bench.model.disturbances <= 2, "{jump_ms}");
        let frames = bench.model.take_frames();
        let bad: Vec<_> = frames.iter().filter(|f| f.bad).collect();
        assert!((3..=5).contains(&bad.len()), "{jump_ms}: {}", bad.len());
        // Bad only around the jump.
        let jump = ms(30.0 * PERIOD_MS);
        for frame in &bad {
            let distance = frame.center.as_secs_f64() - jump.as_secs_f64();
            assert!((-0.02..0.2).contains(&distance), "{jump_ms}: {distance}");
        }
        // The last 20 pulses all made good frames of their own.
        for frame in &frames[frames.len() - 20..] {
            assert!(!frame.bad);
            let Source::Pulse { edge, .. } = frame.source else {
                panic!("free-running after the jump");
            };
            assert!((frame.center - edge).as_nanos() < 7_000_000);
        }
        // Light never overlaps.
        let ups = bench.times(Pin::PA2, Drive::High);
        assert_eq!(ups.len(), frames.len() * 9);
        assert!(ups.windows(2).all(|w| w[0] < w[1]));
    }
}

#[test]
fn a_pulse_that_is_still_being_judged_holds_the_free_run_back() {
    let mut bench = camera(steady());
    train(&mut bench, times(5));
    // The camera's period is 33.323 ms of board time here, so patience ends at
    // 200 µs after: this rises 4 µs before the end.
    let last = 5.0 * PERIOD_MS;
    let own = (1.0 + 20e-6) / (1.0 + 300e-6);
    let deadline = last + (1e3 / 30.0 + 0.2) * own;
    pulse(
        &mut bench,
        ms(deadline - 0.004),
        SimDuration::from_micros(12),
    );
    bench.run(SimDuration::from_millis(20));
    let frames = bench.model.take_frames();
    assert_eq!(frames.len(), 5);
    assert!(frames.iter().all(|f| f.source != Source::FreeRun && !f.bad));
    // The same, but too short: the frame comes from the camera itself.
    let mut bench = camera(steady());
    train(&mut bench, times(5));
    pulse(
        &mut bench,
        ms(deadline - 0.004),
        SimDuration::from_micros(6),
    );
    bench.run(SimDuration::from_millis(20));
    let frames = bench.model.take_frames();
    assert_eq!(frames.len(), 5);
    assert_eq!(frames[4].source, Source::FreeRun);
    let first_flash = frames[4].first_flash.as_secs_f64() * 1e3;
    assert!((first_flash - (last + (1e3 / 30.0 + 0.5) * own)).abs() < 1e-5);
}

#[test]
fn it_can_be_stopped_and_opened_again() {
    let mut bench = camera(steady());
    train(&mut bench, times(5));
    bench.model.stop();
    bench.run(SimDuration::from_secs(1));
    assert_eq!(bench.model.frame_count, 4);
    bench.model.wait_for_pulses();
    train(&mut bench, (60..70).map(|k| f64::from(k) * PERIOD_MS));
    assert_eq!(bench.model.frame_count, 4 + 9);
}

#[test]
fn without_a_photodiode_the_strobe_input_is_not_driven() {
    let mut bench = camera(DepthCameraConfig {
        photodiode: false,
        ..steady()
    });
    train(&mut bench, times(5));
    assert!(bench.driven.is_empty());
    assert_eq!(bench.model.frame_count, 4);
}

/// Each family follows pulses of 100 µs, as their makers ask for; pulses for the Azure Kinect
/// only the Azure Kinect.
#[test]
fn each_family_follows_its_own_pulses() {
    for family in Family::ALL {
        for seed in 1..20 {
            let config = family.specimen(steady(), Seed(seed));
            for width_us in [12, 100] {
                let mut bench = camera(config);
                for at in times(10) {
                    pulse(&mut bench, ms(at), SimDuration::from_micros(width_us));
                }
                bench.run_until(ms(10.0 * PERIOD_MS + 300.0));
                let frames = bench.model.take_frames();
                let (of_pulses, alone): (Vec<_>, Vec<_>) = frames
                    .into_iter()
                    .partition(|frame| matches!(frame.source, Source::Pulse { .. }));
                let follows = width_us > 12 || family == Family::AzureKinect;
                let expected = if follows { 11 - config.first_frame } else { 0 };
                assert_eq!(
                    of_pulses.len() as u32,
                    expected,
                    "{family:?}, {width_us} µs"
                );
                let goes_on = follows && config.free_runs;
                assert_eq!(!alone.is_empty(), goes_on, "{family:?}");
            }
        }
    }
}
