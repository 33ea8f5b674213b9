//! `smartdepthsync offset` as a process: outputs, exit codes, damaged files.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;
use twist_sync::GyroTrack;
use twist_sync::simulate::{self, Twist, TwistSpec};

use crate::support::objects;

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

fn phone_app(track: &GyroTrack) -> String {
    let mut out = String::new();
    for (t, w) in track.t.iter().zip(&track.w) {
        let nanos = ((track.epoch_s + t) * 1e9).round() as i64;
        let _ = writeln!(out, "{},{},{},{nanos}", w[0], w[1], w[2]);
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
    let twist = simulate::twist(&TwistSpec::default(), 5000);
    let files = files(&twist);
    let plot = files.mcu.with_file_name("plot.svg");
    let output = offset(
        &files.mcu,
        &files.phone,
        &["--json", "--plot", plot.to_str().unwrap()],
    );
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let result = json(&output);
    objects::check("offset", &[&result]);
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
    assert!(
        result["phone"]["form"]
            .as_str()
            .unwrap()
            .contains("phone app")
    );
    let svg = std::fs::read_to_string(plot).unwrap();
    assert!(svg.starts_with("<svg") && svg.contains("Residual"));
}

#[test]
fn a_refusal_has_its_exit_code_and_reasons() {
    let twist = simulate::twist(
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
    assert!(std::fs::read_to_string(plot).unwrap().contains("REFUSED"));
}

#[test]
fn damaged_files_are_named_with_their_line() {
    let twist = simulate::twist(&TwistSpec::default(), 7000);
    let files = files(&twist);
    let good = std::fs::read_to_string(&files.mcu).unwrap();
    let mut lines: Vec<&str> = good.lines().collect();
    lines[41] = "12.5,0.1,oops,0.3";
    std::fs::write(&files.mcu, lines.join("\n")).unwrap();
    let output = offset(&files.mcu, &files.phone, &[]);
    assert_eq!(output.status.code(), Some(1));
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        message.contains("line 42") && message.contains("oops"),
        "{message}"
    );

    let missing = files.mcu.with_file_name("missing.csv");
    assert_eq!(offset(&missing, &files.phone, &[]).status.code(), Some(13));
    assert_eq!(
        offset(&files.phone, &files.phone, &["--low-pass-hz", "nan"])
            .status
            .code(),
        Some(2)
    );
}

#[test]
fn short_and_odd_recordings_are_refused_not_crashed_on() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("odd.csv");
    let twist = simulate::twist(&TwistSpec::default(), 8000);
    let files = files(&twist);
    for text in [
        "time,x,y,z\n1,2,3,4\n".to_owned(),
        "1,2,3,9223372036854775807\n1,2,3,-9223372036854775808\n".to_owned(),
        (0..300)
            .map(|k| format!("0,0,0,{}\n", k * 2_000_000))
            .collect::<String>(),
        (0..300).map(|_| "1,2,3,5\n".to_owned()).collect::<String>(),
        (0..300)
            .map(|k| format!("1e300,-1e300,{k},{}\n", k * 2_000_000))
            .collect::<String>(),
        (0..3000)
            .map(|k| format!("{},0,1,{}\n", k % 7, i64::from(k) * 3_000_000_000_000))
            .collect::<String>(),
    ] {
        std::fs::write(&path, &text).unwrap();
        for (mcu, phone) in [(&path, &files.phone), (&files.mcu, &path), (&path, &path)] {
            let output = offset(mcu, phone, &["--json"]);
            assert_eq!(output.status.code(), Some(3), "{output:?}");
        }
    }
}
