//! The events of a session: what it does and what it finds, in order.
//!
//! All who follow a session consume the same type: the recording's log and `session.json`, the
//! live view, plain lines, JSON lines and tests. An event is data. What is said about it, and
//! what the operator can do, is in one table, [`SessionEvent::notice`].
//!
//! A new event is a variant here and a row there.

use std::path::PathBuf;
use std::sync::Arc;

use board::finding::Finding;
use board::imu::{Sample, Scale};
use clock::ClockRelation;
use clock::alignment::Placement;
use clock::rates::RateChange;
use protocol::{DeviceToHost, Output, ResetCause, Ticks};
use recording::session_file::{Alignment, SessionOutcome, Video};
use recording::strobes::SeenExposures;
use serde::{Serialize, Serializer};

use crate::devices::RecorderEnd;
use crate::error::SessionError;

mod notice;
mod parts;

pub use notice::Notice;
pub use parts::{Device, Phase, PhoneName, Prompt, Step, Tracked, TwistEstimate};

/// An event with its board time.
#[derive(Clone, Debug, Serialize)]
pub struct Stamped {
    /// Latest board time that had been handled.
    pub at: Ticks,
    /// The event.
    #[serde(flatten)]
    pub event: SessionEvent,
}

/// An event of a session.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum SessionEvent {
    /// Another part of the session runs.
    Phase {
        /// The part.
        phase: Phase,
    },
    /// The operator is asked a question.
    Prompt {
        /// The question.
        prompt: Prompt,
    },
    /// A step that can be repeated has failed.
    StepFailed {
        /// The step.
        step: Step,
        /// The reason.
        #[serde(serialize_with = "as_text")]
        error: Arc<SessionError>,
    },
    /// Board and phones have answered, and the recording's folder exists.
    Connected {
        /// The recording's folder.
        folder: PathBuf,
        /// ID of the board, in hex.
        board: String,
        /// Conversion from the IMU's counts to SI units.
        #[serde(skip)]
        scale: Scale,
    },
    /// The IMU was set up again.
    ScaleChanged {
        /// Its new conversion from counts to SI units.
        #[serde(skip)]
        scale: Scale,
    },
    /// The phone's clock is followed from here on.
    ClockFollowed {
        /// Name of the phone in the program that reads its clock.
        device: String,
    },
    /// The phone's clock is not followed.
    ClockNotFollowed {
        /// The reason.
        reason: String,
    },
    /// A check was made.
    Checked {
        /// Its result.
        check: Finding,
    },
    /// The board sent a message.
    Board {
        /// The message.
        message: DeviceToHost,
        /// The same in SI units, if it is a sample of the IMU.
        #[serde(skip)]
        sample: Option<Sample>,
    },
    /// The state of the disk, once a second.
    Disk {
        /// Free space, bytes.
        free: u64,
        /// Size of the recording, bytes.
        recorded: u64,
    },
    /// Messages of a stream are missing on the link.
    Lost {
        /// Name of the stream.
        stream: String,
        /// Number of missing messages.
        count: u32,
    },
    /// A frame was damaged on the link.
    Damaged {
        /// The error of the decoder.
        reason: String,
    },
    /// The session waits for the time of the next twist.
    TwistDueIn {
        /// Time until it begins, s.
        seconds: f64,
    },
    /// A twist begins.
    TwistStarted {
        /// Number of the twist, counted from 1.
        number: usize,
        /// Length of the twist, s.
        length_s: u32,
        /// Expected 1-sigma of the clock offset at which the motion is sufficient, µs.
        enough_us: f64,
    },
    /// The motion of a twist is complete.
    TwistFinished {
        /// Number of the twist.
        number: usize,
    },
    /// Data of a twist were left out, or are doubtful.
    TwistRemark {
        /// Number of the twist.
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
        /// Number of the twist.
        number: usize,
        /// The phone.
        phone: PhoneName,
        /// The reasons.
        reason: String,
    },
    /// A twist contradicts the earlier ones; only the last one is used.
    TwistsContradict {
        /// The phone.
        phone: PhoneName,
    },
    /// A twist was joined with the earlier ones.
    TwistsJoined {
        /// The phone.
        phone: PhoneName,
        /// The joined relation of the clocks.
        clock: ClockRelation,
        /// The change of its skew over time.
        change: RateChange,
    },
    /// The learnt skew contradicts the twists; it is not used.
    LearntSkewUnfit {
        /// The learnt skew, ppm.
        learnt_ppm: f64,
        /// 1-sigma of the learnt skew, ppm.
        sigma_ppm: f64,
        /// The skew from the twists, ppm.
        found_ppm: f64,
    },
    /// The twist at the end was skipped.
    SecondTwistLeftOut,
    /// The twist at the end was joined with the ones at the beginning.
    SecondTwistJoined {
        /// The phone.
        phone: PhoneName,
        /// The joined relation of the clocks.
        clock: ClockRelation,
    },
    /// The relation of a phone's clock has changed.
    ClockKnown {
        /// Index of the phone in the profile; 0 is the reference.
        place: usize,
        /// The phone.
        phone: PhoneName,
        /// The new relation.
        clock: ClockRelation,
    },
    /// The depth recorder has started.
    RecorderStarted,
    /// The depth recorder ended by itself.
    RecorderGone {
        /// Its end.
        end: RecorderEnd,
    },
    /// The depth recorder ended with an error when it was asked to stop.
    RecorderFailed {
        /// Its end.
        end: RecorderEnd,
    },
    /// The depth recorder did not stop in time and was killed.
    RecorderKilled {
        /// First word of its command.
        program: String,
        /// Time that it had to stop, s.
        waited_s: u32,
    },
    /// The trigger has started.
    TriggerStarted {
        /// Its period, s.
        period_s: f64,
    },
    /// A phone records its video.
    VideoStarted {
        /// The phone.
        phone: PhoneName,
        /// Phase, frame period and exposure of the video.
        video: Video,
    },
    /// A phone whose video did not start was asked to stop.
    VideoUndone {
        /// The phone.
        phone: PhoneName,
        /// The reason for which a video may still run, if it did not stop.
        error: Option<String>,
    },
    /// A phone's video has ended before its time.
    VideoEnded {
        /// The phone.
        phone: PhoneName,
    },
    /// A phone does not answer whether it records.
    PhoneAway {
        /// The phone.
        phone: PhoneName,
        /// The error of the request.
        error: String,
    },
    /// A phone answers again, and records.
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
    /// The LED of a calibration flashes.
    LedFlashes {
        /// The output that it is on.
        output: Output,
        /// For how long, s.
        length_s: f64,
    },
    /// A photodiode sees the exposures of the depth camera.
    ExposuresSeen {
        /// Their statistics.
        seen: SeenExposures,
        /// The profile's time from the trigger's edge to their middle, µs.
        profile_us: f64,
        /// True if that was measured, and is another one.
        disagrees: bool,
    },
    /// The trigger moves onto the phone's frames.
    Aligning {
        /// Distance that it moves, µs.
        shift_us: f64,
        /// Number of frames over which it moves.
        frames: u32,
        /// The alignment.
        alignment: Alignment,
    },
    /// A pulse train is on its grid.
    Arrived {
        /// Name of the triggered sensor.
        name: String,
        /// True if it is the depth camera.
        is_camera: bool,
        /// Number of the first pulse on the grid.
        pulse: u64,
        /// Distance of that pulse from the grid, ticks.
        remaining: i64,
    },
    /// The board did not report the arrival, but the train runs on the grid.
    ArrivalUnconfirmed,
    /// The position of another phone's frames relative to the depth images.
    Placed {
        /// The phone.
        phone: PhoneName,
        /// The position.
        placement: Placement,
    },
    /// An auxiliary output has started.
    OutputStarted {
        /// Name of the sensor on it.
        name: String,
        /// Number of the output, 2 to 4.
        output: u8,
        /// Its train relative to the trigger, in words.
        rule: String,
    },
    /// A lidar receives the time.
    LidarStarted {
        /// Name of the lidar.
        name: String,
        /// Unix time of the board's tick 0, s.
        utc_at_zero: i64,
    },
    /// The recorded span begins.
    RecordingStarted {
        /// Planned length, s; `None` if it runs until stopped.
        length_s: Option<f64>,
    },
    /// A mark was set, by the operator or by an option.
    Marked {
        /// Board time of the mark.
        marked_at: Ticks,
        /// Its label.
        label: String,
    },
    /// The phase has become less certain than a twist must make it.
    TwistDue {
        /// The limit of its 1-sigma, µs.
        limit_us: f64,
    },
    /// The phase, while the phone's clock is followed.
    Tracked {
        /// The phase; `None` while it is unknown.
        tracked: Option<Tracked>,
    },
    /// The phone's clock can no longer be read.
    TrackLost,
    /// The phone's clock is followed again.
    TrackBack,
    /// The board was reset: the recording ends here.
    BoardReset {
        /// The cause that the board reports.
        cause: ResetCause,
        /// Latest board time before the reset.
        last: Ticks,
    },
    /// The link to the board is lost.
    LinkLost {
        /// The error of the link.
        reason: String,
        /// Longest wait for its return, s; `None` if there is no limit.
        patience_s: Option<u64>,
    },
    /// The link to the board is back.
    LinkBack {
        /// Length of the gap, s of board time.
        away_s: f64,
    },
    /// The board has sent no message for some time.
    BoardQuiet {
        /// That time, s.
        seconds: u64,
        /// Number of damaged frames in the session so far.
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
        /// The finding.
        finding: Finding,
    },
    /// The disk is nearly full.
    DiskNearlyFull {
        /// Free space, bytes.
        free: u64,
    },
    /// A phone's video has not stopped yet; the request is repeated for some time.
    StopRetried {
        /// The phone.
        phone: PhoneName,
        /// The error of the last request.
        error: String,
        /// Time for which the request is repeated, s.
        patience_s: u64,
    },
    /// A device could not be stopped.
    NotStopped {
        /// The device.
        what: Device,
        /// The reason.
        error: String,
    },
    /// The session failed; it is being closed.
    Failed {
        /// The reason.
        error: String,
    },
    /// The twist at the end failed.
    SecondTwistFailed {
        /// The reason.
        error: String,
    },
    /// A video was not downloaded.
    VideoNotFetched {
        /// The reason.
        error: String,
    },
    /// A phone made no video, so none is downloaded.
    NoVideoToFetch {
        /// The phone.
        phone: PhoneName,
    },
    /// Progress of a download.
    Downloading {
        /// The phone.
        phone: PhoneName,
        /// Bytes received so far.
        done: u64,
        /// Size of the file, bytes.
        whole: u64,
    },
    /// A video was downloaded.
    VideoFetched {
        /// Its file.
        path: PathBuf,
        /// Size of the file, bytes.
        size: u64,
    },
    /// The other files of a video were copied.
    FilesFetched {
        /// The phone.
        phone: PhoneName,
        /// Number of files.
        count: usize,
    },
    /// The other files of a video are still on the phone.
    FilesNotFetched {
        /// The phone.
        phone: PhoneName,
        /// The reason.
        error: String,
        /// Commands that copy them: by USB, and by MTP.
        commands: [String; 2],
    },
    /// The files of a phone contradict each other, or what the phone had reported.
    FilesDisagree {
        /// The phone.
        phone: PhoneName,
        /// The contradiction.
        fault: String,
        /// Advice.
        next_step: &'static str,
    },
    /// The session is over.
    Ended {
        /// Its outcome.
        outcome: SessionOutcome,
        /// The recording's folder.
        folder: PathBuf,
    },
}

fn as_text<S: Serializer>(error: &Arc<SessionError>, to: S) -> Result<S::Ok, S::Error> {
    to.collect_str(error)
}
