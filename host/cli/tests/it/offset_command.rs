//! `smartdepthsync offset` as a process: outputs, exit codes, damaged files.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;
use twist_scenarios::{Twist, TwistSpec};
use twist_sync::GyroTrack;

use crate::support::phone_app;
use test_support::objects;

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
    assert!(std::fs::read_to_string(plot).unwrap().contains("REFUSED"));
}

#[test]
fn damaged_files_are_named_with_their_line() {
    let twist = twist_scenarios::twist(&TwistSpec::default(), 7000);
    let files = files(&twist);
    let good = std::fs::read_to_string(&files.mcu).unwrap();
    let mut lines: Vec<&str> = good.lines().collect();
    lines[41] = "12.5,0.1,oops,0.3";
    std::fs::write(&files.mcu, lines.join("\n")).unwrap();
    let output = offset(&files.mcu, &files.phone, &[]);
    assert_eq!(output.status.code(), Some(2));
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
    let twist = twist_scenarios::twist(&TwistSpec::default(), 8000);
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

/// Runs `offset` with so many kB of memory: address space, which a large allocation
/// takes at once.
#[cfg(target_os = "linux")]
fn offset_within(kilobytes: u32, mcu: &Path, phone: &Path) -> Output {
    Command::new("sh")
        .arg("-c")
        .arg(format!("ulimit -v {kilobytes}; exec \"$0\" \"$@\""))
        .arg(env!("CARGO_BIN_EXE_smartdepthsync"))
        .args(["offset", "--json", "--mcu"])
        .arg(mcu)
        .arg("--phone")
        .arg(phone)
        .output()
        .unwrap()
}

#[cfg(target_os = "linux")]
#[test]
fn timestamps_far_from_the_rest_are_named_and_take_no_memory() {
    let twist = twist_scenarios::twist(&TwistSpec::default(), 9000);
    let files = files(&twist);
    let good = std::fs::read_to_string(&files.phone).unwrap();
    let last = good.lines().last().unwrap().rsplit_once(',').unwrap().1;
    let five_days = last.parse::<i64>().unwrap() + 432_000_000_000_000;
    let with_stamp = |line: usize, stamp: String| -> String {
        let lines = good.lines().enumerate().map(|(k, text)| {
            let (rates, own) = text.rsplit_once(',').unwrap();
            let stamp = if k == line { &stamp } else { own };
            format!("{rates},{stamp}\n")
        });
        lines.collect()
    };
    let end = good.lines().count() - 1;
    for (line, stamp) in [
        (1000, i64::MAX.to_string()),
        (1000, i64::MIN.to_string()),
        (0, i64::MIN.to_string()),
        (0, String::from("0")),
        (end, i64::MAX.to_string()),
        (end, five_days.to_string()),
    ] {
        std::fs::write(&files.phone, with_stamp(line, stamp.clone())).unwrap();
        let output = offset_within(500_000, &files.mcu, &files.phone);
        assert_eq!(output.status.code(), Some(0), "{line} {stamp}: {output:?}");
        let result = json(&output);
        let far = |fault: &&Value| fault["kind"] == "timestamp_far" && fault["count"] == 1;
        assert_eq!(
            result["faults"]
                .as_array()
                .unwrap()
                .iter()
                .filter(far)
                .count(),
            1
        );
        let error = result["offset_s"].as_f64().unwrap()
            - twist.offset_at(result["reference_s"].as_f64().unwrap());
        assert!(
            error.abs() < 5.0 * result["offset_sigma_s"].as_f64().unwrap(),
            "{error}"
        );
    }
    // From there on all of them: the larger part counts.
    let shifted: String = good
        .lines()
        .enumerate()
        .map(|(k, text)| {
            let (rates, own) = text.rsplit_once(',').unwrap();
            let jump = if k > 3600 { 432_000_000_000_000 } else { 0 };
            format!("{rates},{}\n", own.parse::<i64>().unwrap() + jump)
        })
        .collect();
    std::fs::write(&files.phone, shifted).unwrap();
    let output = offset_within(500_000, &files.mcu, &files.phone);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    // Seconds as floats, far beyond any integer.
    let mut floats = with_header(&twist.b);
    for (wild, code) in [("1e300", 0), ("-1e300", 0), ("1.7976931348623157e308", 0)] {
        floats += &format!("{wild},1,2,3\n");
        std::fs::write(&files.phone, &floats).unwrap();
        let output = offset_within(500_000, &files.mcu, &files.phone);
        assert_eq!(output.status.code(), Some(code), "{wild}: {output:?}");
    }
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
    assert!(
        result["warnings"][0]
            .as_str()
            .unwrap()
            .contains("the rates of the phone")
    );
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
    let turned = first["left_out"][0]["turned_deg"].as_f64().unwrap();
    let sigma = first["left_out"][0]["turned_sigma_deg"].as_f64().unwrap();
    assert!((4.0..11.0).contains(&turned) && sigma > 0.0 && sigma < 1.0);
    // What was used is named, and is the rest.
    let used = first["together"].as_array().unwrap();
    let length = |s: &Value| s[1].as_f64().unwrap() - s[0].as_f64().unwrap();
    let used_s: f64 = used.iter().map(length).sum();
    let overlap_s = first["overlap_s"].as_f64().unwrap();
    assert!((used_s - overlap_s).abs() < 0.5, "{used:?} {overlap_s}");
    let (from, to) = twist.loose_s[0];
    let begin = first["left_out"][0]["from_s"].as_f64().unwrap();
    let end = first["left_out"][0]["to_s"].as_f64().unwrap();
    // One part was kept, up to the slip or from it on.
    let slip = (from - twist.a.epoch_s)..(to - twist.a.epoch_s);
    assert!(
        (begin - slip.start).abs() < 0.6 || (end - slip.end).abs() < 0.6,
        "{begin} to {end}, slipped at {slip:?}"
    );
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
