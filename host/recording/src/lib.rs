//! A recording: one folder with everything of one session.
//!
//! ```text
//! 2026-01-31_14-03-27/
//!   recording.mcap   streams of the board, what was decided, raw link frames
//!   session.json     everything that was decided, with versions and profile
//!   ...              twists, the phone's and the depth recorder's files
//! ```
//!
//! - [`folder`]: a readable name that never overwrites.
//! - [`profile`]: what is fixed about one rig.
//! - [`messages`]: the ROS 2 types in the file.
//! - [`writer`]: writes it, so that a kill loses at most a second.
//! - [`reader`]: reads it, whole or broken off.
//! - [`scan`]: walks its records over any damage.
//! - [`session_file`]: what `session.json` holds.
//!
//! The format is described in `docs/formats.md`.

pub mod folder;
pub mod messages;
pub mod profile;
pub mod reader;
pub mod scan;
pub mod session_file;
pub mod writer;

use std::path::PathBuf;

/// Name of the MCAP file in the folder.
pub const MCAP_FILE: &str = "recording.mcap";

/// Name of the session file in the folder.
pub const SESSION_FILE: &str = "session.json";

/// The topics of a recording.
pub mod topic {
    /// [`super::messages::Imu`].
    pub const IMU: &str = "/board/imu";
    /// [`super::messages::Temperature`].
    pub const TEMPERATURE: &str = "/board/imu_temperature";
    /// [`super::messages::TimeReference`]: trigger pulses.
    pub const TRIGGER: &str = "/board/trigger";
    /// [`super::messages::Pulse`]: the same pulses in full.
    pub const PULSE: &str = "/board/trigger_pulse";
    /// [`super::messages::TimeReference`]: edges on the strobe input.
    pub const STROBE: &str = "/board/strobe";
    /// [`super::messages::Capture`]: the same edges in full.
    pub const CAPTURE: &str = "/board/strobe_capture";
    /// [`super::messages::Pulse`]: pulses of the further outputs; `frame_id` says
    /// whose.
    pub const OUTPUT: &str = "/board/output_pulse";
    /// [`super::messages::TimeReference`]: pulses per second; `time_ref` is the UTC
    /// that a lidar was told.
    pub const GNSS: &str = "/board/gnss";
    /// [`super::messages::DiagnosticArray`]: once a second.
    pub const STATUS: &str = "/board/status";
    /// [`super::messages::LinkFrame`]: every frame of the link.
    pub const LINK: &str = "/link/frames";
    /// [`super::messages::ClockModel`].
    pub const CLOCK: &str = "/session/clock_model";
    /// [`super::messages::BoardRun`]: the board was reset.
    pub const RUN: &str = "/session/board_run";
    /// [`super::messages::ClockModel`] of a further phone; `frame_id` says whose.
    pub const PHONE_CLOCK: &str = "/session/phone_clock_model";
    /// [`super::messages::TimeReference`]: markers.
    pub const MARKER: &str = "/session/markers";
    /// [`super::messages::TimeReference`]: wall clock of the host.
    pub const HOST_TIME: &str = "/session/host_time";
    /// [`super::messages::Log`]: what was said and what went wrong.
    pub const LOG: &str = "/session/log";
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
