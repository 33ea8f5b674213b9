//! Every command prints one object with `--json`, on a rig where all of them can.

use std::path::Path;
use std::process::Command;

use crate::support;
use crate::whole_rig::WholeRig;
use serde_json::Value;
use test_support::below;
use test_support::calibrations::CHAIN;
use test_support::processes::Ran;

/// Runs a command of words without spaces and gives what it prints. It may end with loss or
/// refusal, as long as it prints its object.
fn print(folder: &Path, arguments: &str) -> Value {
    let mut command = support::tool();
    command.arg("--json").args(arguments.split(' '));
    print_of(command.current_dir(folder))
}

fn print_of(command: &mut Command) -> Value {
    let ran = Ran::new(command);
    let value = ran.json();
    assert!(value.is_object(), "{ran}");
    assert_eq!(value["error"], Value::Null, "{ran}");
    value
}

#[test]
fn objects_of_commands_that_talk_to_board_and_phone() {
    let rig = WholeRig::new(71, 8.0);
    let folder = rig.folder.path();
    let port = rig.rig.port().to_str().unwrap();
    let board = |arguments: &str| print(folder, &format!("{arguments} --port {port}"));
    for arguments in [
        "board info",
        "board imu --duration 1s",
        "board pps start --utc 1767225600",
        "board pps status",
        "board pps stop",
        "board trigger start --fps 30",
        "board trigger period --fps 30",
    ] {
        board(arguments);
    }
    let state = board("monitor --duration 3s");
    assert_eq!(state["losses"]["messages"], 0);
    let rate = state["rates"]["imu"].as_f64().unwrap();
    assert!((rate - 500.0).abs() < 1.0, "{state}");
    board("board trigger status");
    board("board trigger status --output 2");
    board("board trigger align --anchor 48000000 --slew 1ms");
    board("board trigger stop");
    let address = rig.phone().address().to_string();
    board(&format!(
        "setup --yes --phone {address} --profile setup.toml"
    ));
    board("doctor --profile setup.toml");

    // A session, and what is made of its recording.
    let options = "--duration 12s --marker 1s --second-twist --json".split(' ');
    print_of(&mut rig.record("whole", &options.collect::<Vec<_>>()));
    let recording = rig.recording("whole");
    let recording = recording.to_str().unwrap();
    print(folder, &format!("verify {recording}"));
    let storage = folder.join("phone");
    print(
        folder,
        &format!("extract {recording} --phone {}", storage.display()),
    );
    let timestamps = below(&storage)
        .into_iter()
        .find(|path| path.to_string_lossy().ends_with("_timestamps.csv"))
        .unwrap();
    print(folder, "profile init rig.toml");
    let learn = format!("profile learn {recording} --profile rig.toml --timestamps");
    print(folder, &format!("{learn} {}", timestamps.display()));

    for arguments in [
        "phone imu --duration 1s --out gyro.csv",
        "phone start",
        "phone stop",
        "phone get-video --recorded --out video.mp4",
    ] {
        print(folder, &format!("{arguments} --phone {address}"));
    }
}

#[test]
fn objects_of_commands_that_need_nothing() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("chain.yaml"), CHAIN).unwrap();
    for arguments in [
        "board list",
        "completions bash",
        "man man1",
        "profile init rig.toml",
        "profile check rig.toml",
        "profile import-kalibr rig.toml chain.yaml",
    ] {
        print(folder.path(), arguments);
    }
}
