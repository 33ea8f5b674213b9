//! What every command prints with `--json` is described in the book, field by field:
//! `docs/json.md`. Those of `offset` and `evaluate` are compared by the host's tests of
//! these commands, that of `trigger latency` by `whole_chain`.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support;
use crate::turn;
use crate::whole_rig::WholeRig;
use serde_json::Value;
use test_support::objects;

/// Runs a command and gives what it prints. It may end with loss or refusal, as long as
/// it prints its object.
fn print(folder: &Path, arguments: &[&str]) -> Value {
    let output = Command::new(support::smartdepthsync())
        .arg("--json")
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap();
    let value: Value = serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|error| panic!("{arguments:?}: {error}: {output:?}"));
    assert_eq!(value["error"], Value::Null, "{arguments:?}: {value:#}");
    value
}

/// A file below a folder whose name ends so.
fn find(folder: &Path, ending: &str) -> Option<PathBuf> {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            if let Some(found) = find(&path, ending) {
                return Some(found);
            }
        } else if path.to_string_lossy().ends_with(ending) {
            return Some(path);
        }
    }
    None
}

#[test]
fn objects_of_commands_that_talk_to_board_and_phone() {
    let _turn = turn::beside_others();
    let rig = WholeRig::new(71, 8.0);
    let folder = rig.folder.path();
    let port = rig.rig.port().to_str().unwrap();
    let check = |arguments: &[&str], runs: &[&Value]| {
        let words = arguments.iter().take_while(|word| !word.starts_with('-'));
        let command: Vec<&str> = words.copied().collect();
        objects::check(&command.join(" "), runs);
    };
    let board = |arguments: &[&str]| {
        let mut all = arguments.to_vec();
        all.extend(["--port", port]);
        print(folder, &all)
    };
    for arguments in [
        &["info", "--watch", "1"][..],
        &["imu", "--seconds", "1", "--csv", "imu.csv"],
        &["monitor", "--duration", "2s"],
        &["gnss", "start", "--utc", "1767225600"],
        &["gnss", "status"],
        &["gnss", "stop"],
        &["trigger", "start", "--fps", "30"],
        &["trigger", "period", "--fps", "30"],
    ] {
        check(arguments, &[&board(arguments)]);
    }
    let status = board(&["trigger", "status"]);
    let further = board(&["trigger", "status", "--output", "2"]);
    check(&["trigger", "status"], &[&status, &further]);
    let align = [
        "trigger",
        "align",
        "--anchor",
        "48000000",
        "--slew-us",
        "1000",
    ];
    check(&align[..2], &[&board(&align)]);
    check(&["trigger", "stop"], &[&board(&["trigger", "stop"])]);
    let address = rig.phone().address().to_string();
    let doctor = board(&["doctor", "--phone", &address]);
    check(&["doctor"], &[&doctor]);
    let setup = [
        "setup",
        "--yes",
        "--phone",
        &address,
        "--profile",
        "setup.toml",
    ];
    check(&["setup"], &[&board(&setup)]);

    // A session, and what is made of its recording.
    let options = [
        "--duration",
        "12s",
        "--marker",
        "1s",
        "--second-twist",
        "--fetch-video",
        "--json",
    ];
    let output = rig.record("whole", &options).output().unwrap();
    let session: Value = serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|error| panic!("{error}: {output:?}"));
    objects::check("record", &[&session]);
    let recording = rig.recording("whole");
    let recording = recording.to_str().unwrap();
    check(&["verify"], &[&print(folder, &["verify", recording])]);
    check(&["report"], &[&print(folder, &["report", recording])]);
    check(
        &["repair"],
        &[&print(folder, &["repair", recording, "repaired"])],
    );
    let storage = folder.join("phone");
    let extract = ["extract", recording, "--phone", storage.to_str().unwrap()];
    check(&["extract"], &[&print(folder, &extract)]);
    let timestamps = find(&storage, "_timestamps.csv").unwrap();
    print(folder, &["profile", "init", "rig.toml"]);
    let learn = [
        "profile",
        "learn",
        recording,
        "--profile",
        "rig.toml",
        "--timestamps",
        timestamps.to_str().unwrap(),
    ];
    check(&["profile", "learn"], &[&print(folder, &learn)]);

    let phone = |arguments: &[&str]| {
        let mut all = arguments.to_vec();
        all.extend(["--phone", &address]);
        print(folder, &all)
    };
    std::fs::create_dir_all(folder.join("sensors")).unwrap();
    for arguments in [
        &["phone", "imu", "--seconds", "1", "--out", "sensors"][..],
        &["phone", "start"],
        &["phone", "stop"],
        &["phone", "get-video", "--recorded", "--out", "video.mp4"],
    ] {
        check(arguments, &[&phone(arguments)]);
    }
}

/// What Kalibr writes of two cameras.
pub(crate) const CHAIN: &str = "cam0:
  T_cam_imu:
  - [0.0, -1.0, 0.0, 0.02]
  - [0.0, 0.0, -1.0, -0.03]
  - [1.0, 0.0, 0.0, 0.001]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [0.1, -0.2, 0.001, 0.002]
  distortion_model: radtan
  intrinsics: [50.0, 51.0, 31.5, 23.5]
  resolution: [320, 180]
cam1:
  T_cam_imu:
  - [1.0, 0.0, 0.0, -0.05]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
";

#[test]
fn objects_of_commands_that_need_nothing() {
    let _turn = turn::beside_others();
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("chain.yaml"), CHAIN).unwrap();
    for (command, arguments) in [
        ("ports", &["ports"][..]),
        ("completions", &["completions", "bash"]),
        ("man", &["man", "man1"]),
        ("profile init", &["profile", "init", "rig.toml"]),
        ("profile check", &["profile", "check", "rig.toml"]),
        (
            "profile import-kalibr",
            &["profile", "import-kalibr", "rig.toml", "chain.yaml"],
        ),
    ] {
        objects::check(command, &[&print(folder.path(), arguments)]);
    }
}
