//! A recording: one folder with everything of one session.
//!
//! ```text
//! 2026-01-31_14-03-27/
//!   recording.mcap   streams of the board, what was decided
//!   session.json     everything that was decided, with versions and profile
//!   metadata.yaml    makes the folder a rosbag2
//!   ...              twists, the phone's and the depth recorder's files
//! ```
//!
//! - [`folder`]: a readable name that never overwrites; the depth recordings in it.
//! - [`profile`]: what is fixed about one rig.
//! - [`camera`]: models of depth cameras.
//! - [`kalibr`]: what Kalibr found, into the profile.
//! - [`topic`]: the table of topics.
//! - [`messages`]: the ROS 2 types in the file.
//! - [`diagnostics`]: the counters in the board's status.
//! - [`error_budget`]: how well the cameras expose together, in numbers and words.
//! - [`grid`]: the grid that the trigger's pulses are on.
//! - [`writer`]: writes it, so that a kill loses at most a second.
//! - `scan`: the records of the file over any damage (`damage`); [`chunks`] unpacks them.
//! - [`walk`]: topics, messages and damage, from the records.
//! - [`reader`]: the messages as Rust values.
//! - [`bag`]: the one file of a recording or of another program's bag.
//! - [`rosbag2`]: what `metadata.yaml` holds.
//! - [`session_file`]: what `session.json` holds.
//! - [`verify`]: checks that a recording is complete and agrees with itself.
//!
//! The format is described in `docs/formats.md`.

pub mod bag;
pub mod camera;
pub mod chunks;
mod damage;
pub mod diagnostics;
pub mod error_budget;
pub mod folder;
pub mod grid;
pub mod kalibr;
pub mod messages;
pub mod profile;
mod publish;
pub mod reader;
pub mod rosbag2;
mod scan;
pub mod session_file;
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

/// Board time of a `log_time` or stamp, exactly.
#[must_use]
pub fn ticks_of_nanos(nanos: u64) -> Ticks {
    // round(ns · 6 / 125); ticks are 20.83 ns apart, so rounding to nanoseconds
    // and back is exact.
    let ticks = (u128::from(nanos) * 6 + 62) / 125;
    Ticks(u64::try_from(ticks).unwrap_or(u64::MAX))
}

/// The MCAP file of a recording: the one in its folder, or the file itself.
#[must_use]
pub fn mcap_of(recording: &Path) -> PathBuf {
    match recording.is_dir() {
        true => recording.join(MCAP_FILE),
        false => recording.to_owned(),
    }
}

/// What can go wrong with a recording's files.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// A file or folder cannot be read or written.
    #[error("cannot {action} {path}: {source}", path = .path.display())]
    Io {
        /// What was tried.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The MCAP file cannot be written or read.
    #[error("{path}: {reason}", path = .path.display(), reason = mcap_reason(.source))]
    Mcap {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: mcap::McapError,
    },
    /// A message is not what its topic says.
    #[error("{topic}: {source}")]
    Message {
        /// The topic.
        topic: String,
        /// What is wrong.
        source: messages::CdrError,
    },
    /// A bag of a form that is not read.
    #[error(
        "{path} is {form}, which is not read: `{command}` makes one that is (Python package rosbags)",
        path = .path.display(),
        command = bag::conversion(.path)
    )]
    ForeignBag {
        /// The bag.
        path: PathBuf,
        /// What it is.
        form: &'static str,
    },
    /// There is no recording and no bag.
    #[error(
        "{path} is no recording: expected a folder with {MCAP_FILE}, or an MCAP file, found neither",
        path = .path.display()
    )]
    NoRecording {
        /// What was given.
        path: PathBuf,
    },
    /// `session.json` is not one.
    #[error("{path} is not a session file of this program: {reason}", path = .path.display())]
    Session {
        /// The file.
        path: PathBuf,
        /// Line and what was expected.
        reason: String,
    },
}

/// What is wrong, in the system's words where it was the system's refusal.
fn mcap_reason(error: &mcap::McapError) -> String {
    match error {
        mcap::McapError::Io(source) => source.to_string(),
        other => other.to_string(),
    }
}

impl RecordingError {
    /// Makes what the system said of a file into such an error; `action` is what was tried.
    pub fn io(action: &'static str, path: &Path) -> impl Fn(std::io::Error) -> Self {
        move |source| Self::Io {
            action,
            path: path.to_owned(),
            source,
        }
    }

    /// Makes what is wrong with an MCAP file into such an error.
    pub fn mcap(path: &Path) -> impl Fn(mcap::McapError) -> Self {
        move |source| Self::Mcap {
            path: path.to_owned(),
            source,
        }
    }

    /// Whether the disk is full (or the quota, or the largest file).
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
