//! The Python environment with the public readers that judge what we write.
//!
//! `cargo xtask test` makes `target/venv` before the tests; this makes it for a
//! test that is run on its own.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

use crate::{root, target};

/// The interpreter of the environment in `target/venv`, with the packages of
/// `xtask/python-requirements.txt`.
pub fn python() -> &'static Path {
    static PYTHON: OnceLock<PathBuf> = OnceLock::new();
    PYTHON.get_or_init(prepare)
}

fn prepare() -> PathBuf {
    let root = root();
    let venv = target().join("venv");
    let python = venv.join("bin/python3");
    let requirements = root.join("xtask/python-requirements.txt");
    let wanted = fs::read_to_string(&requirements).unwrap();
    let stamp = venv.join("requirements.txt");
    // Tests of several programs may come here at a time.
    let lock = fs::File::create(target().join("venv.lock")).unwrap();
    lock.lock().unwrap();
    let have = fs::read_to_string(&stamp);
    if have.is_ok_and(|have| have == wanted) && python.is_file() {
        return python;
    }
    let made = Command::new("python3")
        .args(["-m", "venv", "--clear"])
        .arg(&venv)
        .status();
    assert!(
        made.is_ok_and(|status| status.success()),
        "this test needs Python with venv: sudo apt-get install python3 python3-venv"
    );
    let installed = Command::new(&python)
        .args([
            "-m",
            "pip",
            "install",
            "--quiet",
            "--disable-pip-version-check",
            "-r",
        ])
        .arg(&requirements)
        .status();
    assert!(
        installed.is_ok_and(|status| status.success()),
        "pip cannot install the packages of {}",
        requirements.display()
    );
    fs::write(&stamp, wanted).unwrap();
    python
}

/// Runs a script with arguments and returns what it printed. A script that fails
/// fails the test with its own words.
pub fn run_script(script: &Path, arguments: &[&Path]) -> String {
    run_script_with(python(), script, arguments)
}

/// The same with another interpreter.
pub fn run_script_with(python: &Path, script: &Path, arguments: &[&Path]) -> String {
    let output: Output = Command::new(python)
        .arg(script)
        .args(arguments)
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{} failed:\n{}\n{}",
        script.display(),
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    );
    String::from_utf8(output.stdout).unwrap()
}

/// Runs the command for `rosbags-convert` that a message names between backticks.
pub fn run_conversion(message: &str) {
    let command = message.split('`').nth(1).unwrap();
    let mut words = command.split_whitespace();
    assert_eq!(words.next(), Some("rosbags-convert"), "{message}");
    let program = python().with_file_name("rosbags-convert");
    let output: Output = Command::new(program).args(words).output().unwrap();
    assert!(
        output.status.success(),
        "{command}: {}",
        String::from_utf8_lossy(&output.stderr)
    );
}
