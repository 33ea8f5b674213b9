//! `smartdepthsync phone …` as a process against the simulated phone.

use std::process::Command;

use rig::phone::VideoMode;

use test_support::processes::run;

use crate::phone_bench::PhoneBench;

#[test]
fn imu_start_stop_and_get_video() {
    for version in ["v.0.1", "v.0.1.1"] {
        let bench = PhoneBench::new(20, 10.0, |c| {
            c.version = version.to_owned();
            c.camera.rows = 120;
            c.camera.columns = 16;
        });
        let folder = tempfile::tempdir().unwrap();
        let run = |arguments: &[&str]| bench.command(arguments, folder.path());
        let json = |arguments: &[&str]| {
            let ran = run(arguments);
            ran.ended_with(0, &[]);
            ran.json()
        };

        let imu = ["imu", "--duration", "2s", "--out", "gyro.csv", "--json"];
        let imu = json(&imu);
        let rate = imu["rate_hz"].as_f64().unwrap();
        let true_rate = bench.phone.app.config.gyroscope.rate_hz;
        assert!(
            (rate / true_rate - 1.0).abs() < 1e-4,
            "{rate} Hz of {true_rate} Hz"
        );
        assert!(folder.path().join("gyro.csv").exists());

        assert_eq!(json(&["stop", "--json"])["stopped"], false);
        let start = json(&["start", "--json"]);
        let video = bench.phone.app.videos()[0].clone();
        let phase = start["phase_ns"].as_i64().unwrap();
        assert!((phase - video.frames.start_ns(60)).abs() < 6_000);
        assert_eq!(start["exposure_ns"].is_u64(), version == "v.0.1.1");
        let refused = run(&["imu", "--duration", "1s"]);
        refused.ended_with(12, &["stop the video first"]);
        assert_eq!(json(&["stop", "--json"])["stopped"], true);

        let saved = json(&["get-video", "--recorded", "--json"]);
        let path = folder.path().join(saved["path"].as_str().unwrap());
        bench.phone.app.wait_saved().unwrap();
        assert!(std::fs::read(&path).unwrap() == std::fs::read(&video.path).unwrap());
        let count = bench.phone.app.videos()[0].count.unwrap();
        assert_eq!(frames_of(&path), count);
    }
}

fn frames_of(path: &std::path::Path) -> usize {
    let mut ffprobe = Command::new("ffprobe");
    ffprobe
        .args(["-v", "error", "-count_frames", "-of", "csv=p=0"])
        .args(["-show_entries", "stream=nb_read_frames"]);
    let frames = run(ffprobe.arg(path)).json();
    frames.as_u64().unwrap() as usize
}

#[test]
fn a_busy_phone_serves_the_next_client_when_the_first_leaves() {
    let bench = PhoneBench::new(22, 20.0, |_| ());
    let folder = tempfile::tempdir().unwrap();
    let other = bench.occupy();
    let blocked = bench.command(&["stop", "--timeout", "0.5s"], folder.path());
    blocked.ended_with(12, &["one at a time"]);
    drop(other);
    let served = bench.command(&["stop"], folder.path());
    served.ended_with(0, &[]);
}

#[test]
fn a_phone_that_goes_away_is_noticed() {
    let bench = PhoneBench::new(24, 1.0, |c| c.video = VideoMode::Never);
    let folder = tempfile::tempdir().unwrap();
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while bench.clock.waiters() == 0 {
                std::thread::sleep(std::time::Duration::from_millis(10));
            }
            bench.phone.leave_network();
        });
        let output = bench.command(&["imu", "--duration", "20s"], folder.path());
        output.ended_with(12, &["closed the connection"]);
    });
    let stop = bench.command(&["stop"], folder.path());
    stop.ended_with(12, &["same network"]);
}

#[test]
fn a_probe_changes_nothing() {
    use phone::{PhoneClient, ServerVersion, Settings};
    let bench = PhoneBench::new(25, 20.0, |_| ());
    let mut client = PhoneClient::connect(&bench.address(), Settings::default()).unwrap();
    assert_eq!(client.version(), None);
    for _ in 0..3 {
        assert_eq!(client.probe().unwrap(), ServerVersion::V0_1_1);
    }
    assert!(!bench.phone.app.is_recording());
    // The connection is still in step.
    client.stop_video().unwrap();
}
