//! The reasons for which a session, or a step of it, fails.

use std::path::PathBuf;
use std::time::Duration;

use board::transport::LinkError;
use board::{BoardError, reset_cause};
use phone::PhoneError;
use phone::adb::AdbError;
use protocol::{ResetCause, Ticks, TrainState};
use recording::RecordingError;
use recording::profile::ProfileError;

use crate::checks::Fault;
use crate::devices::RecorderError;
use clock::alignment::AlignmentError;

/// Why a session, or a step of it, failed. What to do about it is the program's to say.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// The board.
    #[error(transparent)]
    Board(#[from] BoardError),
    /// A phone.
    #[error("{}{error}", of_phone(name.as_deref(), address, error))]
    Phone {
        /// Its name, where there are several.
        name: Option<String>,
        /// Its address.
        address: String,
        /// What is wrong.
        error: PhoneError,
    },
    /// The phone's clock is to be followed, and cannot be.
    #[error(transparent)]
    PhoneClock(PhoneError),
    /// The profile does not say where a phone is.
    #[error("the profile has no address of {name:?}")]
    NoAddress {
        /// The phone's name.
        name: String,
    },
    /// The phone's samples cannot be written.
    #[error(transparent)]
    Samples(PhoneError),
    /// The depth recorder.
    #[error(transparent)]
    Recorder(#[from] RecorderError),
    /// The recording, or a file of it.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The rig profile.
    #[error(transparent)]
    Profile(#[from] ProfileError),
    /// The IMU's counts have no meaning.
    #[error("the board gave no scale for its IMU")]
    NoScale,
    /// A check found that a recording will not work.
    #[error("{name}: {found}")]
    Check {
        /// The check.
        name: String,
        /// What it found.
        found: String,
        /// What to do about it.
        next_step: Option<String>,
        /// Where it lies.
        fault: Fault,
    },
    /// No twist passed the gates.
    #[error("none of {tries} twists gave a trustworthy relation of the clocks")]
    Twists {
        /// How many were made.
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
        /// The pulse at which it was planned to be.
        pulse: u64,
        /// The train's state.
        state: TrainState,
    },
    /// A lost link did not come back.
    #[error("the link to the board did not come back within {} s ({error})", waited.as_secs())]
    LinkLost {
        /// How long it was waited for.
        waited: Duration,
        /// How it was lost.
        error: LinkError,
    },
    /// The board was reset before anything was recorded.
    #[error(
        "the board was reset ({}) after {:.3} s of its time: the relation of the clocks is void, \
         so the session ends here",
        reset_cause(*cause), at.as_secs_f64()
    )]
    BoardReset {
        /// The latest time before it.
        at: Ticks,
        /// Why it was reset, as it says.
        cause: ResetCause,
    },
    /// The recording is not in its place any more.
    #[error("the recording in {} was deleted or moved", folder.display())]
    RecordingMoved {
        /// Where it was.
        folder: PathBuf,
    },
    /// The disk is full.
    #[error("the disk is full: {} MB are left", free / 1_000_000)]
    DiskFull {
        /// Bytes that are left.
        free: u64,
    },
    /// An output would be slower than the board can make it.
    #[error("{name} cannot run at every {every}th pulse: its period would be more than a second")]
    OutputTooSlow {
        /// The sensor on it.
        name: String,
        /// Pulses of the trigger to one of it.
        every: u32,
    },
    /// The profile's lidar cannot be served.
    #[error("{0}")]
    Lidar(String),
    /// This computer's clock cannot be given to a lidar.
    #[error("this computer's clock is set before 1970")]
    ClockBefore1970,
}

impl SessionError {
    /// Tells whether trying the same step again may help.
    #[must_use]
    pub fn is_repeatable(&self) -> bool {
        match self {
            Self::Board(error) => matches!(error, BoardError::Refused { .. }),
            Self::Phone { error, .. } | Self::PhoneClock(error) => is_of_phone(error),
            Self::Recorder(_)
            | Self::Check { .. }
            | Self::Twists { .. }
            | Self::SecondTwist
            | Self::NoClock
            | Self::Alignment(_) => true,
            _ => false,
        }
    }

    /// Tells whether nothing more can be written.
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

/// Tells whether it is the phone that failed, and not the request or this computer's disk.
#[must_use]
pub fn is_of_phone(error: &PhoneError) -> bool {
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

/// The phone that an error is about, before the error's own words.
fn of_phone(name: Option<&str>, address: &str, error: &PhoneError) -> String {
    let mut text = name.map_or(String::new(), |name| format!("phone {name}: "));
    if is_of_phone(error) && !error.to_string().contains(address) {
        text += &format!("the phone at {address}: ");
    }
    text
}

/// Why a step does not go on.
#[derive(Debug)]
pub enum Stop {
    /// The user wants it.
    Interrupted,
    /// The board was reset while it recorded: the recording is complete up to there.
    BoardReset,
    /// Something failed.
    Failed(SessionError),
}

impl<E: Into<SessionError>> From<E> for Stop {
    fn from(error: E) -> Self {
        Self::Failed(error.into())
    }
}
