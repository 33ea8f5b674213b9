//! `smartdepthsync phone …` as a process against the simulated phone.

use std::process::{Command, Output};

use rig::phone::VideoMode;

use crate::phone_bench::Bench;

fn json(output: &Output) -> serde_json::Value {
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{stderr}");
    serde_json::from_slice(&output.stdout).unwrap()
}

fn fails(output: &Output, code: i32, words: &str) {
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{stderr}");
    assert!(stderr.contains(words), "{words:?} not in: {stderr}");
}

#[test]
fn imu_start_stop_and_get_video() {
    for version in ["v.0.1", "v.0.1.1"] {
        let bench = Bench::new(20, 10.0, |c| {
            c.version = version.to_owned();
            c.camera.rows = 120;
            c.camera.columns = 16;
        });
        let folder = tempfile::tempdir().unwrap();
        let run = |arguments: &[&str]| bench.command(arguments, folder.path());

        let imu = ["imu", "--duration", "2s", "--out", "gyro.csv", "--json"];
        let imu = json(&run(&imu));
        let rate = imu["rate_hz"].as_f64().unwrap();
        let true_rate = bench.phone.app.config.gyroscope.rate_hz;
        assert!(
            (rate / true_rate - 1.0).abs() < 1e-4,
            "{rate} Hz of {true_rate} Hz"
        );
        assert!(folder.path().join("gyro.csv").exists());

        assert_eq!(json(&run(&["stop", "--json"]))["stopped"], false);
        let start = json(&run(&["start", "--json"]));
        let video = bench.phone.app.videos()[0].clone();
        let phase = start["phase_ns"].as_i64().unwrap();
        assert!((phase - video.frames.start_ns(60)).abs() < 6_000);
        assert_eq!(start["exposure_ns"].is_u64(), version == "v.0.1.1");
        fails(
            &run(&["imu", "--duration", "1s"]),
            12,
            "stop the video first",
        );
        assert_eq!(json(&run(&["stop", "--json"]))["stopped"], true);

        let saved = json(&run(&["get-video", "--recorded", "--json"]));
        let path = folder.path().join(saved["path"].as_str().unwrap());
        bench.phone.app.wait_saved().unwrap();
        assert!(std::fs::read(&path).unwrap() == std::fs::read(&video.path).unwrap());
        let count = bench.phone.app.videos()[0].count.unwrap();
        assert_eq!(frames_of(&path), count);
    }
}

fn frames_of(path: &std::path::Path) -> usize {
    let out = Command::new("ffprobe")
        .args(["-v", "error", "-count_frames", "-of", "csv=p=0"])
        .args(["-show_entries", "stream=nb_read_frames"])
        .arg(path)
        .output()
        .unwrap();
    String::from_utf8(out.stdout)
        .unwrap()
        .trim()
        .parse()
        .unwrap()
}

#[test]
fn a_busy_phone_serves_the_next_client_when_the_first_leaves() {
    let bench = Bench::new(22, 20.0, |_| ());
    let folder = tempfile::tempdir().unwrap();
    let other = bench.occupy();
    let blocked = bench.command(&["stop", "--timeout", "0.5s"], folder.path());
    fails(&blocked, 12, "one at a time");
    drop(other);
    let served = bench.command(&["stop"], folder.path());
    assert_eq!(served.status.code(), Some(0));
}

#[test]
fn a_phone_that_goes_away_is_noticed() {
    let bench = Bench::new(24, 1.0, |c| c.video = VideoMode::Never);
    let folder = tempfile::tempdir().unwrap();
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while bench.clock.waiters() == 0 {
                std::thread::sleep(std::time::Duration::from_millis(10));
            }
            bench.phone.leave_network();
        });
        let output = bench.command(&["imu", "--duration", "20s"], folder.path());
        fails(&output, 12, "closed the connection");
    });
    fails(&bench.command(&["stop"], folder.path()), 12, "same network");
}

#[test]
fn a_probe_changes_nothing() {
    use phone::{PhoneClient, ServerVersion, Settings};
    let bench = Bench::new(25, 20.0, |_| ());
    let mut client = PhoneClient::connect(&bench.address(), Settings::default()).unwrap();
    assert_eq!(client.version(), None);
    for _ in 0..3 {
        assert_eq!(client.probe().unwrap(), ServerVersion::V0_1_1);
    }
    assert!(!bench.phone.app.is_recording());
    // The connection is still in step.
    client.stop_video().unwrap();
}
