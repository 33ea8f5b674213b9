//! The errors of a session and of its steps.

use std::path::PathBuf;
use std::time::Duration;

use board::transport::LinkError;
use board::{BoardError, reset_cause};
use phone::PhoneError;
use phone::adb::AdbError;
use protocol::{ResetCause, Ticks, TrainState};
use recording::RecordingError;
use recording::profile::ProfileError;
use serde::Serialize;

use crate::devices::RecorderError;
use clock::alignment::AlignmentError;

/// The part of a setup that is at fault where a check is bad.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Fault {
    /// The rig, its wiring or its profile.
    Rig,
    /// The program that records the depth camera.
    Recorder,
    /// The disk.
    Disk,
}

/// The error of a session or of a step. Advice about it is left to the program.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// A call to the board failed.
    #[error(transparent)]
    Board(#[from] BoardError),
    /// A request to a phone failed.
    #[error("{}{error}", phone_prefix(name.as_deref(), address, error))]
    Phone {
        /// Name of the phone, if the rig has several.
        name: Option<String>,
        /// Address of the phone.
        address: String,
        /// The error of the request.
        error: PhoneError,
    },
    /// The phone's clock must be followed, and cannot be read.
    #[error(transparent)]
    PhoneClock(PhoneError),
    /// The profile has no address of a phone.
    #[error("the profile has no address of {name:?}")]
    NoAddress {
        /// The phone's name.
        name: String,
    },
    /// The phone's samples of a twist cannot be written.
    #[error(transparent)]
    Samples(PhoneError),
    /// The depth recorder cannot be started.
    #[error(transparent)]
    Recorder(#[from] RecorderError),
    /// The recording or a file of it cannot be written.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The rig profile has a wrong value.
    #[error(transparent)]
    Profile(#[from] ProfileError),
    /// The board gave no scale for its IMU.
    #[error("the board gave no scale for its IMU")]
    NoScale,
    /// A check found that a recording will not work.
    #[error("{name}: {found}")]
    Check {
        /// Name of the check.
        name: String,
        /// Its result in words.
        found: String,
        /// Its next step.
        next_step: Option<String>,
        /// The part at fault.
        fault: Fault,
    },
    /// No twist passed the gates.
    #[error("none of {tries} twists gave a trustworthy relation of the clocks")]
    Twists {
        /// Number of twists that were made.
        tries: usize,
    },
    /// The twist at the end did not pass the gates.
    #[error("the second twist was refused")]
    SecondTwist,
    /// Nothing relates the clocks.
    #[error("the clocks were not related")]
    NoClock,
    /// There is no video to align to.
    #[error("the phone's video was skipped")]
    NoVideo,
    /// The trigger cannot be aligned.
    #[error(transparent)]
    Alignment(#[from] AlignmentError),
    /// The trigger is not on its grid.
    #[error("the trigger did not arrive at pulse {pulse} ({state:?})")]
    NotArrived {
        /// Number of the pulse that was planned as the first on the grid.
        pulse: u64,
        /// State of the train.
        state: TrainState,
    },
    /// A lost link did not come back.
    #[error("the link to the board did not come back within {} s ({error})", waited.as_secs())]
    LinkLost {
        /// Time for which the session waited.
        waited: Duration,
        /// The error with which the link was lost.
        error: LinkError,
    },
    /// The board was reset before anything was recorded.
    #[error(
        "the board was reset ({}) after {:.3} s of its time: the relation of the clocks is void, \
         so the session ends here",
        reset_cause(*cause), at.as_secs_f64()
    )]
    BoardReset {
        /// Latest board time before the reset.
        at: Ticks,
        /// The cause that the board reports.
        cause: ResetCause,
    },
    /// The recording's folder was deleted or moved.
    #[error("the recording in {} was deleted or moved", folder.display())]
    RecordingMoved {
        /// Its former path.
        folder: PathBuf,
    },
    /// The disk is full.
    #[error("the disk is full: {} MB are left", free / 1_000_000)]
    DiskFull {
        /// Free space, bytes.
        free: u64,
    },
    /// An output would be slower than the board can make it.
    #[error("{name} cannot run at every {every}th pulse: its period would be more than a second")]
    OutputTooSlow {
        /// Name of the sensor on it.
        name: String,
        /// Number of trigger pulses per pulse of this output.
        every: u32,
    },
    /// Each auxiliary output has a sensor, so that none is left for the LED.
    #[error("the profile has a sensor on each of the outputs 2 to 4: none is left for the LED")]
    NoOutputForLed,
    /// The profile's settings of the lidar are wrong.
    #[error("{0}")]
    Lidar(String),
    /// This computer's clock cannot be given to a lidar.
    #[error("this computer's clock is set before 1970")]
    ClockBefore1970,
}

impl SessionError {
    /// Returns true if repeating the step may help.
    #[must_use]
    pub fn is_repeatable(&self) -> bool {
        match self {
            Self::Board(error) => matches!(error, BoardError::Refused { .. }),
            Self::Phone { error, .. } | Self::PhoneClock(error) => is_phone_fault(error),
            Self::Recorder(_)
            | Self::Check { .. }
            | Self::Twists { .. }
            | Self::SecondTwist
            | Self::NoClock
            | Self::Alignment(_) => true,
            _ => false,
        }
    }

    /// Returns true if nothing more can be written.
    #[must_use]
    pub const fn is_storage(&self) -> bool {
        matches!(
            self,
            Self::Recording(_)
                | Self::Samples(_)
                | Self::RecordingMoved { .. }
                | Self::DiskFull { .. }
        )
    }
}

/// Returns true if the phone failed, and not the request or the disk of this computer.
#[must_use]
pub fn is_phone_fault(error: &PhoneError) -> bool {
    !matches!(
        error.cause(),
        PhoneError::Address { .. }
            | PhoneError::Argument(_)
            | PhoneError::TargetExists { .. }
            | PhoneError::File { .. }
            | PhoneError::Cancelled { .. }
            | PhoneError::Adb(AdbError::Cancelled | AdbError::Io { .. })
    )
}

/// Returns the name and address of a phone as the beginning of an error's message.
fn phone_prefix(name: Option<&str>, address: &str, error: &PhoneError) -> String {
    let mut text = name.map_or(String::new(), |name| format!("phone {name}: "));
    if is_phone_fault(error) && !error.to_string().contains(address) {
        text += &format!("the phone at {address}: ");
    }
    text
}

/// The reason for which a step stops.
#[derive(Debug)]
pub enum Stop {
    /// The user interrupted it.
    Interrupted,
    /// The board was reset during the recording, which is complete up to the reset.
    BoardReset,
    /// Something failed.
    Failed(SessionError),
}

impl<E: Into<SessionError>> From<E> for Stop {
    fn from(error: E) -> Self {
        Self::Failed(error.into())
    }
}
