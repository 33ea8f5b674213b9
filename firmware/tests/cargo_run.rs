//! `cargo run` at the root of the workspace, with stand-ins for probe-rs and cargo. The options
//! that cargo then gives to probe-rs are tested in `xtask`.

#![allow(clippy::unwrap_used, clippy::panic)]

use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::process::{Command, Output};

/// Makes a folder with a program that prints this.
fn stand_in(name: &str, prints: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    fs::write(&path, format!("#!/bin/sh\necho \"{prints}\"\n")).unwrap();
    fs::set_permissions(path, Permissions::from_mode(0o755)).unwrap();
    folder
}

fn run(programs: &Path, cargo: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_smartdepthsync-firmware"))
        .args(arguments)
        .env("PATH", programs)
        .env("CARGO", cargo)
        .output()
        .unwrap()
}

/// Cargo runs this program at the root since no other member of the workspace asks for it.
#[test]
fn cargo_run_at_the_root_is_this_program() {
    let metadata = Command::new(env!("CARGO"))
        .args([
            "metadata",
            "--no-deps",
            "--format-version",
            "1",
            "--offline",
        ])
        .current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
        .output()
        .unwrap();
    let text = String::from_utf8(metadata.stdout).unwrap();
    let named: Vec<&str> = text.split("\"default_run\":").skip(1).collect();
    let named: Vec<&&str> = named
        .iter()
        .filter(|name| !name.starts_with("null"))
        .collect();
    assert_eq!(named.len(), 1);
    assert!(named[0].starts_with("\"smartdepthsync-firmware\""));
}

#[test]
fn without_probe_rs_or_a_probe_three_lines_say_what_to_do() {
    let empty = tempfile::tempdir().unwrap();
    let no_probe = stand_in("probe-rs", "No debug probes were found.");
    for (programs, reason) in [(&empty, "install it"), (&no_probe, "finds no debug probe")] {
        let output = run(programs.path(), Path::new("/nonexistent/cargo"), &[]);
        assert_eq!(output.status.code(), Some(1), "{output:?}");
        let text = String::from_utf8(output.stderr).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        let [error, without_probe, without_board] = lines[..] else {
            panic!("{text}");
        };
        assert!(
            error.starts_with("error: ") && error.contains(reason),
            "{text}"
        );
        assert!(
            without_probe.contains("smartdepthsync board flash"),
            "{text}"
        );
        assert!(without_board.contains("cargo xtask demo"), "{text}");
    }
}

#[test]
fn with_a_probe_cargo_runs_the_firmware_of_the_board() {
    let probe = stand_in("probe-rs", "[0]: STLink V2 -- 0483:374b:066 (ST-LINK)");
    let cargo = stand_in("cargo", "$PWD $@");
    let firmware = env!("CARGO_MANIFEST_DIR");
    for (arguments, command) in [(&[][..], "run --release"), (&["black-pill"], "black-pill")] {
        let output = run(probe.path(), &cargo.path().join("cargo"), arguments);
        assert!(output.status.success(), "{output:?}");
        let called = String::from_utf8(output.stdout).unwrap();
        assert_eq!(called.trim_end(), format!("{firmware} {command}"));
    }
    let unknown = run(probe.path(), &cargo.path().join("cargo"), &["nucleo"]);
    assert_eq!(unknown.status.code(), Some(1), "{unknown:?}");
}
