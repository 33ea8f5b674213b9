//! The simulated phone is as rude as the app. Each test names the line of the app's source
//! that it is about: RRH is `RemoteRpcRequestHandler.java`, RSS `RemoteRpcServer.java`,
//! EAI `ExtendedAppInterface.java`, of prime-slam/OpenCamera-Sensors at v1.48.3.1.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use rig::phone::{PhoneConfig, StorageAccess, VideoMode};

use crate::phone_bench::{Bench, Raw};

const IMU: &str = "imu?duration=200&accel=0&gyro=1&magnetic=0";
const BUSY: [&str; 3] = ["ERROR", "v.0.1.1", "Error in IMU recording"];

fn without_pictures(c: &mut PhoneConfig) {
    c.video = VideoMode::Never;
}

fn until(what: &str, mut is: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !is() {
        assert!(begun.elapsed() < Duration::from_secs(60), "{what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Lets true time pass until the session of the video before is closed.
fn until_free(bench: &Bench, phone: &mut Raw) {
    until("the sensors are free", || {
        bench.pass(0.05);
        bench.ask(phone, IMU) != BUSY
    });
}

/// `Preview.java`:1048 and CameraController2.java:5277 (the session closes later), EAI:237
/// (the sensors end with it), RRH:67.
#[test]
fn a_stop_takes_its_time_and_the_sensors_are_busy_meanwhile() {
    let bench = Bench::held(50, |c| {
        without_pictures(c);
        c.app.stop_ms = 3_000.0;
    });
    let mut phone = bench.connect();
    assert_eq!(bench.ask(&mut phone, "video_start")[0], "SUCCESS");
    assert_eq!(phone.ask("video_stop")[0], "SUCCESS");
    assert_eq!(phone.ask(IMU), BUSY);
    bench.pass(2.9);
    assert_eq!(phone.ask(IMU), BUSY);
    bench.pass(0.2);
    until_free(&bench, &mut phone);
    // Until then a press does nothing, so a start behind a stop fails.
    assert_eq!(bench.ask(&mut phone, "video_start")[0], "SUCCESS");
    phone.ask("video_stop");
    assert_eq!(bench.ask(&mut phone, "video_start")[0], "ERROR");
    assert!(!bench.phone.is_recording());
}

/// RRH:157 (the press is not awaited), RRH:164 (the queue is asked at once).
#[test]
fn the_phase_of_a_video_begun_by_hand_answers_a_start_that_stops_it() {
    let bench = Bench::held(51, without_pictures);
    bench.phone.press_record();
    bench.pass(5.0);
    // In no time.
    let answer = bench.connect().ask("video_start");
    assert_eq!(answer[0], "SUCCESS");
    let phase: i64 = answer[2].parse().unwrap();
    let video = bench.phone.videos()[0].clone();
    assert!((phase - video.frames.start_ns(60)).abs() < 10_000);
    assert!(!bench.phone.is_recording());
}

/// The same after a start whose phase came too late: RRH:34, `VideoFrameInfo.java`:145.
#[test]
fn the_phase_of_slow_frames_answers_the_next_start() {
    let bench = Bench::held(52, |c| {
        without_pictures(c);
        c.camera.frame_period_ns = 200e6;
    });
    let mut phone = bench.connect();
    assert_eq!(bench.ask(&mut phone, "video_start")[0], "ERROR");
    assert!(bench.phone.is_recording());
    bench.pass(5.0);
    assert_eq!(phone.ask("video_start")[0], "SUCCESS");
    assert!(!bench.phone.is_recording());
}

/// `Preview.java`:5020.
#[test]
fn a_press_right_behind_a_start_is_ignored() {
    let bench = Bench::held(53, without_pictures);
    bench.phone.press_record();
    bench.pass(0.4);
    bench.phone.press_record();
    assert!(bench.phone.is_recording());
    bench.pass(0.2);
    bench.phone.press_record();
    assert!(!bench.phone.is_recording());
}

/// RRH:164: nothing comes into the queue any more.
#[test]
fn a_video_stopped_before_frame_sixty_ends_in_the_timeout() {
    let bench = Bench::held(54, without_pictures);
    let mut phone = bench.connect();
    phone.send("video_start\n");
    until("it records", || bench.phone.is_recording());
    bench.pass(1.0);
    bench.phone.press_record();
    let answer = bench.answer(&mut phone);
    assert!(answer[2].contains("poll limit"), "{answer:?}");
    assert!(bench.clock.now().as_secs_f64() > 9.9);
}

/// RRH:208, in a thread that nobody guards.
#[test]
fn get_video_without_a_video_ends_the_app() {
    let bench = Bench::new(55, 10.0, |c| {
        c.camera.rows = 64;
        c.camera.columns = 16;
    });
    let ended = || {
        let mut left = TcpStream::connect(bench.phone.address()).unwrap();
        left.write_all(b"get_video\n").unwrap();
        assert_eq!(left.read(&mut [0]).unwrap(), 0);
        until("it listens", || {
            TcpStream::connect(bench.phone.address()).is_err()
        });
    };
    ended();
    bench.phone.reopen_app().unwrap();
    let mut phone = bench.connect();
    phone.ask("video_start");
    phone.ask("video_stop");
    assert_eq!(phone.ask("get_video")[0], "SUCCESS");
    // A video of before it was opened does not count.
    drop(phone);
    bench.phone.reopen_app().unwrap();
    ended();
}

/// RSS:76: `Long.parseLong` of more digits than it has.
#[test]
fn a_duration_that_overflows_ends_the_app() {
    let bench = Bench::new(56, 10.0, without_pictures);
    bench.phone.press_record();
    let mut phone = TcpStream::connect(bench.phone.address()).unwrap();
    phone
        .write_all(b"imu?duration=9223372036854775808&accel=0&gyro=1&magnetic=0\n")
        .unwrap();
    assert_eq!(phone.read(&mut [0]).unwrap(), 0);
    assert!(!bench.phone.is_recording());
}

/// RRH:203 waits for what only `Preview.java`:1072 gives, and that only for files.
#[test]
fn with_storage_access_get_video_behind_a_stop_hangs_for_good() {
    let bench = Bench::held(57, |c| {
        c.camera.rows = 64;
        c.camera.columns = 16;
        c.app.storage = StorageAccess::Documents;
        c.app.stop_ms = 1_000.0;
    });
    let mut phone = bench.connect();
    bench.ask(&mut phone, "video_start");
    phone.ask("video_stop");
    phone.send("get_video\n");
    assert!(phone.is_silent(Duration::from_secs(1)));
    bench.pass(5.0);
    assert!(phone.is_silent(Duration::from_millis(500)));
    drop(phone);
    let mut next = bench.connect();
    next.send("\n");
    assert!(next.is_silent(Duration::from_millis(500)));
    drop(next);
    bench.phone.reopen_app().unwrap();
    let mut phone = bench.connect();
    bench.ask(&mut phone, "video_start");
    phone.ask("video_stop");
    until_free(&bench, &mut phone);
    assert_eq!(phone.ask("get_video")[0], "SUCCESS");
}

/// EAI:297 (the ticks decide which files there are), `RawSensorInfo.java`:216 (also of a
/// sensor that the phone lacks).
#[test]
fn a_sensor_that_is_not_ticked_has_no_file_and_one_that_is_missing_an_empty_one() {
    let all = "imu?duration=500&accel=1&gyro=1&magnetic=1";
    let bench = Bench::new(58, 10.0, |c| {
        c.app.ticked = [false, true, true];
        c.magnetometer = None;
    });
    let answer = bench.connect().ask(all);
    let names: Vec<&str> = answer
        .iter()
        .filter(|line| line.ends_with(".csv"))
        .map(|name| name.get(19..).unwrap())
        .collect();
    assert_eq!(names, ["gyro.csv", "magnetic.csv"]);
    let magnetic = answer.len() - 2;
    assert!(answer[magnetic].ends_with("magnetic.csv"));
    assert_eq!(answer[magnetic + 1], "sensor_end");
    // Up to v1.48.2.9 the request ticks them (RRH:70, before it became a comment).
    let bench = Bench::new(58, 10.0, |c| {
        without_pictures(c);
        c.app.ticked = [false, true, true];
        c.app.imu_rewrites_ticks = true;
    });
    let mut phone = bench.connect();
    let answer = phone.ask("imu?duration=500&accel=1&gyro=0&magnetic=0");
    assert!(answer[2].ends_with("accel.csv"), "{}", answer[2]);
    phone.ask("video_start");
    phone.ask("video_stop");
    bench.phone.wait_saved().unwrap();
    let timestamps = bench.phone.videos()[0].timestamps.clone();
    let beside = |suffix: &str| {
        let name = timestamps.to_str().unwrap();
        std::path::Path::new(&name.replace("_imu_timestamps", suffix)).exists()
    };
    assert!(beside("accel") && !beside("gyro") && !beside("magnetic"));
}

/// `StorageUtils.java`:640 and 714; with storage access the system's own number.
#[test]
fn two_recordings_within_a_second_have_numbers() {
    for (storage, number) in [
        (StorageAccess::Files, "_1"),
        (StorageAccess::Documents, " (1)"),
    ] {
        let bench = Bench::held(59, |c| c.app.storage = storage);
        let mut phone = bench.connect();
        let names = [(); 2].map(|()| {
            phone.send("imu?duration=1&accel=0&gyro=1&magnetic=0\n");
            bench.wait_for_waiter();
            bench.pass(0.002);
            phone.answer()[2].clone()
        });
        let ending = format!("gyro{number}.csv");
        assert!(names[1].ends_with(&ending), "{names:?}");
    }
}

/// RRH:128 gives no reason.
#[test]
fn a_file_that_cannot_be_opened_is_told_without_detail() {
    let bench = Bench::held(60, |_| ());
    let mut phone = bench.connect();
    phone.send("imu?duration=1000&accel=0&gyro=1&magnetic=0\n");
    bench.wait_for_waiter();
    let folder = std::fs::read_dir(bench.phone.storage()).unwrap().next();
    std::fs::remove_dir_all(folder.unwrap().unwrap().path()).unwrap();
    assert_eq!(bench.answer(&mut phone)[2], "Failed to open IMU file");
}

/// RSS:153: `readLine` gives the last line without its end; what a client has left is
/// carried out when its turn comes.
#[test]
fn requests_of_clients_that_have_gone_are_carried_out() {
    for request in ["video_start", "video_start\n"] {
        let bench = Bench::new(61, 10.0, without_pictures);
        let mut first = bench.connect();
        assert_eq!(first.ask("x")[0], "ERROR");
        let mut second = TcpStream::connect(bench.phone.address()).unwrap();
        second.write_all(request.as_bytes()).unwrap();
        drop(second);
        std::thread::sleep(Duration::from_millis(100));
        assert!(!bench.phone.is_recording());
        drop(first);
        until("it records", || bench.phone.is_recording());
    }
}

/// `MainActivity.java`, `onPause`: what runs ends, and so does the server; RSS:134 and 169:
/// a client that stays keeps the port from the next.
#[test]
fn in_the_background_recordings_and_server_end() {
    let bench = Bench::held(62, |c| {
        without_pictures(c);
        c.app.background_ms = 500.0;
    });
    let mut phone = bench.connect();
    phone.send("imu?duration=4000&accel=0&gyro=1&magnetic=0\n");
    bench.wait_for_waiter();
    bench.pass(1.0);
    bench.phone.send_to_background();
    let answer = bench.answer(&mut phone);
    let count = answer.len() - 4;
    assert!((500..1_200).contains(&count), "{count}");
    until("it listens", || {
        TcpStream::connect(bench.phone.address()).is_err()
    });
    assert!(bench.phone.bring_to_foreground().unwrap());

    let mut phone = bench.connect();
    assert_eq!(bench.ask(&mut phone, "video_start")[0], "SUCCESS");
    // The server looks whether it is to end once behind each answer: let it wait for the
    // next request first.
    std::thread::sleep(Duration::from_millis(200));
    bench.phone.send_to_background();
    // Held all the time: the new server does not get the port.
    bench.pass(3.0);
    until("the video ends", || !bench.phone.is_recording());
    assert!(!bench.phone.bring_to_foreground().unwrap());
    assert_eq!(phone.ask("x")[0], "ERROR");
    until("it listens", || {
        TcpStream::connect(bench.phone.address()).is_err()
    });
    bench.phone.send_to_background();
    assert!(bench.phone.bring_to_foreground().unwrap());
    assert_eq!(bench.connect().ask("x")[0], "ERROR");
}
