//! The outcome of a command: all exit codes, and errors with an exit code.
//!
//! A command returns `Result<ExitStatus, Failure>`: the status of one that did its work,
//! perhaps with loss, and has printed the result; or a [`Failure`] that knows its exit code.
//! Errors of the libraries convert into [`Failure`]s (see `advice`), so commands simply use
//! `?`.
//!
//! Every error says what to do next: its own next step, else what its exit code
//! suggests.
//!
//! `docs/troubleshooting.md` is the table for users; a test compares it with
//! [`ExitStatus::ALL`].

use std::fmt;
use std::io::{self, ErrorKind};
use std::path::Path;
use std::process::ExitCode;

/// The exit codes of `smartdepthsync`. The numbers never change their meaning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum ExitStatus {
    /// Everything that was asked for was done.
    Good = 0,
    /// An error without a code of its own.
    Error = 1,
    /// The command line is wrong.
    Usage = 2,
    /// A result missed a quality gate, or the board refused a value; nothing
    /// was changed.
    Refused = 3,
    /// Finished, with loss: the result exists, but something is missing in it.
    Loss = 4,
    /// No such port, or no board found.
    NoPort = 5,
    /// The port exists, but this user may not open it.
    Permission = 6,
    /// Another program has the port.
    Busy = 7,
    /// The device that answers on the port is not this board.
    NotThisBoard = 8,
    /// The board speaks another protocol version.
    OtherVersion = 9,
    /// The board did not answer in time.
    NoAnswer = 10,
    /// The link to the board was lost and did not come back.
    LinkLost = 11,
    /// The phone cannot be reached, went away, or answered with an error.
    Phone = 12,
    /// Disk full, or a file that cannot be read or written.
    Storage = 13,
    /// The depth recorder cannot be started.
    DepthRecorder = 14,
    /// Stopped by Ctrl-C or a termination signal; what there was is kept.
    Interrupted = 130,
}

impl ExitStatus {
    /// All codes, for the table in the documents.
    pub const ALL: [Self; 16] = [
        Self::Good,
        Self::Error,
        Self::Usage,
        Self::Refused,
        Self::Loss,
        Self::NoPort,
        Self::Permission,
        Self::Busy,
        Self::NotThisBoard,
        Self::OtherVersion,
        Self::NoAnswer,
        Self::LinkLost,
        Self::Phone,
        Self::Storage,
        Self::DepthRecorder,
        Self::Interrupted,
    ];

    /// Returns the code of a command that has finished, perhaps with loss.
    pub(crate) const fn of_loss(lossy: bool) -> Self {
        if lossy { Self::Loss } else { Self::Good }
    }

    /// Returns the number.
    #[must_use]
    pub const fn code(self) -> u8 {
        self as u8
    }

    /// Returns the next step for an error without one of its own.
    #[must_use]
    pub(crate) const fn next_step(self) -> &'static str {
        match self {
            Self::Good | Self::Loss => "read the result: it says what is missing",
            Self::Error => {
                "run it again with -vv for details; if it fails again, report it with that log"
            }
            Self::Usage => "`smartdepthsync help COMMAND` says what is expected",
            Self::Refused => "nothing was changed: change what the message names, then repeat it",
            Self::NoPort => {
                "plug the board in; `smartdepthsync board list` lists the ports there are"
            }
            Self::Permission => "install the udev rule of this program and plug the board in again",
            Self::Busy => "close the other program that has the port",
            Self::NotThisBoard => {
                "choose another port with --port; `smartdepthsync board list` marks boards"
            }
            Self::OtherVersion => {
                "put the firmware of this program's version on it: `smartdepthsync board flash`"
            }
            Self::NoAnswer => "press the board's reset button and try again",
            Self::LinkLost => "check the USB cable and plug the board in again",
            Self::Phone => {
                "bring the app to the foreground with its remote control on, in the same network"
            }
            Self::Storage => "check the path, the rights and the free space",
            Self::DepthRecorder => "check `[depth.recorder]` in the rig profile",
            Self::Interrupted => "run the command again when you are ready",
        }
    }
}

impl From<ExitStatus> for ExitCode {
    fn from(status: ExitStatus) -> Self {
        Self::from(status.code())
    }
}

/// An error that knows its exit code and what the user can do.
///
/// ```
/// use smartdepthsync::outcome::{ExitStatus, Failure};
///
/// let failure = Failure::new(ExitStatus::NoPort, "/dev/ttyACM7 does not exist")
///     .next_step("run `smartdepthsync board list` to see which ports there are");
/// assert_eq!(failure.status(), ExitStatus::NoPort);
/// ```
#[derive(Debug)]
pub struct Failure {
    status: ExitStatus,
    message: String,
    next_step: Option<String>,
    next: Vec<String>,
}

impl Failure {
    /// An error with its exit code. `message` says what was expected and what
    /// was found.
    #[must_use]
    pub fn new(status: ExitStatus, message: impl Into<String>) -> Self {
        Self {
            status,
            message: message.into(),
            next_step: None,
            next: Vec::new(),
        }
    }

    /// A file or folder that cannot be used: `action` is what was tried, such as
    /// "read".
    #[must_use]
    pub(crate) fn file(action: &str, path: &Path, error: &io::Error) -> Self {
        let message = format!("cannot {action} {}: {error}", path.display());
        Self::new(ExitStatus::Storage, message).next_step(file_step(error.kind()))
    }

    /// Returns the same error with a next step.
    #[must_use]
    pub fn next_step(mut self, step: impl Into<String>) -> Self {
        self.next_step = Some(step.into());
        self
    }

    /// Returns the same error with the commands to type next, whatever the next step is.
    #[must_use]
    pub(crate) fn commands(mut self, next: Vec<String>) -> Self {
        self.next = next;
        self
    }

    /// Returns the commands to type next.
    pub(crate) fn next(&self) -> &[String] {
        &self.next
    }

    /// Returns the same error with its subject before the message.
    #[must_use]
    pub(crate) fn about(mut self, what: &str) -> Self {
        self.message = format!("{what}: {}", self.message);
        self
    }

    /// Returns the exit code.
    #[must_use]
    pub const fn status(&self) -> ExitStatus {
        self.status
    }

    /// Returns its own next step, else that of its exit code.
    pub(crate) fn what_to_do(&self) -> &str {
        let own = self.next_step.as_deref();
        own.unwrap_or_else(|| self.status.next_step())
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for Failure {}

/// Returns the commands to type next as the last lines of a text; nothing if there are none.
pub(crate) fn next_text<C: AsRef<str>>(commands: &[C]) -> String {
    if commands.is_empty() {
        return String::new();
    }
    let lines = commands
        .iter()
        .map(|command| format!("  {}\n", command.as_ref()));
    format!("next\n{}", lines.collect::<String>())
}

/// Next step where the system starts no further thread.
pub(crate) const RAISE_LIMITS: &str = "raise the limits of this shell: `ulimit -v`, `ulimit -u`";

/// Refuses to overwrite a file, or to write into a missing folder.
///
/// # Errors
///
/// The file exists and `overwrite` is false, or its folder does not exist.
pub(crate) fn refuse_to_overwrite(path: &Path, overwrite: bool) -> Result<(), Failure> {
    if let Err(error) = system::folder_of(path).metadata() {
        return Err(Failure::file("create", path, &error));
    }
    if overwrite || path.symlink_metadata().is_err() {
        return Ok(());
    }
    let message = format!("{} is there already and is not overwritten", path.display());
    Err(Failure::new(ExitStatus::Storage, message)
        .next_step("choose another name, or give --overwrite"))
}

/// Writes a text to a file, replacing an existing one.
///
/// # Errors
///
/// It cannot be written.
pub(crate) fn write_file(path: &Path, text: &str) -> Result<(), Failure> {
    system::replace(path, text.as_bytes()).map_err(|error| Failure::file("write", path, &error))
}

/// Returns the next step for a file that cannot be used, from the system's reason.
#[must_use]
pub(crate) const fn file_step(reason: ErrorKind) -> &'static str {
    match reason {
        ErrorKind::NotFound => "check the path: there is no such file or folder",
        ErrorKind::PermissionDenied => "check its owner and permissions: access was denied",
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge => {
            "free some space and run it again"
        }
        ErrorKind::ReadOnlyFilesystem => "choose another place: this disk cannot be written",
        ErrorKind::IsADirectory => "give a file: this is a folder",
        ErrorKind::NotADirectory => "give a folder, and check the path: a part of it is a file",
        ErrorKind::AlreadyExists => "choose a name that is not taken",
        ErrorKind::InvalidData => "give another file: this one is not what it should be",
        _ => "check the path, the rights and the disk",
    }
}

impl From<io::Error> for Failure {
    fn from(error: io::Error) -> Self {
        Self::new(ExitStatus::Error, error.to_string()).next_step(file_step(error.kind()))
    }
}

impl From<serde_json::Error> for Failure {
    fn from(error: serde_json::Error) -> Self {
        Self::new(ExitStatus::Error, error.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_an_error_is_about_stands_before_it() {
        let failure = Failure::new(ExitStatus::Busy, "it is open").next_step("close it");
        let failure = failure.about("cannot connect");
        assert_eq!(failure.status(), ExitStatus::Busy);
        assert_eq!(failure.to_string(), "cannot connect: it is open");
        assert_eq!(failure.what_to_do(), "close it");
    }

    #[test]
    fn every_error_has_a_next_step() {
        let full = io::Error::from(ErrorKind::StorageFull);
        let error = Failure::from(full).about("saving");
        assert_eq!(error.status(), ExitStatus::Error);
        let step = error.what_to_do();
        assert!(step.contains("free some space"), "{step}");
        for status in ExitStatus::ALL {
            let failure = Failure::new(status, "odd");
            assert_eq!(failure.what_to_do(), status.next_step());
        }
        assert!(ExitStatus::Error.next_step().contains("-vv"));
    }

    #[test]
    fn the_documented_table_has_every_code() {
        let page = include_str!("../../../docs/troubleshooting.md");
        let page = page.split_once("## Exit codes").unwrap().1;
        for status in ExitStatus::ALL {
            let row = format!("| {} | `{status:?}` |", status.code());
            assert!(page.contains(&row), "docs/troubleshooting.md lacks {row}");
        }
        let rows = page.lines().filter(|line| line.contains("| `")).count();
        assert_eq!(rows, ExitStatus::ALL.len(), "a row for a code that is gone");
    }
}
