//! The simulated phone is as rude as the app. Each test names the line of the app's source
//! that it is about: RRH is `RemoteRpcRequestHandler.java`, RSS `RemoteRpcServer.java`,
//! EAI `ExtendedAppInterface.java`, of prime-slam/OpenCamera-Sensors at v1.48.3.1.

use rig::phone::{PhoneConfig, VideoMode};

use crate::phone_bench::PhoneBench;

const IMU: &str = "imu?duration=200&accel=0&gyro=1&magnetic=0";
const BUSY: [&str; 3] = ["ERROR", "v.0.1.1", "Error in IMU recording"];

fn without_pictures(c: &mut PhoneConfig) {
    c.video = VideoMode::Never;
}

/// `Preview.java`:1048 and CameraController2.java:5277 (the session closes later), EAI:237
/// (the sensors end with it), RRH:67.
#[test]
fn a_stop_takes_its_time_and_the_sensors_are_busy_meanwhile() {
    let mut bench = PhoneBench::new(50, |c| {
        without_pictures(c);
        c.app.stop_ms = 3_000.0;
    });
    assert_eq!(bench.ask("video_start")[0], "SUCCESS");
    assert_eq!(bench.ask("video_stop")[0], "SUCCESS");
    assert_eq!(bench.ask(IMU), BUSY);
    bench.pass(2.9);
    assert_eq!(bench.ask(IMU), BUSY);
    bench.pass(0.2);
    assert_eq!(bench.ask(IMU)[0], "SUCCESS");
    // Until then a press does nothing, so a start after a stop fails.
    assert_eq!(bench.ask("video_start")[0], "SUCCESS");
    bench.ask("video_stop");
    assert_eq!(bench.ask("video_start")[0], "ERROR");
    assert!(!bench.phone.app.is_recording());
}

/// RRH:157 (the press is not awaited), RRH:164 (the queue is asked at once).
#[test]
fn the_phase_of_a_video_begun_by_hand_answers_a_start_that_stops_it() {
    let mut bench = PhoneBench::new(51, without_pictures);
    bench.phone.app.press_record();
    bench.pass(5.0);
    // In no time.
    let asked = bench.phone.ask("video_start");
    let answer = bench.take(asked).unwrap();
    assert_eq!(answer[0], "SUCCESS");
    let phase: i64 = answer[2].parse().unwrap();
    let video = bench.phone.app.videos()[0].clone();
    assert!((phase - video.frames.start_ns(60)).abs() < 10_000);
    assert!(!bench.phone.app.is_recording());
}

/// `Preview.java`:5020.
#[test]
fn a_press_right_after_a_start_is_ignored() {
    let mut bench = PhoneBench::new(53, without_pictures);
    bench.phone.app.press_record();
    bench.pass(0.4);
    bench.phone.app.press_record();
    assert!(bench.phone.app.is_recording());
    bench.pass(0.2);
    bench.phone.app.press_record();
    assert!(!bench.phone.app.is_recording());
}

/// RRH:164: the queue receives nothing further.
#[test]
fn a_video_stopped_before_frame_sixty_ends_in_the_timeout() {
    let mut bench = PhoneBench::new(54, without_pictures);
    let asked = bench.phone.ask("video_start");
    assert!(bench.phone.app.is_recording());
    bench.pass(1.0);
    bench.phone.app.press_record();
    let answer = bench.answer(asked);
    assert!(answer[2].contains("poll limit"), "{answer:?}");
    assert!(bench.clock.now().as_secs_f64() > 9.9);
}

/// RSS:76, `Long.parseLong` of more digits than it has, in a thread that nobody guards.
#[test]
fn a_number_that_is_too_large_ends_the_app() {
    let mut bench = PhoneBench::new(55, without_pictures);
    bench.phone.app.press_record();
    let overflow = "imu?duration=9223372036854775808&accel=0&gyro=1&magnetic=0";
    assert!(bench.ask(overflow).is_empty());
    assert!(bench.ask("x").is_empty(), "nobody listens");
    assert!(!bench.phone.app.is_recording());
}

/// EAI:297 (the ticks decide which files there are), `RawSensorInfo.java`:216 (also of a
/// sensor that the phone lacks).
#[test]
fn a_sensor_that_is_not_ticked_has_no_file_and_one_that_is_missing_an_empty_one() {
    let mut bench = PhoneBench::new(58, |c| c.app.ticked = [false, true, true]);
    let answer = bench.ask("imu?duration=500&accel=1&gyro=1&magnetic=1");
    let names: Vec<&str> = answer
        .iter()
        .filter(|line| line.ends_with(".csv"))
        .map(|name| name.get(19..).unwrap())
        .collect();
    assert_eq!(names, ["gyro.csv", "magnetic.csv"]);
    let magnetic = answer.len() - 2;
    assert!(answer[magnetic].ends_with("magnetic.csv"));
    assert_eq!(answer[magnetic + 1], "sensor_end");
}

/// RRH:128 gives no reason.
#[test]
fn a_file_that_cannot_be_opened_is_reported_without_detail() {
    let mut bench = PhoneBench::new(60, |_| ());
    let asked = bench.phone.ask(IMU);
    let folder = std::fs::read_dir(bench.phone.app.storage()).unwrap().next();
    std::fs::remove_dir_all(folder.unwrap().unwrap().path()).unwrap();
    assert_eq!(bench.answer(asked)[2], "Failed to open IMU file");
}
