//! `smartdepthsync sync` on recordings that the Python package `telemetry-parser` reads.

use std::ffi::OsString;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;
use twist_scenarios::TwistSpec;
use twist_sync::GyroTrack;

use crate::support::gopro::{self, Stamps};
use crate::support::phone_app;
use test_support::python::python;

fn sync(folder: &Path, video: &str, path: OsString) -> Output {
    Command::new(env!("CARGO_BIN_EXE_smartdepthsync"))
        .current_dir(folder)
        .env("PATH", path)
        .args(["sync", "--json", "a.csv", video])
        .output()
        .unwrap()
}

/// A video of an Insta360 camera without a picture: behind the boxes of MP4 stand records,
/// each before its format, kind and length, and a trailer. By `InsvHeader.java`,
/// `FrameHeader.java`, `GyroV2Record.java` and `extra_metadata.proto` of insvtools,
/// <https://github.com/alex-plekhanov/insvtools>; samples are about half of 65536, which is
/// 4000 °/s.
fn insta360(track: &GyroTrack) -> Vec<u8> {
    let record = |kind: u8, mut content: Vec<u8>| {
        let length = content.len() as u32;
        content.extend([0, kind]);
        content.extend(length.to_le_bytes());
        content
    };
    let mut samples = Vec::new();
    for (t, rate) in track.t.iter().zip(&track.w) {
        let micros = ((track.epoch_s + t) * 1e6).round() as u64;
        samples.extend(micros.to_le_bytes());
        let counts = |rate: f64| (rate.to_degrees() / 4000.0 * 65_536.0).round() + 32_768.0;
        for value in [0.0, 0.0, 0.0, rate[0], rate[1], rate[2]] {
            samples.extend((counts(value) as u16).to_le_bytes());
        }
    }
    // Protocol buffers: 2 (text) is the camera, 62 (bool) says that the samples are raw.
    let camera = [&[0x12, 7][..], b"Tests 1", &[0xf0, 0x03, 1]].concat();
    let records = [record(3, samples), record(1, camera)].concat();
    let length = records.len() as u32 + 72;
    [
        &b"\0\0\0\x10ftypmp41\0\0\0\0\0\0\0\x08moov"[..],
        &records,
        &[0; 32],
        &length.to_le_bytes(),
        &3_u32.to_le_bytes(),
        b"8db42d694ccc418790edff439fe026bf",
    ]
    .concat()
}

#[test]
fn a_video_of_insta360_is_read() {
    // Its wheels end there.
    let is_new = "import sys; sys.exit(sys.version_info >= (3, 13))";
    let status = Command::new(python()).args(["-c", is_new]).status();
    if !status.unwrap().success() {
        println!("not run: telemetry-parser has no wheel for Python 3.13 and later");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let twist = twist_scenarios::twist(&TwistSpec::default(), 9_700);
    std::fs::write(folder.path().join("a.csv"), phone_app(&twist.a)).unwrap();
    std::fs::write(folder.path().join("VID.insv"), insta360(&twist.b)).unwrap();
    // What lies beside a recording is not run.
    for module in ["telemetry_parser", "resource", "signal"] {
        let intruder = format!("{module}.py");
        std::fs::write(folder.path().join(intruder), "raise SystemExit(4)").unwrap();
    }
    let venv = python().parent().unwrap().to_owned();
    let output = sync(folder.path(), "VID.insv", venv.into());
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let result: Value = serde_json::from_slice(&output.stdout).unwrap();
    let recording = &result["recordings"][1];
    assert_eq!(recording["form"], "Insta360 (Tests 1), by telemetry-parser");
    assert_eq!(recording["samples"], twist.b.len());
    let pair = &result["pairs"][0];
    let at_s = pair["reference_ns"].as_i64().unwrap() as f64 * 1e-9;
    let found_s = pair["offset_ns"].as_i64().unwrap() as f64 * 1e-9;
    let error_us = (found_s - twist.offset_at(at_s)) * 1e6;
    let sigma_us = pair["offset_sigma_us"].as_f64().unwrap();
    assert!(
        error_us.abs() < 4.0 * sigma_us && sigma_us < 20.0,
        "{error_us}: {pair}"
    );
}

#[test]
fn without_python_a_video_of_another_maker_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let twist = twist_scenarios::twist(&TwistSpec::default(), 9_800);
    std::fs::write(folder.path().join("a.csv"), phone_app(&twist.a)).unwrap();
    let video = gopro::mp4(&twist.b, Stamps::None);
    let track_at = video.windows(4).position(|word| word == b"gpmd").unwrap();
    let of_track = |format: &[u8; 4]| {
        let mut video = video.clone();
        video[track_at..][..4].copy_from_slice(format);
        video
    };
    for (name, content) in [
        ("a.insv", insta360(&twist.b)),
        ("b.mp4", of_track(b"rtmd")),
        ("c.mp4", of_track(b"djmd")),
        ("d.mp4", of_track(b"mett")),
        ("e.mxf", b"\x06\x0e\x2b\x34".to_vec()),
    ] {
        std::fs::write(folder.path().join(name), content).unwrap();
        let output = sync(folder.path(), name, OsString::new());
        assert_eq!(output.status.code(), Some(1), "{name}: {output:?}");
    }
}
