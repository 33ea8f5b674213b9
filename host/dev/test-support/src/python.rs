//! The Python environment with the public readers that judge what we write.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::processes::run;
use crate::{root, target};

/// Returns the interpreter of the environment in `target/venv`, with the packages of
/// `xtask/python-requirements.txt`. `cargo xtask test` makes it before the tests, and this for a
/// test that is run on its own.
#[must_use]
pub fn python() -> PathBuf {
    let venv = target().join("venv");
    let (python, stamp) = (venv.join("bin/python3"), venv.join("requirements.txt"));
    let requirements = root().join("xtask/python-requirements.txt");
    let wanted = fs::read_to_string(&requirements).unwrap();
    // Tests of several programs may come here at a time.
    let lock = fs::File::create(target().join("venv.lock")).unwrap();
    lock.lock().unwrap();
    let is_made = fs::read_to_string(&stamp).is_ok_and(|have| have == wanted) && python.is_file();
    if !is_made {
        run(Command::new("python3")
            .args(["-m", "venv", "--clear"])
            .arg(&venv));
        let install = "-m pip install --quiet --disable-pip-version-check -r".split(' ');
        run(Command::new(&python).args(install).arg(requirements));
        fs::write(stamp, wanted).unwrap();
    }
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
