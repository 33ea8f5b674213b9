//! The Python environment with the public readers that judge what we write.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::processes::run;
use crate::target;

/// Returns the interpreter of the environment in `target/venv`, which `cargo xtask test` makes,
/// with the packages of `xtask/python-requirements.txt`.
#[must_use]
pub fn python() -> PathBuf {
    let python = target().join("venv/bin/python3");
    assert!(
        python.is_file(),
        "this test needs {}: run it by `cargo xtask test`",
        python.display()
    );
    python
}

/// Runs a script with arguments and returns what it printed.
pub fn run_script(script: &Path, arguments: &[&Path]) -> String {
    run_script_with(&python(), script, arguments)
}

/// The same with another interpreter.
pub fn run_script_with(python: &Path, script: &Path, arguments: &[&Path]) -> String {
    let ran = run(Command::new(python).arg(script).args(arguments));
    String::from_utf8(ran.stdout.clone()).unwrap()
}

/// Runs the command for `rosbags-convert` that a message names between backticks.
pub fn run_conversion(message: &str) {
    let command = message.split('`').nth(1).unwrap();
    let mut words = command.split_whitespace();
    assert_eq!(words.next(), Some("rosbags-convert"), "{message}");
    run(Command::new(python().with_file_name("rosbags-convert")).args(words));
}
