//! Failures of `adb`.

use std::path::PathBuf;

use clock::PhoneNanos;

/// Folder on the phone in which the app saves (`StorageUtils.java`:323).
pub(super) const FOLDER: &str = "/sdcard/DCIM/OpenCamera";

/// Failure of a use of `adb`.
#[derive(Debug, thiserror::Error)]
pub enum AdbError {
    /// There is no `adb` on the `PATH`.
    #[error("`adb` is not on the PATH")]
    NoProgram,
    /// No phone is connected and authorized.
    #[error("`adb devices` lists no phone that is ready{}", others(states))]
    NoDevice {
        /// Serial number and state of each phone that is not ready.
        states: Vec<String>,
    },
    /// Several phones are connected where one is needed.
    #[error("`adb devices` lists several phones: {}", devices.join(", "))]
    SeveralDevices {
        /// Serial numbers of the phones that are ready.
        devices: Vec<String>,
    },
    /// There is no agent for the phone's processor.
    #[error(
        "there is no smartdepthsync-phone-agent for a phone of {processors:?} beside this program"
    )]
    NoAgent {
        /// Instruction sets of the phone, by Android's names.
        processors: String,
    },
    /// No phone has a video with the phase.
    #[error("no file of frame timestamps in {FOLDER} of {} has the phase {}", devices.join(", "), phase.0)]
    NotFound {
        /// Serial numbers of the phones that were searched.
        devices: Vec<String>,
        /// The timestamp that was searched for.
        phase: PhoneNanos,
    },
    /// `adb` failed, or a copy differs in size from the file on the phone.
    #[error("`adb {command}` failed: {reason}")]
    Failed {
        /// Arguments of `adb`.
        command: String,
        /// Output of `adb`, or the difference.
        reason: String,
    },
    /// A file on this computer, or `adb` itself, cannot be used.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// The attempted action, as a verb phrase that the path follows.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// The caller cancelled it.
    #[error("stopped on request")]
    Cancelled,
}

fn others(states: &[String]) -> String {
    match states {
        [] => String::new(),
        states => format!(" ({})", states.join(", ")),
    }
}
