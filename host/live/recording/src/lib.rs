//! A recording: one folder with everything of one session.
//!
//! ```text
//! 2026-01-31_14-03-27/
//!   recording.mcap   streams of the board, and decisions of the session
//!   session.json     all decisions, with versions and profile
//!   metadata.yaml    makes the folder a rosbag2
//!   ...              twists, files of the phone and of the depth recorder
//! ```
//!
//! Description of a rig:
//! - [`profile`]: the rig profile. [`camera`]: models of depth cameras. [`kalibr`]: import of a
//!   calibration into the profile.
//! - [`error_budget`]: how well the cameras expose together, in numbers and words.
//!
//! Files:
//! - [`folder`]: the folder. [`bag`]: the one MCAP file of a recording or of another program's
//!   bag. [`depth_files`]: the depth recordings.
//! - [`session_file`]: `session.json`. [`contents`]: what a closed recording holds. [`rosbag2`]:
//!   `metadata.yaml`.
//!
//! Content of the MCAP file:
//! - [`topic`]: the table of topics. [`messages`]: their ROS 2 types. `diagnostics`: the board's
//!   status as such a message.
//! - [`writer`]: writes them so that a kill loses at most a second.
//! - `scan`, `chunks`: records of the file over any `damage`. `index`: its index,
//!   compared with them. [`walk`]: topics and messages from
//!   the records. [`reader`]: messages as Rust values. [`samples`]: joins the messages of an IMU
//!   sample. [`grid`]: the grid of the trigger's pulses.
//! - [`strobes`]: exposures of the depth camera from the edges of the strobe input.
//! - [`verify`]: checks that a recording is complete and agrees with itself.
//!
//! The format is described in `docs/formats.md`.

pub mod bag;
pub mod camera;
mod chunks;
pub mod contents;
mod damage;
pub mod depth_files;
mod diagnostics;
pub mod error_budget;
pub mod folder;
pub mod grid;
mod index;
pub mod kalibr;
pub mod messages;
pub mod profile;
mod publish;
pub mod reader;
pub mod rosbag2;
pub mod samples;
mod scan;
pub mod session_file;
pub mod strobes;
pub mod topic;
pub mod verify;
pub mod walk;
pub mod writer;

use std::path::{Path, PathBuf};

use protocol::Ticks;

pub use topic::{Item, Topic};

/// Name of the MCAP file in the folder.
pub const MCAP_FILE: &str = "recording.mcap";

/// Name of the session file in the folder.
pub const SESSION_FILE: &str = "session.json";

/// Converts a `log_time` or stamp, ns of board time, to ticks, exactly.
fn ticks_of_nanos(nanos: u64) -> Ticks {
    // round(ns · 6 / 125); ticks are 20.83 ns apart, so rounding to nanoseconds
    // and back is exact.
    let ticks = (u128::from(nanos) * 6 + 62) / 125;
    Ticks(u64::try_from(ticks).unwrap_or(u64::MAX))
}

/// Returns the MCAP file of a recording: the one in its folder, or the file itself.
fn mcap_of(recording: &Path) -> PathBuf {
    if recording.is_dir() {
        recording.join(MCAP_FILE)
    } else {
        recording.to_owned()
    }
}

/// Error of reading or writing a recording's files.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// A file or folder cannot be read or written.
    #[error("cannot {action} {path}: {source}", path = .path.display())]
    Io {
        /// Attempted action, as an infinitive: `read`.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The MCAP file cannot be written or read.
    #[error("{path}: {reason}", path = .path.display(), reason = mcap_reason(.source))]
    Mcap {
        /// The file.
        path: PathBuf,
        /// Error of the format.
        source: mcap::McapError,
    },
    /// A message is not of its topic's type.
    #[error("{topic}: {source}")]
    Message {
        /// The topic.
        topic: String,
        /// Error of the message.
        source: messages::CdrError,
    },
    /// A bag of a form that this program does not read.
    #[error(
        "{path} is {form}, which is not read: `{command}` makes one that is (Python package rosbags)",
        path = .path.display(),
        command = bag::conversion(.path)
    )]
    ForeignBag {
        /// The bag.
        path: PathBuf,
        /// Its form in words.
        form: &'static str,
    },
    /// The path is neither a recording nor a bag.
    #[error(
        "{path} is not a recording: expected a folder with {MCAP_FILE}, or an MCAP file, found neither",
        path = .path.display()
    )]
    NoRecording {
        /// The given path.
        path: PathBuf,
    },
    /// `session.json` is damaged or of another version.
    #[error("{path} is not a session file of this program: {reason}", path = .path.display())]
    Session {
        /// The file.
        path: PathBuf,
        /// Line and expected content.
        reason: String,
    },
}

/// Returns the operating system's message where there is one, else the format's.
fn mcap_reason(error: &mcap::McapError) -> String {
    match error {
        mcap::McapError::Io(source) => source.to_string(),
        other => other.to_string(),
    }
}

impl RecordingError {
    /// Returns a function that wraps an error of the operating system; `action` is the attempted
    /// action, an infinitive.
    pub fn io(action: &'static str, path: &Path) -> impl Fn(std::io::Error) -> Self {
        move |source| Self::Io {
            action,
            path: path.to_owned(),
            source,
        }
    }

    /// Returns a function that wraps an error of an MCAP file.
    pub fn mcap(path: &Path) -> impl Fn(mcap::McapError) -> Self {
        move |source| Self::Mcap {
            path: path.to_owned(),
            source,
        }
    }

    /// Returns true if the disk is full, or a quota or the size limit of a file is exceeded.
    #[must_use]
    pub fn is_disk_full(&self) -> bool {
        use std::io::ErrorKind::{FileTooLarge, QuotaExceeded, StorageFull};
        let error = match self {
            Self::Io { source, .. } => source,
            Self::Mcap {
                source: mcap::McapError::Io(source),
                ..
            } => source,
            _ => return false,
        };
        matches!(error.kind(), StorageFull | QuotaExceeded | FileTooLarge)
    }
}

#[cfg(test)]
mod tests;
