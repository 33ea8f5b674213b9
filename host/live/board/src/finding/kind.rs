//! Kinds of findings: the words that log, JSON files and tests compare.

use std::fmt::{self, Display, Formatter};

use serde::{Deserialize, Serialize};

/// The kind of a finding.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum FindingKind {
    /// An event of a session.
    Event(EventKind),
    /// A check or a part of a report, by its name.
    Named(String),
}

impl From<EventKind> for FindingKind {
    fn from(kind: EventKind) -> Self {
        Self::Event(kind)
    }
}

impl From<String> for FindingKind {
    fn from(name: String) -> Self {
        Self::Named(name)
    }
}

impl From<&str> for FindingKind {
    fn from(name: &str) -> Self {
        Self::Named(name.to_owned())
    }
}

impl PartialEq<EventKind> for FindingKind {
    fn eq(&self, other: &EventKind) -> bool {
        matches!(self, Self::Event(kind) if kind == other)
    }
}

impl PartialEq<&str> for FindingKind {
    fn eq(&self, other: &&str) -> bool {
        matches!(self, Self::Named(name) if name == other)
    }
}

impl Display for FindingKind {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Event(kind) => kind.fmt(f),
            Self::Named(name) => f.write_str(name),
        }
    }
}

/// The kind of a session's event: the word under which the recording's log and the
/// `problems` of `session.json` keep it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EventKind {
    /// Board and phones have answered.
    Connected,
    /// The phone's clock is followed, or not.
    Tracking,
    /// A check before the recording was not good.
    Preflight,
    /// Messages are missing on the link.
    Lost,
    /// A frame was damaged on the link.
    Damaged,
    /// A twist, and the relation of the clocks that it gave.
    Twist,
    /// A twist did not pass the gates.
    TwistRefused,
    /// A twist contradicts the earlier ones.
    TwistsContradict,
    /// The learnt skew does not fit the twists.
    LearntSkew,
    /// The phase is less certain than a twist must make it.
    TwistDue,
    /// The twist at the end failed.
    SecondTwist,
    /// The depth recorder has started.
    DepthRecorder,
    /// The depth recorder ended by itself, with an error, or not at all.
    DepthRecorderGone,
    /// The trigger has started.
    Trigger,
    /// The trigger could not be stopped.
    TriggerNotStopped,
    /// An edge of the trigger came late.
    TriggerLate,
    /// The trigger moves onto the phone's frames.
    Align,
    /// The trigger is on its grid.
    Arrived,
    /// The board did not report that the trigger is on its grid.
    ArrivalUnconfirmed,
    /// The frames of another phone, relative to the grid.
    Placement,
    /// An auxiliary output has started.
    Output,
    /// An auxiliary output is on its grid.
    OutputArrived,
    /// An auxiliary output could not be stopped.
    OutputsNotStopped,
    /// Pulses of an auxiliary output are missing on the link.
    OutputPulsesLost,
    /// A lidar receives the time.
    Gnss,
    /// Reports of pulses per second are missing on the link.
    PpsLost,
    /// A video has started, was stopped, or was downloaded.
    Video,
    /// A video has ended before its time.
    VideoEnded,
    /// A video was not downloaded.
    VideoNotFetched,
    /// The other files of a video.
    PhoneFiles,
    /// A phone does not answer.
    PhoneAway,
    /// A phone answers again.
    PhoneBack,
    /// A phone records no video.
    PhoneLeftOut,
    /// A phone's video could not be stopped.
    PhoneLost,
    /// The recorded span begins.
    Recording,
    /// A mark.
    Marker,
    /// The phone's clock can no longer be read.
    TrackLost,
    /// The phone's clock is followed again.
    TrackBack,
    /// The board was reset.
    BoardReset,
    /// A board that is only monitored was reset.
    Restarted,
    /// The link to the board is lost.
    LinkLost,
    /// The link to the board is back.
    LinkBack,
    /// The board sends no messages.
    BoardQuiet,
    /// The board says hello.
    Hello,
    /// A message has a time far from all others.
    TimeOdd,
    /// Message numbers are repeated or out of order.
    NumbersDisordered,
    /// Messages about pulses are missing on the link.
    PulseMessagesLost,
    /// Pulses were not made.
    PulsesMissing,
    /// Pulses arrive again.
    PulsesBack,
    /// A pulse is off its grid.
    PhaseOff,
    /// Pulses are on their grid again.
    PhaseBack,
    /// Pulses were not seen on the trigger's wire.
    ReadbackMissing,
    /// Samples of the IMU are missing.
    ImuGap,
    /// Samples of the IMU arrive again.
    ImuBack,
    /// The IMU does not answer.
    ImuGone,
    /// Samples of the IMU were read late.
    ImuLate,
    /// The IMU was set up again after a fault.
    ImuRecovered,
    /// The board has restarted its USB core.
    UsbRestarted,
    /// Edges on the strobe input were lost.
    CapturesLost,
    /// Status messages are missing on the link.
    StatusLost,
    /// The disk is nearly full.
    DiskNearlyFull,
    /// The session failed.
    Failed,
    /// Further problems were not kept one by one.
    More,
}

impl Display for EventKind {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}
