//! `smartdepthsync sync` as a process: forms of recordings, three devices, whole recordings.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use recording::messages::Imu;
use recording::rosbag2::Bag;
use serde_json::Value;
use twist_scenarios::{SENSOR_B, Sensor, Twist, TwistSpec};
use twist_sync::GyroTrack;

use crate::support::gopro::{self, Stamps};
use crate::support::{nanos, phone_app, ros2_imu};

fn sync(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_smartdepthsync"))
        .current_dir(folder)
        .arg("sync")
        .args(args)
        .output()
        .unwrap()
}

fn json(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {output:?}"))
}

/// As EuRoC has it, with an accelerometer.
fn euroc(path: PathBuf, track: &GyroTrack) {
    let mut out = String::from(
        "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],\
         a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n",
    );
    for (at, w) in nanos(track).zip(&track.w) {
        writeln!(out, "{at},{},{},{},0,0,9.8", w[0], w[1], w[2]).unwrap();
    }
    std::fs::write(path, out).unwrap();
}

fn app(path: PathBuf, track: &GyroTrack) {
    std::fs::write(path, phone_app(track)).unwrap();
}

/// A ROS 2 bag with two IMUs, the second at rest.
fn ros2(path: PathBuf, track: &GyroTrack) {
    let mut bag = Bag::create(std::io::BufWriter::new(
        std::fs::File::create(path).unwrap(),
    ))
    .unwrap();
    for topic in ["/imu/data", "/imu/other"] {
        bag.add_topic::<Imu>(topic).unwrap();
    }
    for (at, w) in nanos(track).zip(&track.w) {
        for (topic, rate) in [*w, [0.0; 3]].into_iter().enumerate() {
            // Received later than measured: the header counts.
            let received = at.unsigned_abs() + 7_000_000;
            let message = ros2_imu::message(at, rate).unwrap();
            bag.put(topic, received, &message).unwrap();
        }
    }
    bag.finish("bag.mcap").unwrap();
}

/// Offset in s of clock b of a twist at a time of clock a in ns.
fn truth(twist: &Twist, reference: &Value) -> f64 {
    twist.offset_at(reference.as_i64().unwrap() as f64 * 1e-9)
}

fn offset_s(object: &Value) -> f64 {
    object["offset_ns"].as_i64().unwrap() as f64 * 1e-9
}

#[test]
fn three_devices_in_three_forms_have_one_solution() {
    let folder = tempfile::tempdir().unwrap();
    let (spec, seed) = (TwistSpec::default(), 9_000);
    let sensor = Sensor {
        rate_hz: 416.0,
        ..SENSOR_B
    };
    let second = twist_scenarios::twist(&spec, seed);
    let third = twist_scenarios::third(&second, &spec, seed, &sensor);
    euroc(folder.path().join("imu.csv"), &second.a);
    app(folder.path().join("phone.csv"), &second.b);
    ros2(folder.path().join("bag.mcap"), &third.b);
    let files = ["imu.csv", "phone.csv", "bag.mcap@/imu/data"];
    let more = ["--json", "--write", "times", "--plot", "plot.svg"];
    let output = sync(folder.path(), &[&files[..], &more].concat());
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let result = json(&output);
    for (clock, truth_of) in [(0, &second), (1, &third)] {
        let clock = &result["clocks"][clock];
        let error_us = (offset_s(clock) - truth(truth_of, &clock["reference_ns"])) * 1e6;
        let sigma_us = clock["sigma_us"].as_f64().unwrap();
        assert!(
            error_us.abs() < 4.0 * sigma_us && sigma_us < 10.0,
            "{clock}: {error_us}"
        );
    }
    let found = &result["loops"][0];
    assert_eq!(found["recordings"], serde_json::json!([1, 2, 3]));
    let closes = found["closure_rms_us"].as_f64().unwrap();
    assert!(closes < found["sigma_rms_us"].as_f64().unwrap(), "{found}");
    assert!(
        std::fs::read_to_string(folder.path().join("plot.svg"))
            .unwrap()
            .starts_with("<svg")
    );

    // Every timestamp of the phone, in the time of the first.
    let table = std::fs::read_to_string(folder.path().join("times/2_phone.csv")).unwrap();
    let rows: Vec<Vec<i64>> = table
        .lines()
        .skip(1)
        .map(|line| {
            line.split(',')
                .map(|field| field.parse().unwrap())
                .collect()
        })
        .collect();
    assert_eq!(rows.len(), second.b.len());
    for row in &rows {
        let expected = row[0] as f64 * 1e-9 - second.offset_at(row[1] as f64 * 1e-9);
        let error_s = row[1] as f64 * 1e-9 - expected;
        assert!(error_s.abs() < 5e-9 * row[2] as f64, "{row:?}: {error_s}");
    }

    // With two, the numbers are those of `offset`.
    let output = sync(folder.path(), &["--json", "imu.csv", "phone.csv"]);
    let pair = json(&output)["pairs"][0].clone();
    let offset = Command::new(env!("CARGO_BIN_EXE_smartdepthsync"))
        .current_dir(folder.path())
        .args([
            "offset",
            "--json",
            "--mcu",
            "imu.csv",
            "--phone",
            "phone.csv",
        ])
        .output()
        .unwrap();
    let offset = json(&offset);
    let near = |ours: &Value, theirs: &Value, within: f64| {
        let difference = ours.as_f64().unwrap() - theirs.as_f64().unwrap();
        assert!(difference.abs() < within, "{ours} {theirs}");
    };
    near(&pair["skew_ppm"], &offset["skew_ppm"], 1e-4);
    assert!((offset_s(&pair) - offset["offset_s"].as_f64().unwrap()).abs() < 5e-9);
}

/// Microseconds give the clock of a twist as any other file; coarser stamps as well as they are.
#[test]
fn videos_of_gopro_have_times_of_gyroscope_and_rows() {
    let folder = tempfile::tempdir().unwrap();
    let twist = twist_scenarios::twist(&TwistSpec::default(), 9_500);
    app(folder.path().join("a.csv"), &twist.a);
    let file = folder.path().join("GX010001.MP4");
    for (stamps, within_us) in [
        (Stamps::Microseconds, None),
        (Stamps::Milliseconds, Some(1_500.0)),
    ] {
        std::fs::write(&file, gopro::mp4(&twist.b, stamps)).unwrap();
        let args = ["--json", "a.csv", "GX010001.MP4", "--write", "times"];
        let output = sync(folder.path(), &args);
        assert_eq!(output.status.code(), Some(0), "{output:?}");
        let result = json(&output);
        let form = result["recordings"][1]["form"].as_str().unwrap();
        assert!(form.starts_with("GoPro (Hero of tests)"), "{form}");
        assert_eq!(result["recordings"][1]["samples"], twist.b.len());
        let warnings = result["warnings"].to_string();
        let is_coarse = stamps == Stamps::Milliseconds;
        assert_eq!(warnings.contains("289 µs"), is_coarse, "{warnings}");
        let pair = &result["pairs"][0];
        let error_us = (offset_s(pair) - truth(&twist, &pair["reference_ns"])) * 1e6;
        let sigma_us = pair["offset_sigma_us"].as_f64().unwrap();
        let most_us = within_us.unwrap_or(4.0 * sigma_us);
        assert!(
            error_us.abs() < most_us && sigma_us < 20.0,
            "{error_us}: {pair}"
        );

        // Frame 40 begins a third of a second after the second payload.
        let table = folder.path().join("times/2_GX010001_frames.csv");
        let table = std::fs::read_to_string(table).unwrap();
        let row: Vec<i64> = table
            .lines()
            .nth(41)
            .unwrap()
            .split(',')
            .map(|field| field.parse().unwrap())
            .collect();
        let start_s = twist.b.epoch_s + 40.0 / gopro::FRAMES as f64;
        let start_s = start_s - twist.offset_at(row[1] as f64 * 1e-9);
        for (part, found_ns) in [(0.0, row[1]), (0.5, row[2]), (1.0, row[3])] {
            let readout_s = f64::from(gopro::READOUT_MS) * 1e-3;
            let expected_s = start_s + f64::from(gopro::EXPOSURE_S) / 2.0 + part * readout_s;
            let error_us = (found_ns as f64 * 1e-9 - expected_s) * 1e6;
            assert!(error_us.abs() < most_us + 2.0, "{part}: {error_us}");
        }
    }
    // The track's own times say nothing of the camera's clock, but are read.
    std::fs::write(&file, gopro::mp4(&twist.b, Stamps::None)).unwrap();
    let output = sync(folder.path(), &["--json", "a.csv", "GX010001.MP4"]);
    let form = json(&output)["recordings"][1]["form"].to_string();
    assert!(form.contains("the track's times"), "{output:?}");
}

/// A bag in two parts, as `ros2 bag record --max-bag-size` makes them, is one recording.
#[test]
fn a_bag_in_parts_is_refused_with_the_command_that_joins_them() {
    let folder = tempfile::tempdir().unwrap();
    let twist = twist_scenarios::twist(&TwistSpec::default(), 9_600);
    app(folder.path().join("a.csv"), &twist.a);
    let bag = folder.path().join("bag");
    std::fs::create_dir(&bag).unwrap();
    for number in 0..2 {
        ros2(bag.join(format!("bag_{number}.mcap")), &twist.b);
    }
    std::fs::write(bag.join("metadata.yaml"), "").unwrap();
    let refused = sync(folder.path(), &["a.csv", "bag@/imu/data"]);
    assert_eq!(refused.status.code(), Some(2), "{refused:?}");
    assert!(String::from_utf8_lossy(&refused.stderr).contains("rosbags-convert --src"));
}

#[test]
fn a_device_on_another_body_is_refused_and_the_rest_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let good = twist_scenarios::twist(&TwistSpec::default(), 9_100);
    let other = twist_scenarios::twist(&TwistSpec::default(), 9_200);
    app(folder.path().join("a.csv"), &good.a);
    app(folder.path().join("b.csv"), &good.b);
    app(folder.path().join("c.csv"), &other.b);
    let output = sync(folder.path(), &["--json", "a.csv", "b.csv", "c.csv"]);
    assert_eq!(output.status.code(), Some(3), "{output:?}");
    let result = json(&output);
    assert_eq!(result["pairs"][0]["accepted"], true);
    let refusal = result["pairs"][1]["refusal"].as_str().unwrap();
    assert!(refusal.contains("at any time shift"), "{refusal}");
    assert!(result["refusal"].as_str().unwrap().ends_with("number 3"));
}

#[test]
fn what_is_wrong_with_a_file_is_said() {
    let folder = tempfile::tempdir().unwrap();
    // Longer than a chunk of the bag.
    let spec = TwistSpec {
        duration_s: 20.0,
        ..TwistSpec::default()
    };
    let twist = twist_scenarios::twist(&spec, 9_400);
    app(folder.path().join("a.csv"), &twist.a);
    ros2(folder.path().join("b.mcap"), &twist.b);
    std::fs::write(folder.path().join("c.db3"), b"SQLite format 3\0 and so on").unwrap();
    std::fs::write(folder.path().join("d.mp4"), b"\0\0\0\x20ftypisom    ").unwrap();
    std::fs::write(folder.path().join("h.zip"), b"PK\x03\x04").unwrap();
    let bag = std::fs::read(folder.path().join("b.mcap")).unwrap();
    std::fs::write(folder.path().join("e.mcap"), &bag[..20]).unwrap();
    for (file, message, next) in [
        ("b.mcap", "/imu/data, /imu/other", "FILE@/TOPIC"),
        (
            "b.mcap@/none",
            "no IMU on topic /none; there are /imu/data",
            "IMU",
        ),
        (
            "c.db3",
            "--src c.db3 --dst c-mcap --dst-storage mcap",
            "pip install",
        ),
        ("d.mp4", "no index of tracks", "a whole recording"),
        ("e.mcap", "the file was not closed", "a whole recording"),
        ("h.zip", "a zip archive is not read", "unpack"),
    ] {
        let output = sync(folder.path(), &["a.csv", file]);
        assert_eq!(output.status.code(), Some(2), "{file}: {output:?}");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(
            said.contains(message) && said.contains(next),
            "{file}: {said}"
        );
    }
    // What is left of a bag is used, and its end is missed.
    std::fs::write(folder.path().join("f.mcap"), &bag[..bag.len() * 9 / 10]).unwrap();
    let output = sync(folder.path(), &["--json", "a.csv", "f.mcap@/imu/data"]);
    assert_eq!(output.status.code(), Some(4), "{output:?}");
    assert!(
        !json(&output)["recordings"][1]["damage"]
            .as_array()
            .unwrap()
            .is_empty()
    );
}
