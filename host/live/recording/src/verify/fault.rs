//! The faults that a check finds: one table of kinds, severities, sentences and next steps.

use board::Stream;
use board::finding::Severity;
use phone::coverage::PhoneFault;
use protocol::{TICK_HZ, Ticks};

use crate::contents::{FileContents, TopicContents};
use crate::damage::Damage;
use crate::messages::CdrError;
use crate::rosbag2::METADATA_FILE;
use crate::{MCAP_FILE, RecordingError, SESSION_FILE};

/// Advice where a part of the folder was lost or changed.
const COPY_AGAIN: &str = "copy the recording again from where it was made, and compare";

/// Something that is damaged, missing, or contradicts the rest.
#[derive(Debug, thiserror::Error)]
pub(super) enum Fault {
    /// Damage of the file as bytes.
    #[error(transparent)]
    Damage(Damage),
    /// There is no `session.json`.
    #[error(
        "there is no {SESSION_FILE} beside {MCAP_FILE}: settings, clocks and what the recording held at \
         its end are not known"
    )]
    NoSession,
    /// `session.json` cannot be used.
    #[error("{0}")]
    SessionDamaged(RecordingError),
    /// The program was killed.
    #[error("the program was ended before it could close the session")]
    NotFinished,
    /// The session failed, for the reason in the text.
    #[error("the session failed{0}")]
    Failed(String),
    /// Nothing was recorded.
    #[error("nothing was recorded between begin and end")]
    NothingRecorded,
    /// The recording is shorter than it should be.
    #[error("{kept_s:.1} s were recorded of the {asked_s:.1} s that were asked for")]
    Shorter { kept_s: f64, asked_s: f64 },
    /// The session does not state what the closed recording holds.
    #[error(
        "{SESSION_FILE} does not state what the recording held at its end: nothing shows if a part is missing"
    )]
    NoContents,
    /// A topic has other messages than when the recording was closed.
    #[error("{topic} has {}, and had {} when the recording was closed", said(.found, .held), said(.held, .found))]
    TopicDiffers {
        topic: String,
        held: TopicContents,
        found: TopicContents,
    },
    /// `metadata.yaml` is missing.
    #[error("there is no {METADATA_FILE}, by which ROS 2 opens the folder")]
    NoMetadata,
    /// `metadata.yaml` states something else than the file holds.
    #[error("{METADATA_FILE} states other topics, counts or times than {MCAP_FILE} has")]
    MetadataDiffers,
    /// A file is not there.
    #[error("{0}, which the session names, is not in its folder")]
    FileMissing(String),
    /// A file is another than at the end of the session.
    #[error("{name} {}", differs(.held, .found))]
    FileDiffers {
        name: String,
        held: FileContents,
        found: FileContents,
    },
    /// A file cannot be read.
    #[error("{name} cannot be read: {reason}")]
    FileUnreadable { name: String, reason: String },
    /// No checksums of the files were taken.
    #[error(
        "the session was ended before it took checksums of its files: they are there, and not compared"
    )]
    FilesNotCompared,
    /// A fault of a phone's files.
    #[error("{0}")]
    Phone(PhoneFault),
    /// A message is not of its topic's type.
    #[error("a message of {topic} cannot be read: {error}")]
    MessageDamaged { topic: String, error: CdrError },
    /// The stamps within a message are not its time.
    #[error("a message of {topic} states another time in itself than in the file")]
    StampDiffers { topic: &'static str },
    /// The times of a topic do not increase.
    #[error("a message of {topic} is {older_s:.6} s older than the one before it")]
    NotMonotonic { topic: &'static str, older_s: f64 },
    /// A message is far from those around it.
    #[error("a message of {topic} is {late_s:.1} s older than messages before it")]
    OutOfStep { topic: &'static str, late_s: f64 },
    /// The board's numbers go back.
    #[error("the board's numbers of {stream} go back to {number}")]
    NumberBackwards { stream: Stream, number: u32 },
    /// Messages are missing by the board's numbers.
    #[error(
        "{missing} messages of {stream} are missing by the board's numbers: {dropped} the board dropped \
         itself, {} were lost on the link or with a damaged part", .missing - .dropped
    )]
    MessagesMissing {
        stream: Stream,
        missing: u64,
        dropped: u64,
    },
    /// A frame arrived damaged.
    #[error("a frame of the link was damaged when it came: {0}")]
    FrameDamaged(String),
    /// The board was reset.
    #[error("the board was reset within the recording")]
    BoardReset,
    /// The IMU was silent, as the board explains, or would in a sample that is missing.
    #[error("{} without IMU samples, as the board says or a missing sample would", ms(*.0))]
    ImuGap(u64),
    /// The IMU was silent, and the board does not explain it.
    #[error("{} without IMU samples, and the board does not say why", ms(*.0))]
    ImuGapUnexplained(u64),
    /// An edge on the strobe input was lost.
    #[error("an edge on the strobe input was lost, as the board says")]
    CapturesLost,
    /// A pulse is off its grid.
    #[error("pulse {number} is {off} ticks off the grid of the alignment")]
    OffGrid { number: u64, off: u64 },
    /// The first pulse on the grid is another than the session states.
    #[error("pulse {0}, the first on the grid by {SESSION_FILE}, is not at its time")]
    ArrivalDiffers(u64),
    /// A stream does not cover the recorded span.
    #[error("{stream} {}", uncovered(*.missing_s))]
    SpanNotCovered {
        stream: Stream,
        /// Missing at begin and end, s.
        missing_s: [f64; 2],
    },
    /// A span that the session states is outside of the recording.
    #[error("{what} of {SESSION_FILE} lies outside of the recording's board time")]
    SpanOutside { what: &'static str },
    /// The session counted more messages than there are.
    #[error("{SESSION_FILE} counts {counted} messages of {stream}, and {found} are there")]
    CountsDiffer {
        stream: Stream,
        counted: u64,
        found: u64,
    },
    /// A message relates clocks as no clocks can be.
    #[error(
        "a message relates two clocks as no two clocks can be: their rates differ by more than 1 %, or its numbers are none"
    )]
    ClockImpossible,
    /// The relation of the clocks in the session is not the last that was recorded.
    #[error(
        "the relation of the clocks of {0} in {SESSION_FILE} is not the last that was recorded"
    )]
    ClockDiffers(String),
    /// The markers of the session are not those that were recorded.
    #[error("{SESSION_FILE} has other markers than were recorded")]
    MarkersDiffer,
}

impl Fault {
    /// Returns a stable word for the kind.
    pub(super) const fn kind(&self) -> &'static str {
        match self {
            Self::Damage(damage) => damage.kind(),
            Self::NoSession => "no_session_file",
            Self::SessionDamaged(_) => "session_file_damaged",
            Self::NotFinished => "not_finished",
            Self::Failed(_) => "failed",
            Self::NothingRecorded => "nothing_recorded",
            Self::Shorter { .. } => "shorter_than_asked",
            Self::NoContents => "no_contents",
            Self::TopicDiffers { .. } => "topic_differs",
            Self::NoMetadata => "no_metadata",
            Self::MetadataDiffers => "metadata_differs",
            Self::FileMissing(_) => "file_missing",
            Self::FileDiffers { .. } => "file_differs",
            Self::FileUnreadable { .. } => "file_unreadable",
            Self::FilesNotCompared => "files_not_compared",
            Self::Phone(fault) => fault.kind(),
            Self::MessageDamaged { .. } => "message_damaged",
            Self::StampDiffers { .. } => "stamp_differs",
            Self::NotMonotonic { .. } => "time_not_monotonic",
            Self::OutOfStep { .. } => "time_out_of_step",
            Self::NumberBackwards { .. } => "number_backwards",
            Self::MessagesMissing { .. } => "messages_missing",
            Self::FrameDamaged(_) => "frame_damaged",
            Self::BoardReset => "board_reset",
            Self::ImuGap(_) => "imu_gap",
            Self::ImuGapUnexplained(_) => "imu_gap_unexplained",
            Self::CapturesLost => "captures_lost",
            Self::OffGrid { .. } => "off_grid",
            Self::ArrivalDiffers(_) => "arrival_differs",
            Self::SpanNotCovered { .. } => "span_not_covered",
            Self::SpanOutside { .. } => "span_outside",
            Self::CountsDiffer { .. } => "counts_differ",
            Self::ClockImpossible => "clock_impossible",
            Self::ClockDiffers(_) => "clock_differs",
            Self::MarkersDiffer => "markers_differ",
        }
    }

    /// Returns the severity: known losses and what cannot be compared are to be checked, damage and
    /// contradictions are bad.
    pub(super) const fn severity(&self) -> Severity {
        match self {
            Self::Damage(Damage::CutOff { .. } | Damage::TopicsAssumed)
            | Self::NoSession
            | Self::NotFinished
            | Self::Failed(_)
            | Self::NothingRecorded
            | Self::Shorter { .. }
            | Self::NoContents
            | Self::NoMetadata
            | Self::FileMissing(_)
            | Self::FilesNotCompared
            | Self::Phone(_)
            | Self::MessagesMissing { .. }
            | Self::FrameDamaged(_)
            | Self::BoardReset
            | Self::ImuGap(_)
            | Self::CapturesLost
            | Self::SpanNotCovered { .. } => Severity::Check,
            Self::Damage(_)
            | Self::SessionDamaged(_)
            | Self::TopicDiffers { .. }
            | Self::MetadataDiffers
            | Self::FileDiffers { .. }
            | Self::FileUnreadable { .. }
            | Self::MessageDamaged { .. }
            | Self::StampDiffers { .. }
            | Self::NotMonotonic { .. }
            | Self::OutOfStep { .. }
            | Self::NumberBackwards { .. }
            | Self::ImuGapUnexplained(_)
            | Self::OffGrid { .. }
            | Self::ArrivalDiffers(_)
            | Self::SpanOutside { .. }
            | Self::CountsDiffer { .. }
            | Self::ClockImpossible
            | Self::ClockDiffers(_)
            | Self::MarkersDiffer => Severity::Bad,
        }
    }

    /// Returns advice, where something can be done.
    pub(super) const fn next_step(&self) -> Option<&'static str> {
        match self {
            Self::NoSession | Self::SessionDamaged(_) => Some(
                "copy session.json again from where the recording was made; constants can be given with \
                 `extract --profile`",
            ),
            Self::TopicDiffers { .. }
            | Self::MetadataDiffers
            | Self::FileMissing(_)
            | Self::FileDiffers { .. }
            | Self::FileUnreadable { .. } => Some(COPY_AGAIN),
            Self::Phone(fault) => Some(fault.next_step()),
            _ => None,
        }
    }
}

fn ms(ticks: u64) -> String {
    format!("{:.1} ms", ticks as f64 * 1e3 / f64::from(TICK_HZ))
}

/// Describes the messages of a topic by what `other` has differently.
fn said(of: &TopicContents, other: &TopicContents) -> String {
    let seconds = |at: Ticks| at.as_secs_f64();
    if of.messages == 0 {
        String::from("no messages")
    } else if (of.messages, of.numbers) != (other.messages, other.numbers) {
        let [first, last] = of.numbers;
        format!("{} messages, numbers {first} to {last}", of.messages)
    } else if of.times != other.times {
        let [from, to] = of.times.map(seconds);
        format!("messages from {from:.6} s to {to:.6} s")
    } else {
        format!("content with the checksum {:08x}", of.checksum)
    }
}

fn differs(held: &FileContents, found: &FileContents) -> String {
    if held.bytes == found.bytes {
        String::from("has other bytes than at the end of the session, and as many")
    } else {
        format!(
            "has {} bytes, and had {} at the end of the session",
            found.bytes, held.bytes
        )
    }
}

fn uncovered([begin, end]: [f64; 2]) -> String {
    match (begin > 0.0, end > 0.0) {
        (true, true) => format!(
            "begin {begin:.1} s after the recorded span does and end {end:.1} s before its end"
        ),
        (true, false) => format!("begin {begin:.1} s after the recorded span does"),
        (false, true) if end.is_finite() => {
            format!("end {end:.1} s before the recorded span does")
        }
        _ => String::from("are not in the recorded span"),
    }
}
