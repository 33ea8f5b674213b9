//! The events of a session: what it does and what it finds, in order.
//!
//! One type for all who want to know: the recording's log and `session.json`, the live
//! view, plain lines, JSON lines and tests. An event is data; [`Display`](std::fmt::Display)
//! gives the sentence that the recording's log keeps of it, as an error does.

use std::path::PathBuf;
use std::sync::Arc;

use board::finding::{Finding, Severity};
use board::imu::{Sample, Scale};
use clock::ClockRelation;
use clock::alignment::Placement;
use clock::rates::RateChange;
use protocol::{DeviceToHost, ResetCause, Ticks};
use recording::session_file::{Alignment, SessionOutcome, Video};
use serde::{Serialize, Serializer};

use crate::devices::RecorderEnd;
use crate::error::SessionError;

mod text;

/// An event with its board time.
#[derive(Clone, Debug, Serialize)]
pub struct Stamped {
    /// Latest board time that was handled.
    pub at: Ticks,
    /// What happened.
    #[serde(flatten)]
    pub event: SessionEvent,
}

/// The part of a session that runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(tag = "name", rename_all = "snake_case")]
pub enum Phase {
    /// Board and phones are reached, the recording's folder is made.
    #[default]
    Connecting,
    /// Both sides are checked.
    Checking,
    /// Waits for the time of the next twist.
    BetweenTwists,
    /// The twist with this number, counted from 1.
    Twisting {
        /// Its number.
        number: usize,
    },
    /// The depth recorder is started.
    StartingRecorder,
    /// The trigger is started, and its wire is checked.
    StartingTrigger,
    /// The phones' videos are started.
    StartingVideos,
    /// The trigger moves onto the phone's frames.
    Aligning,
    /// Records, since this board time.
    Recording {
        /// The beginning of the recorded span.
        since: Ticks,
    },
    /// Devices are stopped.
    Stopping,
    /// Videos and files are fetched from the phones.
    Fetching,
    /// Files are finished.
    Closing,
    /// Nothing more is done.
    Ended,
}

/// A phone, as events name it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PhoneName {
    /// Its name in the profile.
    pub name: String,
    /// True if it is the only one, which needs no name.
    pub is_only: bool,
}

impl PhoneName {
    /// Its name after a comma, where there are several.
    fn suffix(&self) -> String {
        match self.is_only {
            true => String::new(),
            false => format!(", {}", self.name),
        }
    }
}

impl Serialize for PhoneName {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.name)
    }
}

/// A step that can be repeated or left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Step {
    /// Reach board and phones.
    Connect,
    /// The checks.
    Checks,
    /// A twist.
    Twist,
    /// The depth recorder.
    Recorder,
    /// The trigger.
    Trigger,
    /// The phones' videos.
    Videos,
    /// The twist at the end.
    SecondTwist,
    /// The download of a video.
    Download,
}

/// A question to the person.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(tag = "question", rename_all = "snake_case")]
pub enum Prompt {
    /// Try a step again that failed, leave it out, or quit?
    Repeat {
        /// The step.
        step: Step,
        /// True if it can be left out.
        can_skip: bool,
    },
    /// Begin a twist?
    Twist {
        /// How long it will take, s.
        length_s: u32,
        /// True if it can be left out.
        can_skip: bool,
    },
    /// The twist was good: go on, or twist once more?
    TwistGood,
    /// The twist was accepted and is weak: twist once more, or go on all the same?
    TwistWeak,
    /// The twist was refused: twist again?
    TwistAgain,
    /// What was asked for cannot be left out.
    CannotSkip,
}

/// What a twist says of one phone's clock.
#[derive(Clone, Debug, Serialize)]
pub struct TwistEstimate {
    /// The twist's number.
    pub number: usize,
    /// The phone.
    pub phone: PhoneName,
    /// The relation of the clocks.
    pub clock: ClockRelation,
}

/// The phase where the phone's clock is followed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Tracked {
    /// By how much the trigger is late on the phone's frames, µs.
    pub phase_us: f64,
    /// 1-sigma of it, µs.
    pub sigma_us: f64,
    /// True if both clocks are read.
    pub holds: bool,
}

/// What happened in a session.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum SessionEvent {
    /// Another part of the session runs.
    Phase {
        /// Which one.
        phase: Phase,
    },
    /// A question is asked.
    Prompt {
        /// The question.
        prompt: Prompt,
    },
    /// A step failed that can be repeated.
    StepFailed {
        /// The step.
        step: Step,
        /// Why.
        #[serde(serialize_with = "as_text")]
        error: Arc<SessionError>,
    },
    /// Board and phones have answered, and the recording's folder is there.
    Connected {
        /// The folder.
        folder: PathBuf,
        /// The board's ID.
        board: String,
        /// From the IMU's counts to SI units.
        #[serde(skip)]
        scale: Scale,
    },
    /// The IMU was set up again, with this scale.
    ScaleChanged {
        /// From its counts to SI units.
        #[serde(skip)]
        scale: Scale,
    },
    /// The phone's clock is followed.
    ClockFollowed {
        /// The phone, as what reads its clock names it.
        device: String,
    },
    /// The phone's clock is not followed.
    ClockNotFollowed {
        /// Why.
        reason: String,
    },
    /// Something was checked.
    Checked {
        /// What was found.
        check: Finding,
    },
    /// A message of the board.
    Board {
        /// The message.
        message: DeviceToHost,
        /// In SI units, if it is a sample of the IMU.
        #[serde(skip)]
        sample: Option<Sample>,
    },
    /// The disk, once a second.
    Disk {
        /// Free bytes.
        free: u64,
        /// Size of the recording.
        recorded: u64,
    },
    /// Messages of a stream are missing on the link.
    Lost {
        /// The stream.
        stream: String,
        /// How many.
        count: u32,
    },
    /// A frame was damaged on the link.
    Damaged {
        /// How.
        reason: String,
    },
    /// The next twist waits for its time.
    TwistDueIn {
        /// How long, s.
        seconds: f64,
    },
    /// A twist begins now.
    TwistStarted {
        /// Its number.
        number: usize,
        /// How long it takes, s.
        length_s: u32,
        /// An expected 1-sigma that is enough, µs.
        enough_us: f64,
    },
    /// The motion of a twist is complete.
    TwistFinished {
        /// Its number.
        number: usize,
    },
    /// A remark on a twist of a phone: what was left out, or is doubtful.
    TwistRemark {
        /// The twist's number.
        number: usize,
        /// The phone.
        phone: PhoneName,
        /// The remark.
        remark: String,
    },
    /// A twist relates the clocks.
    TwistAccepted(TwistEstimate),
    /// A twist did not pass the gates.
    TwistRefused {
        /// Its number.
        number: usize,
        /// The phone.
        phone: PhoneName,
        /// Why.
        reason: String,
    },
    /// A twist contradicts the earlier ones; it alone is used.
    TwistsContradict {
        /// The phone.
        phone: PhoneName,
    },
    /// The twists so far together.
    TwistsJoined {
        /// The phone.
        phone: PhoneName,
        /// The relation of the clocks.
        clock: ClockRelation,
        /// How its skew changes.
        change: RateChange,
    },
    /// The learnt skew does not fit the twists; it is not used.
    LearntSkewUnfit {
        /// What was learnt, ppm.
        learnt_ppm: f64,
        /// Its 1-sigma, ppm.
        sigma_ppm: f64,
        /// What the twists say, ppm.
        found_ppm: f64,
    },
    /// The twist at the end was left out.
    SecondTwistLeftOut,
    /// The twists at begin and end together.
    SecondTwistJoined {
        /// The phone.
        phone: PhoneName,
        /// The relation of the clocks.
        clock: ClockRelation,
    },
    /// The relation of a phone's clock is another from here on.
    ClockKnown {
        /// The phone's place in the profile.
        place: usize,
        /// The phone.
        phone: PhoneName,
        /// The relation.
        clock: ClockRelation,
    },
    /// The depth recorder runs.
    RecorderStarted,
    /// The depth recorder ended by itself.
    RecorderGone {
        /// How.
        end: RecorderEnd,
    },
    /// The depth recorder ended with an error when it was asked to stop.
    RecorderFailed {
        /// How.
        end: RecorderEnd,
    },
    /// The depth recorder did not stop in time and was killed.
    RecorderKilled {
        /// Its program.
        program: String,
        /// How long it was waited for, s.
        waited_s: u32,
    },
    /// The trigger runs.
    TriggerStarted {
        /// Its period, s.
        period_s: f64,
    },
    /// A phone records its video.
    VideoStarted {
        /// The phone.
        phone: PhoneName,
        /// What it answered.
        video: Video,
    },
    /// A phone whose video did not start was asked to stop.
    VideoUndone {
        /// The phone.
        phone: PhoneName,
        /// Why a video may run, if it does not stop.
        error: Option<String>,
    },
    /// A phone's video has ended before its time.
    VideoEnded {
        /// The phone.
        phone: PhoneName,
    },
    /// A phone does not say whether it records.
    PhoneAway {
        /// The phone.
        phone: PhoneName,
        /// Why.
        error: String,
    },
    /// A phone says again that it records.
    PhoneBack {
        /// The phone.
        phone: PhoneName,
    },
    /// A phone records no video.
    PhoneLeftOut {
        /// The phone.
        phone: PhoneName,
    },
    /// A remark on the alignment.
    AlignmentRemark {
        /// The remark.
        remark: String,
    },
    /// The trigger moves onto the phone's frames.
    Aligning {
        /// How far it moves, µs.
        shift_us: f64,
        /// Over how many frames.
        frames: u32,
        /// The alignment.
        alignment: Alignment,
    },
    /// A train is on its grid.
    Arrived {
        /// What it triggers.
        name: String,
        /// True if it is the camera's.
        is_camera: bool,
        /// The first pulse on the grid.
        pulse: u64,
        /// Ticks that are left to the grid.
        remaining: i64,
    },
    /// The arrival was not reported, but the train runs on the grid.
    ArrivalUnconfirmed,
    /// The frames of another phone, against the depth images.
    Placed {
        /// The phone.
        phone: PhoneName,
        /// Where they lie.
        placement: Placement,
    },
    /// An auxiliary output runs.
    OutputStarted {
        /// The sensor on it.
        name: String,
        /// Its number.
        output: u8,
        /// Its train, against the trigger's.
        rule: String,
    },
    /// A lidar gets the time.
    LidarStarted {
        /// Its name.
        name: String,
        /// Unix time of the board's tick 0, s.
        utc_at_zero: i64,
    },
    /// The recorded span begins.
    RecordingStarted {
        /// How long it will be, s; until stopped if there is none.
        length_s: Option<f64>,
    },
    /// A mark of the person, or one that was asked for before.
    Marked {
        /// Its board time.
        marked_at: Ticks,
        /// Its label.
        label: String,
    },
    /// The phase is known less well than a twist must know it.
    TwistDue {
        /// That much, 1-sigma, µs.
        limit_us: f64,
    },
    /// The phase, where the phone's clock is followed.
    Tracked {
        /// The phase; none while it is not known.
        tracked: Option<Tracked>,
    },
    /// The phone's clock cannot be read any more.
    TrackLost,
    /// The phone's clock is followed again.
    TrackBack,
    /// The board was reset: the recording ends here.
    BoardReset {
        /// Why, as it says.
        cause: ResetCause,
        /// Its latest time before.
        last: Ticks,
    },
    /// The link to the board is lost.
    LinkLost {
        /// How.
        reason: String,
        /// How long it is waited for, s; as long as the user wants if there is none.
        patience_s: Option<u64>,
    },
    /// The link to the board is there again.
    LinkBack {
        /// How long it was away, s of board time.
        away_s: f64,
    },
    /// No message has come for some time.
    BoardQuiet {
        /// How long, s.
        seconds: u64,
        /// Damaged frames that came so far.
        damaged: u32,
    },
    /// The board says hello.
    Hello,
    /// A message has a time far from all others.
    TimeOdd {
        /// That time.
        odd: Ticks,
    },
    /// The watch over the board's messages found something.
    Found {
        /// What.
        finding: Finding,
    },
    /// The disk is nearly full.
    DiskNearlyFull {
        /// Free bytes.
        free: u64,
    },
    /// A phone's video is not stopped yet; it is tried for some time.
    StopRetried {
        /// The phone.
        phone: PhoneName,
        /// Why it did not stop.
        error: String,
        /// For how long it is tried, s.
        patience_s: u64,
    },
    /// Something that runs could not be stopped.
    NotStopped {
        /// What.
        what: Device,
        /// Why.
        error: String,
    },
    /// The session failed; it is closed from here on.
    Failed {
        /// Why.
        error: String,
    },
    /// The twist at the end failed.
    SecondTwistFailed {
        /// Why.
        error: String,
    },
    /// A video was not downloaded.
    VideoNotFetched {
        /// Why.
        error: String,
    },
    /// A phone made no video, so none is downloaded.
    NoVideoToFetch {
        /// The phone.
        phone: PhoneName,
    },
    /// A download goes on.
    Downloading {
        /// The phone.
        phone: PhoneName,
        /// Bytes that are there.
        done: u64,
        /// Bytes in all.
        whole: u64,
    },
    /// A video was downloaded.
    VideoFetched {
        /// Where it is.
        path: PathBuf,
        /// Bytes.
        size: u64,
    },
    /// The other files of a video were copied.
    FilesFetched {
        /// The phone.
        phone: PhoneName,
        /// How many.
        count: usize,
    },
    /// The other files of a video are still on the phone.
    FilesNotFetched {
        /// The phone.
        phone: PhoneName,
        /// Why.
        error: String,
        /// Commands that copy them: by USB, and by MTP.
        commands: [String; 2],
    },
    /// The session is over.
    Ended {
        /// How it ended.
        outcome: SessionOutcome,
        /// The recording's folder.
        folder: PathBuf,
    },
}

/// Something that is stopped at the end.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Device {
    /// The trigger.
    Trigger,
    /// An auxiliary output, or the lidar's.
    Output,
    /// The video of a phone; all videos, if none is named.
    Video(Option<PhoneName>),
}

impl SessionEvent {
    /// The stable word under which the recording's log and the problems keep it; `None` of
    /// what is kept in another form, or not at all.
    #[must_use]
    pub fn kind(&self) -> Option<&str> {
        Some(match self {
            Self::Connected { .. } => "connected",
            Self::Checked { check } => match check.severity {
                Severity::Good => return None,
                Severity::Check | Severity::Bad => "preflight",
            },
            Self::Lost { .. } => "lost",
            Self::Damaged { .. } => "damaged",
            Self::TwistDueIn { .. }
            | Self::TwistStarted { .. }
            | Self::TwistRemark { .. }
            | Self::TwistAccepted(_)
            | Self::TwistsJoined { .. }
            | Self::SecondTwistLeftOut
            | Self::SecondTwistJoined { .. } => "twist",
            Self::TwistRefused { .. } => "twist_refused",
            Self::TwistsContradict { .. } => "twists_contradict",
            Self::LearntSkewUnfit { .. } => "learnt_skew",
            Self::RecorderStarted => "depth_recorder",
            Self::RecorderGone { .. }
            | Self::RecorderFailed { .. }
            | Self::RecorderKilled { .. } => "depth_recorder_gone",
            Self::TriggerStarted { .. } => "trigger",
            Self::VideoStarted { .. } | Self::VideoUndone { .. } | Self::VideoFetched { .. } => {
                "video"
            }
            Self::VideoEnded { .. } => "video_ended",
            Self::PhoneAway { .. } => "phone_away",
            Self::PhoneBack { .. } => "phone_back",
            Self::PhoneLeftOut { .. } => "phone_left_out",
            Self::AlignmentRemark { .. } | Self::Aligning { .. } => "align",
            Self::Arrived { is_camera, .. } => match is_camera {
                true => "arrived",
                false => "output_arrived",
            },
            Self::ArrivalUnconfirmed => "arrival_unconfirmed",
            Self::Placed { .. } => "placement",
            Self::OutputStarted { .. } => "output",
            Self::LidarStarted { .. } => "gnss",
            Self::RecordingStarted { .. } => "recording",
            Self::Marked { .. } => "marker",
            Self::TwistDue { .. } => "twist_due",
            Self::TrackLost => "track_lost",
            Self::TrackBack => "track_back",
            Self::BoardReset { .. } => "board_reset",
            Self::LinkLost { .. } => "link_lost",
            Self::LinkBack { .. } => "link_back",
            Self::BoardQuiet { .. } => "board_quiet",
            Self::Hello => "hello",
            Self::TimeOdd { .. } => "time_odd",
            Self::Found { finding } => &finding.kind,
            Self::DiskNearlyFull { .. } => "disk_nearly_full",
            Self::NotStopped { what, .. } => match what {
                Device::Trigger => "trigger_not_stopped",
                Device::Output => "outputs_not_stopped",
                Device::Video(_) => "phone_lost",
            },
            Self::Failed { .. } => "failed",
            Self::SecondTwistFailed { .. } => "second_twist",
            Self::VideoNotFetched { .. } | Self::NoVideoToFetch { .. } => "video_not_fetched",
            Self::FilesFetched { .. } | Self::FilesNotFetched { .. } => "phone_files",
            Self::Phase { .. }
            | Self::Prompt { .. }
            | Self::StepFailed { .. }
            | Self::ScaleChanged { .. }
            | Self::ClockFollowed { .. }
            | Self::ClockNotFollowed { .. }
            | Self::Board { .. }
            | Self::Disk { .. }
            | Self::TwistFinished { .. }
            | Self::ClockKnown { .. }
            | Self::Tracked { .. }
            | Self::StopRetried { .. }
            | Self::Downloading { .. }
            | Self::Ended { .. } => return None,
        })
    }

    /// How bad it is.
    #[must_use]
    pub const fn severity(&self) -> Severity {
        match self {
            Self::Checked { check } => check.severity,
            Self::Found { finding } => finding.severity,
            Self::Lost { .. }
            | Self::Damaged { .. }
            | Self::TwistRefused { .. }
            | Self::TwistsContradict { .. }
            | Self::LearntSkewUnfit { .. }
            | Self::PhoneAway { .. }
            | Self::PhoneLeftOut { .. }
            | Self::ArrivalUnconfirmed
            | Self::TwistDue { .. }
            | Self::TrackLost
            | Self::BoardQuiet { .. }
            | Self::TimeOdd { .. }
            | Self::DiskNearlyFull { .. } => Severity::Check,
            Self::RecorderGone { .. }
            | Self::RecorderFailed { .. }
            | Self::RecorderKilled { .. }
            | Self::VideoEnded { .. }
            | Self::BoardReset { .. }
            | Self::LinkLost { .. }
            | Self::NotStopped { .. }
            | Self::Failed { .. }
            | Self::SecondTwistFailed { .. }
            | Self::VideoNotFetched { .. }
            | Self::NoVideoToFetch { .. } => Severity::Bad,
            _ => Severity::Good,
        }
    }

    /// Tells whether something is missing or wrong in the recording, which makes the outcome
    /// "with loss".
    #[must_use]
    pub const fn is_problem(&self) -> bool {
        match self {
            Self::Found { .. } => !matches!(self.severity(), Severity::Good),
            Self::PhoneLeftOut { .. } | Self::ArrivalUnconfirmed | Self::TimeOdd { .. } => true,
            Self::Checked { .. } => false,
            _ => matches!(self.severity(), Severity::Bad),
        }
    }
}

fn as_text<S: Serializer>(error: &Arc<SessionError>, to: S) -> Result<S::Ok, S::Error> {
    to.collect_str(error)
}
