//! The programs of a trial: the host tool under test and the firmware, and how they run.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use anyhow::{Context, Result, bail};
use serde_json::Value;

/// The programs and files that all sessions need.
#[derive(Clone, Debug)]
pub struct Programs {
    /// The program `smartdepthsync`.
    pub smartdepthsync: PathBuf,
    /// The firmware's ELF; the one that was built last if not given.
    pub elf: Option<PathBuf>,
}

impl Programs {
    /// `smartdepthsync`, with nobody at the keys.
    pub(crate) fn tool(&self) -> Command {
        let mut command = Command::new(&self.smartdepthsync);
        command.stdin(Stdio::null());
        command
    }

    /// Says why the program cannot be started.
    pub(crate) fn cannot_start(&self) -> String {
        format!(
            "cannot start {}: build it with `cargo build --release -p smartdepthsync`",
            self.smartdepthsync.display()
        )
    }

    /// Runs a command of the program to its end, and returns its output.
    pub(crate) fn output(&self, command: &mut Command) -> Result<Output> {
        command.output().with_context(|| self.cannot_start())
    }
}

/// Exit and output of a program.
pub(crate) fn said(output: &Output) -> String {
    format!(
        "{}: {}{}",
        output.status,
        String::from_utf8_lossy(&output.stdout).trim(),
        String::from_utf8_lossy(&output.stderr).trim()
    )
}

/// Runs `smartdepthsync` with `--json` and gives what it prints. Exit code 4,
/// finished with loss, is an answer too.
///
/// # Errors
///
/// It ends with another exit code, or prints no JSON.
pub fn ask(programs: &Programs, arguments: &[&str], paths: &[&Path]) -> Result<Value> {
    let mut command = programs.tool();
    let output = programs.output(command.arg("--json").args(arguments).args(paths))?;
    if !matches!(output.status.code(), Some(0 | 4)) {
        bail!("smartdepthsync {arguments:?} failed: {}", said(&output));
    }
    serde_json::from_slice(&output.stdout)
        .with_context(|| format!("smartdepthsync {arguments:?} printed no JSON"))
}
