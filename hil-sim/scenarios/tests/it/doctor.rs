//! `smartdepthsync doctor` as a process on the simulated rig: what it finds when
//! all is well, and what it says to do for each thing that is not.

use std::path::Path;
use std::process::Command;

use crate::support;
use crate::whole_rig::{SPEED, WholeRig};
use rig::motion::MotionSpec;
use serde_json::Value;

/// Runs it; gives the exit code and each check by its name.
struct Doctor<'a> {
    rig: &'a WholeRig,
    profile: String,
    path: Option<&'a Path>,
}

impl<'a> Doctor<'a> {
    fn new(rig: &'a WholeRig) -> Self {
        Self {
            rig,
            profile: rig.profile(),
            path: None,
        }
    }

    fn run(&self) -> (i32, Value) {
        let file = self.rig.folder.path().join("doctor.toml");
        std::fs::write(&file, &self.profile).unwrap();
        let mut command = Command::new(support::smartdepthsync());
        command
            .args(["doctor", "--json", "--port"])
            .arg(self.rig.rig.port())
            .arg("--profile")
            .arg(file);
        if let Some(path) = self.path {
            command.env("PATH", path);
        }
        let output = command.output().unwrap();
        let checks = serde_json::from_slice(&output.stdout)
            .unwrap_or_else(|error| panic!("{error}: {output:?}"));
        (output.status.code().unwrap(), checks)
    }
}

/// Verdict, what was found and what to do, of one check.
fn check(checks: &Value, name: &str) -> (String, String, String) {
    let all = checks["checks"].as_array().unwrap();
    let check = all
        .iter()
        .find(|check| check["kind"] == name)
        .unwrap_or_else(|| panic!("no check {name} in {checks}"));
    let text = |key: &str| check[key].as_str().unwrap_or_default().to_owned();
    (text("severity"), text("text"), text("next_step"))
}

#[test]
fn a_good_rig_passes_and_each_fault_names_its_remedy() {
    let rig = WholeRig::with(21, SPEED, |config, _| {
        config.motion = MotionSpec::default();
    });
    let (code, checks) = Doctor::new(&rig).run();
    assert_eq!(code, 0, "{checks}");
    let in_order = "profile, disk, ffmpeg, board, IMU, IMU clock, IMU noise, accelerometer, link";
    for name in in_order.split(", ").chain(["phone"]) {
        let (verdict, found, _) = check(&checks, name);
        assert_eq!(verdict, "good", "{name}: {found}");
    }
    // Nothing was learnt yet, and the published rig has no read-back: worth
    // knowing, and no reason to end.
    for (name, words) in [
        ("constant bias", "record --calibrate --led"),
        ("trigger read-back", "PA3"),
    ] {
        let (verdict, _, next) = check(&checks, name);
        assert_eq!(verdict, "check", "{name}");
        assert!(next.contains(words), "{name}: {next}");
    }

    // A search path without programs, and a recorder that is not there.
    let nowhere = rig.folder.path().join("nowhere");
    let recorder = "\n[depth.recorder]\ncommand = [\"no-such-recorder\"]\n";
    let (code, checks) = Doctor {
        profile: rig.profile() + recorder,
        path: Some(&nowhere),
        ..Doctor::new(&rig)
    }
    .run();
    assert_eq!(code, 14, "{checks}");
    let (verdict, found, next) = check(&checks, "depth recorder");
    assert_eq!(verdict, "bad");
    assert!(found.contains("no-such-recorder"), "{found}");
    assert!(next.contains("[depth.recorder]"), "{next}");
    let (verdict, _, next) = check(&checks, "ffmpeg");
    assert_eq!(verdict, "check");
    assert!(next.contains("install ffmpeg"), "{next}");

    rig.phone().leave_network();
    let (code, checks) = Doctor::new(&rig).run();
    assert_eq!(code, 12, "{checks}");
    let (verdict, found, next) = check(&checks, "phone");
    assert_eq!(verdict, "bad");
    assert!(
        found.contains(&rig.phone().address().to_string()),
        "{found}"
    );
    assert!(!next.is_empty());
    rig.phone().join_network().unwrap();

    rig.rig.unplug();
    let (code, checks) = Doctor::new(&rig).run();
    assert_eq!(code, 5, "{checks}");
    let (verdict, _, next) = check(&checks, "board");
    assert_eq!(verdict, "bad");
    assert!(!next.is_empty());
    assert_eq!(check(&checks, "phone").0, "good");

    // A twist would be refused.
    rig.phone().app.press_record();
    let (_, checks) = Doctor::new(&rig).run();
    let (verdict, found, next) = check(&checks, "phone");
    assert_eq!(verdict, "bad", "{found}");
    assert!(next.contains("smartdepthsync phone stop"), "{next}");
}
