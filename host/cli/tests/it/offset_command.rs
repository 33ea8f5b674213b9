//! `smartdepthsync offset` as a process: outputs, exit codes, damaged files.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;
use twist_scenarios::{Twist, TwistSpec};
use twist_sync::GyroTrack;

use crate::support::phone_app;

fn offset(mcu: &Path, phone: &Path, more: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_smartdepthsync"))
        .arg("offset")
        .arg("--mcu")
        .arg(mcu)
        .arg("--phone")
        .arg(phone)
        .args(more)
        .output()
        .unwrap()
}

fn with_header(track: &GyroTrack) -> String {
    let mut out = String::from("mcu_time,mcu_x,mcu_y,mcu_z\n");
    for (t, w) in track.t.iter().zip(&track.w) {
        let _ = writeln!(out, "{:.9},{},{},{}", track.epoch_s + t, w[0], w[1], w[2]);
    }
    out
}

struct Files {
    _folder: tempfile::TempDir,
    mcu: PathBuf,
    phone: PathBuf,
}

fn files(twist: &Twist) -> Files {
    let folder = tempfile::tempdir().unwrap();
    let (mcu, phone) = (
        folder.path().join("mcu.csv"),
        folder.path().join("phone.csv"),
    );
    std::fs::write(&mcu, with_header(&twist.a)).unwrap();
    std::fs::write(&phone, phone_app(&twist.b)).unwrap();
    Files {
        _folder: folder,
        mcu,
        phone,
    }
}

fn json(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn a_twist_is_accepted_in_both_forms() {
    let twist = twist_scenarios::twist(&TwistSpec::default(), 5000);
    let files = files(&twist);
    let plot = files.mcu.with_file_name("plot.svg");
    let output = offset(
        &files.mcu,
        &files.phone,
        &["--json", "--plot", plot.to_str().unwrap()],
    );
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let result = json(&output);
    assert_eq!(result["accepted"], true);
    let number = |key: &str| {
        result[key]
            .as_f64()
            .unwrap_or_else(|| panic!("{key}: {result}"))
    };
    let error = number("offset_s") - twist.offset_at(number("reference_s"));
    assert!(error.abs() < 5.0 * number("offset_sigma_s"), "{error}");
    assert!((number("skew_ppm") * 1e-6 - twist.skew).abs() < 5e-6 * number("skew_sigma_ppm"));
    assert!(number("residual_rms") < 0.01);
    assert_eq!(result["calibration"].as_array().unwrap().len(), 3);
    for key in ["faults", "gates", "warnings"] {
        assert!(result[key].is_array(), "{key}");
    }
    assert!(plot.metadata().unwrap().len() > 1_000);
}

#[test]
fn a_refusal_has_its_exit_code_and_reasons() {
    let twist = twist_scenarios::twist(
        &TwistSpec {
            unrelated: true,
            ..TwistSpec::default()
        },
        6000,
    );
    let files = files(&twist);
    let plot = files.mcu.with_file_name("plot.svg");
    let output = offset(
        &files.mcu,
        &files.phone,
        &["--json", "--plot", plot.to_str().unwrap()],
    );
    assert_eq!(output.status.code(), Some(3), "{output:?}");
    let result = json(&output);
    assert_eq!(result["accepted"], false);
    assert!(result["offset_s"].is_null());
    let failed = |g: &&Value| g["passed"] == false;
    assert!(
        result["gates"]
            .as_array()
            .unwrap()
            .iter()
            .any(|g| failed(&g))
    );
    assert!(plot.metadata().unwrap().len() > 1_000);
}

#[test]
fn degrees_a_second_are_found_by_their_size_and_said() {
    let mut twist = twist_scenarios::twist(&TwistSpec::default(), 10_000);
    let plain = json(&offset(
        &files(&twist).mcu,
        &files(&twist).phone,
        &["--json"],
    ));
    twist
        .b
        .w
        .iter_mut()
        .flatten()
        .for_each(|rate| *rate = rate.to_degrees());
    let files = files(&twist);
    let output = offset(&files.mcu, &files.phone, &["--json"]);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let result = json(&output);
    assert_eq!(result["warnings"].as_array().unwrap().len(), 1, "{result}");
    let moved = result["offset_s"].as_f64().unwrap() - plain["offset_s"].as_f64().unwrap();
    assert!(moved.abs() < 1e-7, "{moved}");
}

#[test]
fn an_export_gives_the_same_result_without_names_and_times() {
    let spec = TwistSpec {
        grip: twist_scenarios::Grip::Slip(5.0, 10.0),
        ..TwistSpec::default()
    };
    let twist = twist_scenarios::twist(&spec, 11_000);
    let files = files(&twist);
    let folder = files.mcu.with_file_name("export");
    let first = offset(
        &files.mcu,
        &files.phone,
        &["--json", "--export", folder.to_str().unwrap()],
    );
    assert_eq!(first.status.code(), Some(0), "{first:?}");
    let first = json(&first);
    assert_eq!(first["left_out"][0]["why"], "slipped");
    let (mcu, phone) = (folder.join("mcu.csv"), folder.join("phone.csv"));
    let again = json(&offset(&mcu, &phone, &["--json"]));
    let epochs = twist.b.epoch_s - twist.a.epoch_s;
    let moved = first["offset_s"].as_f64().unwrap() - epochs - again["offset_s"].as_f64().unwrap();
    assert!(moved.abs() < 1e-6, "{moved}");
    let text = std::fs::read_to_string(folder.join("result.json")).unwrap();
    let result: Value = serde_json::from_str(&text).unwrap();
    let moved =
        result["result"]["offset_s"].as_f64().unwrap() - again["offset_s"].as_f64().unwrap();
    assert!(moved.abs() < 1e-7, "{moved}");
    assert!(!text.contains(files.mcu.parent().unwrap().to_str().unwrap()));
}
