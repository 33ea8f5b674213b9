//! Phases, steps, questions and names that events carry.

use std::fmt::{self, Display, Formatter};

use clock::ClockRelation;
use protocol::Ticks;
use serde::{Serialize, Serializer};

/// The part of a session that runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(tag = "name", rename_all = "snake_case")]
pub enum Phase {
    /// Connects to board and phones, and creates the recording's folder.
    #[default]
    Connecting,
    /// Checks both sides.
    Checking,
    /// Waits for the time of the next twist.
    BetweenTwists,
    /// Makes a twist.
    Twisting {
        /// Its number, counted from 1.
        number: usize,
    },
    /// Starts the depth recorder.
    StartingRecorder,
    /// Starts the trigger and checks its wire.
    StartingTrigger,
    /// Starts the phones' videos.
    StartingVideos,
    /// Moves the trigger onto the phone's frames.
    Aligning,
    /// Records.
    Recording {
        /// Board time at which the recorded span began.
        since: Ticks,
    },
    /// Stops the devices.
    Stopping,
    /// Downloads videos and files from the phones.
    Fetching,
    /// Finishes the files.
    Closing,
    /// The session is over.
    Ended,
}

/// The name of a phone in events.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PhoneName {
    /// Name in the profile.
    pub name: String,
    /// True if the rig has no other phone, so that sentences need no name.
    pub is_only: bool,
}

impl PhoneName {
    /// Returns the name after a comma, or nothing if the rig has no other phone.
    pub(super) fn suffix(&self) -> String {
        if self.is_only {
            String::new()
        } else {
            format!(", {}", self.name)
        }
    }
}

impl Display for PhoneName {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        if self.is_only {
            f.write_str("the phone")
        } else {
            write!(f, "phone {}", self.name)
        }
    }
}

impl Serialize for PhoneName {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.name)
    }
}

/// A step that can be repeated or skipped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Step {
    /// The connection to board and phones.
    Connect,
    /// The checks.
    Checks,
    /// A twist before the recording.
    Twist,
    /// The start of the depth recorder.
    Recorder,
    /// The start of the trigger.
    Trigger,
    /// The start of the phones' videos.
    Videos,
    /// The twist at the end.
    SecondTwist,
    /// The download of a video.
    Download,
}

/// A question to the operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(tag = "question", rename_all = "snake_case")]
pub enum Prompt {
    /// Repeat a step that failed, skip it, or quit?
    Repeat {
        /// The step.
        step: Step,
        /// True if it can be skipped.
        can_skip: bool,
    },
    /// Begin a twist?
    Twist {
        /// Length of the twist, s.
        length_s: u32,
        /// True if it can be skipped.
        can_skip: bool,
    },
    /// The twist was good: continue, or twist once more?
    TwistGood,
    /// The twist was accepted but is weak: twist once more, or continue anyway?
    TwistWeak,
    /// The twist was refused: twist again?
    TwistAgain,
    /// The step that the operator wanted to skip cannot be skipped.
    CannotSkip,
}

/// The relation of a phone's clock to the board's, from one twist.
#[derive(Clone, Debug, Serialize)]
pub struct TwistEstimate {
    /// Number of the twist, counted from 1.
    pub number: usize,
    /// The phone.
    pub phone: PhoneName,
    /// The relation of the clocks.
    pub clock: ClockRelation,
}

/// The phase of the trigger while the phone's clock is followed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Tracked {
    /// Delay of the trigger relative to the phone's frames, µs.
    pub phase_us: f64,
    /// 1-sigma of the delay, µs.
    pub sigma_us: f64,
    /// True if both clocks are being read.
    pub holds: bool,
}

/// A device that is stopped at the end of a session.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Device {
    /// The trigger.
    Trigger,
    /// An auxiliary output, or the lidar's.
    Output,
    /// The video of a phone; all videos, if no phone is named.
    Video(Option<PhoneName>),
}
