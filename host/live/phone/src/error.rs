//! What can go wrong between this program and the phone.

use std::path::{Path, PathBuf};
use std::time::Duration;

use super::adb::AdbError;
use super::answer::{MalformedAnswer, ServerVersion};

/// The request that has no effect on the app: an empty line.
pub(super) const PROBE: &str = "an empty request";

/// An error of the phone client: what was expected and what came.
#[derive(Debug, thiserror::Error)]
pub enum PhoneError {
    /// The address cannot be understood.
    #[error("{address:?} is not the address of a phone: {reason}")]
    Address {
        /// What was given.
        address: String,
        /// Why it was refused.
        reason: &'static str,
    },
    /// Nothing answers at the address.
    #[error("no connection to the phone at {address}: {source}")]
    Connect {
        /// Where the connection was tried.
        address: String,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// The phone did not take a request or answer it in time, or stopped answering.
    #[error("the phone did not take {request} and finish its answer within {waited:?}")]
    Timeout {
        /// The request that was under way.
        request: &'static str,
        /// How long it was waited for.
        waited: Duration,
    },
    /// A download runs, but far too slowly ever to end.
    #[error(
        "the download of the video has come to a crawl: {received} of {size} bytes, less than {floor} bytes in the last {window:?}"
    )]
    TooSlow {
        /// Bytes received.
        received: u64,
        /// Bytes announced.
        size: u64,
        /// Least number of bytes that a window must bring.
        floor: u64,
        /// Length of the window.
        window: Duration,
    },
    /// The phone closed the connection before or within an answer.
    #[error("the phone closed the connection during {request}, after {received} bytes of answer")]
    Closed {
        /// The request that was under way.
        request: &'static str,
        /// Bytes of the answer that had come by then.
        received: u64,
    },
    /// The phone closed the connection within a video.
    #[error("the phone closed the connection after {received} of the video's {size} bytes")]
    VideoTooShort {
        /// Bytes received.
        received: u64,
        /// Bytes announced.
        size: u64,
    },
    /// More bytes came than the phone had announced.
    #[error("the phone sent more than the {size} bytes that it had announced for its video")]
    VideoTooLong {
        /// Bytes announced.
        size: u64,
    },
    /// The announced video is larger than the limit.
    #[error("the phone announces a video of {size} bytes, more than the limit of {limit} bytes")]
    VideoTooLarge {
        /// Bytes announced.
        size: u64,
        /// The limit.
        limit: u64,
    },
    /// The connection broke.
    #[error("the connection to the phone broke during {request}: {source}")]
    Connection {
        /// The request that was under way.
        request: &'static str,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// The app is of a version that this program does not know.
    #[error(
        "the phone's app says it is of version {found:?}; this program knows v.0.1 and v.0.1.1"
    )]
    UnsupportedVersion {
        /// The version line as it came, shortened.
        found: String,
    },
    /// The phone answered with an error.
    #[error("the phone refused {request}: {text:?}")]
    Refused {
        /// The refused request.
        request: &'static str,
        /// The phone's own words, shortened.
        text: String,
        /// Version of the app.
        version: ServerVersion,
    },
    /// The answer is not one of the protocol.
    #[error("the phone's answer to {request} is damaged: {source}")]
    Malformed {
        /// The request that was under way.
        request: &'static str,
        /// What was expected and what came.
        source: MalformedAnswer,
    },
    /// The answer to `video_start` came sooner than its frames can: it is the phase of
    /// another video, which this request has stopped.
    #[error(
        "the phone was recording already: its answer to video_start is of another video \
         ({early:.1} s before its frames can be), and the request has stopped that one; or its \
         frames are on another clock than its gyroscope"
    )]
    StalePhase {
        /// By how much it was too soon, seconds.
        early: f64,
    },
    /// The frames may be on either of the phone's clocks.
    #[error(
        "whether the phone stamps its frames with the clock of its sensors is not known: it has \
         slept for {slept_s:.3} s since it was started, by which the other clock is behind, and \
         both fit"
    )]
    FrameClock {
        /// How long it slept, seconds.
        slept_s: f64,
    },
    /// A start failed, and what it may have begun was stopped.
    #[error("{cause}; the phone was asked to stop")]
    StartUndone {
        /// Why it failed.
        cause: Box<PhoneError>,
    },
    /// A start failed, and whether it has begun a video is not known.
    #[error("{cause}; a video may run on the phone: it could not be stopped ({why})")]
    MayRecord {
        /// Why it failed.
        cause: Box<PhoneError>,
        /// Why it could not be stopped.
        why: Box<PhoneError>,
    },
    /// The phone sent no file of its gyroscope.
    #[error("the phone sent no file of its gyroscope")]
    NoGyroscope,
    /// The gyroscope was recorded for far less than was asked for.
    #[error(
        "the phone recorded its gyroscope for {:.1} s of the {:.1} s that were asked for",
        got.as_secs_f64(), asked.as_secs_f64()
    )]
    TooShort {
        /// How long it was to be recorded.
        asked: Duration,
        /// From its first sample to its last.
        got: Duration,
    },
    /// The app took `get_video` and answers nothing any more.
    #[error(
        "the phone's app hangs: it has not answered get_video within {waited:?}, nor anything else since"
    )]
    Hangs {
        /// How long it was waited for.
        waited: Duration,
    },
    /// Bytes came that belong to no request.
    #[error("the phone sent {count} byte(s) that belong to no request")]
    Unrequested {
        /// How many bytes were seen.
        count: usize,
    },
    /// The request's own values are out of range.
    #[error("{0}")]
    Argument(String),
    /// The target of a download is there already.
    #[error("{} is there already and is not overwritten", path.display())]
    TargetExists {
        /// The file that is in the way.
        path: PathBuf,
    },
    /// Writing to disk failed.
    #[error("cannot {action} {}: {source}", path.display())]
    File {
        /// What was tried.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// Files did not come from the phone's storage.
    #[error(transparent)]
    Adb(#[from] AdbError),
    /// The caller asked to stop.
    #[error("stopped on request during {request}")]
    Cancelled {
        /// The request that was under way.
        request: &'static str,
    },
    /// An earlier error left the connection out of step.
    #[error("the connection to the phone was given up after an earlier error")]
    NotConnected,
}

/// The refusals that the app is known to give.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// Its sensors are being recorded: for a video, until its capture session is closed, or
    /// by an IMU request.
    SensorsBusy,
    /// The phone lacks a sensor that was asked for.
    NoSensor,
    /// It does not know this form of the request.
    UnknownRequest,
    /// No frames came from which a phase can be taken.
    NoPhase,
    /// Its last video is not where it was saved. (Without any since it was opened, the app
    /// ends.)
    VideoGone,
}

impl PhoneError {
    /// The error itself: of a start that failed, why it did.
    #[must_use]
    pub fn cause(&self) -> &Self {
        match self {
            Self::StartUndone { cause } | Self::MayRecord { cause, .. } => cause.cause(),
            other => other,
        }
    }

    /// Whether the phone is there, and nobody listens on it.
    #[must_use]
    pub fn is_app_gone(&self) -> bool {
        use std::io::ErrorKind::ConnectionRefused;
        matches!(self, Self::Connect { source, .. } if source.kind() == ConnectionRefused)
    }

    /// Whether the app was not asked for anything yet: nothing can come of it.
    #[must_use]
    pub fn is_before_request(&self) -> bool {
        match self {
            Self::Timeout { request, .. }
            | Self::Closed { request, .. }
            | Self::Connection { request, .. }
            | Self::Malformed { request, .. }
            | Self::Cancelled { request } => *request == PROBE,
            Self::Address { .. }
            | Self::Connect { .. }
            | Self::Argument(_)
            | Self::NotConnected
            | Self::Unrequested { .. } => true,
            _ => false,
        }
    }

    /// The app's refusal, if it is a known one.
    #[must_use]
    pub fn refusal(&self) -> Option<Refusal> {
        let Self::Refused { request, text, .. } = self else {
            return None;
        };
        match *request {
            "imu" if text.starts_with("Error in IMU") => Some(Refusal::SensorsBusy),
            "imu" if text.starts_with("Requested sensor") => Some(Refusal::NoSensor),
            "imu" if text == "Invalid request" => Some(Refusal::UnknownRequest),
            "video_start" if text.contains("phase info") => Some(Refusal::NoPhase),
            "get_video" if text.starts_with("Couldn't get last video") => Some(Refusal::VideoGone),
            _ => None,
        }
    }

    /// Whether the app refused because its sensors are being recorded.
    pub(crate) fn is_busy(&self) -> bool {
        self.refusal() == Some(Refusal::SensorsBusy)
    }

    /// The failure to write `path`, or to put it in its place.
    pub(crate) fn writing(path: &Path, source: std::io::Error) -> Self {
        let path = path.to_owned();
        match source.kind() {
            std::io::ErrorKind::AlreadyExists => Self::TargetExists { path },
            _ => Self::File {
                action: "write to",
                path,
                source,
            },
        }
    }
}
