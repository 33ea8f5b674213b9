//! Runs of the program `adb`.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use system::{Cancel, Limits, RunError};

use super::error::AdbError;
use crate::answer::shorten;

/// Longest run of `adb`, except for copies.
pub(crate) const PATIENCE: Duration = Duration::from_secs(30);

/// Longest run of `adb` when cleaning up.
const MOMENT: Duration = Duration::from_secs(2);

/// Most bytes that `adb` may print: a list of some 100,000 files.
const MAX_OUTPUT: usize = 16 << 20;

/// The program `adb`, with the cancellation of its runs.
#[derive(Clone)]
pub(crate) struct Adb {
    program: PathBuf,
    cancel: Cancel,
}

/// Parses the output of `adb devices` into the serial numbers of the phones that are ready.
fn ready(list: &str) -> Result<Vec<String>, AdbError> {
    let lines = list.lines().filter_map(|line| line.split_once('\t'));
    let (ready, others): (Vec<_>, Vec<_>) = lines.partition(|(_, state)| state.trim() == "device");
    if ready.is_empty() {
        let states = others.iter();
        let states = states.map(|(serial, state)| format!("{serial}: {}", state.trim()));
        return Err(AdbError::NoDevice {
            states: states.collect(),
        });
    }
    Ok(ready
        .iter()
        .map(|(serial, _)| (*serial).to_owned())
        .collect())
}

impl Adb {
    /// Finds the program on the `PATH`.
    pub(crate) fn find(cancel: &Cancel) -> Result<Self, AdbError> {
        let program = system::find_program("adb").ok_or(AdbError::NoProgram)?;
        let cancel = cancel.clone();
        Ok(Self { program, cancel })
    }

    pub(crate) fn program(&self) -> &Path {
        &self.program
    }

    pub(crate) const fn cancel(&self) -> &Cancel {
        &self.cancel
    }

    /// Returns the serial numbers of the phones that are ready, at least one.
    pub(super) fn devices(&self) -> Result<Vec<String>, AdbError> {
        ready(&self.run(&["devices"], Some(PATIENCE))?)
    }

    /// Returns the serial number of the only phone that is ready.
    pub(crate) fn only_device(&self) -> Result<String, AdbError> {
        match <[String; 1]>::try_from(self.devices()?) {
            Ok([device]) => Ok(device),
            Err(devices) => Err(AdbError::SeveralDevices { devices }),
        }
    }

    /// Runs a command line in the phone's shell and returns its output.
    pub(crate) fn shell(&self, device: &str, line: &str) -> Result<String, AdbError> {
        self.run_for(device, &["shell", line])
    }

    /// Runs `adb` for a phone and returns its output.
    pub(crate) fn run_for(&self, device: &str, arguments: &[&str]) -> Result<String, AdbError> {
        self.run(&[&["-s", device], arguments].concat(), Some(PATIENCE))
    }

    /// Runs `adb` for a phone without cancellation: a cancelled run may have taken effect, and its
    /// result would be lost.
    pub(crate) fn run_to_end(
        &self,
        device: &str,
        arguments: &[&str],
        patience: Duration,
    ) -> Result<String, AdbError> {
        let adb = Self {
            cancel: Cancel::default(),
            ..self.clone()
        };
        adb.run(&[&["-s", device], arguments].concat(), Some(patience))
    }

    /// Runs `adb` to clean up after earlier runs. Ignores failures, as the phone may be gone.
    pub(crate) fn clean_up(&self, device: &str, arguments: &[&str]) {
        let _ = self.run_to_end(device, arguments, MOMENT);
    }

    pub(crate) fn cannot_run(&self, source: std::io::Error) -> AdbError {
        AdbError::Io {
            action: "run",
            path: self.program.clone(),
            source,
        }
    }

    /// Runs `adb` and returns its output.
    pub(super) fn run(
        &self,
        arguments: &[&str],
        patience: Option<Duration>,
    ) -> Result<String, AdbError> {
        let failed = |reason: String| AdbError::Failed {
            command: arguments.join(" "),
            reason,
        };
        let limits = Limits {
            run: patience,
            cancel: self.cancel.clone(),
            ..Limits::default()
        };
        let mut command = Command::new(&self.program);
        let output = system::run(command.args(arguments), limits, MAX_OUTPUT);
        let output = output.map_err(|error| match error {
            RunError::Start(source) | RunError::Read(source) => self.cannot_run(source),
            RunError::Cancelled => AdbError::Cancelled,
            error => failed(error.to_string()),
        })?;
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        if !output.status.success() {
            let said = format!("{text}{}", output.messages);
            return Err(failed(shorten(said.trim())));
        }
        Ok(text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_ready_phones_are_listed() {
        let list =
            "List of devices attached\nA1\tdevice\nB2\tunauthorized\n192.168.1.5:5555\tdevice\n";
        assert_eq!(ready(list).unwrap(), ["A1", "192.168.1.5:5555"]);
        let error = ready("List of devices attached\nB2\tunauthorized\n").unwrap_err();
        assert!(error.to_string().contains("B2: unauthorized"), "{error}");
    }
}
