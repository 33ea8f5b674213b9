//! Errors between this program and the phone.

use std::path::{Path, PathBuf};
use std::time::Duration;

use super::adb::AdbError;
use super::answer::{MalformedAnswer, ServerVersion};

/// Name of the request without effect on the app, an empty line.
pub(super) const PROBE: &str = "an empty request";

/// An error of the phone client.
#[derive(Debug, thiserror::Error)]
pub enum PhoneError {
    /// The address is not valid.
    #[error("{address:?} is not the address of a phone: {reason}")]
    Address {
        /// The address as it was given.
        address: String,
        /// Reason why it is not valid.
        reason: &'static str,
    },
    /// Nothing answers at the address.
    #[error("no connection to the phone at {address}: {source}")]
    Connect {
        /// The address with its port.
        address: String,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// The phone did not receive a request or finish its answer in time.
    #[error("the phone did not take {request} and finish its answer within {waited:?}")]
    Timeout {
        /// The request that was under way.
        request: &'static str,
        /// The time that was allowed.
        waited: Duration,
    },
    /// A download is too slow.
    #[error(
        "the download of the video has come to a crawl: {received} of {size} bytes, less than {floor} bytes in the last {window:?}"
    )]
    TooSlow {
        /// Bytes received.
        received: u64,
        /// Bytes announced.
        size: u64,
        /// Fewest bytes that must arrive in a window.
        floor: u64,
        /// Length of the window.
        window: Duration,
    },
    /// The phone closed the connection before or within an answer.
    #[error("the phone closed the connection during {request}, after {received} bytes of answer")]
    Closed {
        /// The request that was under way.
        request: &'static str,
        /// Bytes of the answer received before.
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
    /// The phone sent more bytes than it had announced.
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
    /// This program does not support the app's version.
    #[error(
        "the phone's app says it is of version {found:?}; this program knows v.0.1 and v.0.1.1"
    )]
    UnsupportedVersion {
        /// The version that the app stated, shortened.
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
    /// The answer violates the protocol.
    #[error("the phone's answer to {request} is damaged: {source}")]
    Malformed {
        /// The request that was under way.
        request: &'static str,
        /// The violation.
        source: MalformedAnswer,
    },
    /// The answer to `video_start` is earlier than the video's frames can be, so it is the phase of
    /// another video, which the request has stopped.
    #[error(
        "the phone was recording already: its answer to video_start is that of another video \
         ({early:.1} s too early for the new one), which the request has stopped; or its frames \
         have another clock than its gyroscope"
    )]
    StalePhase {
        /// Seconds by which the phase is too early.
        early: f64,
    },
    /// The timestamps of the frames fit both of the phone's clocks.
    #[error(
        "the clock of the phone's frames is not known: the phone has slept for {slept_s:.3} s since \
         it was started, so its two clocks differ by that, and the timestamps fit both"
    )]
    FrameClock {
        /// Seconds that the phone has slept since it was started.
        slept_s: f64,
    },
    /// A start failed, and the video that it may have started was stopped.
    #[error("{cause}; the phone was asked to stop")]
    StartUndone {
        /// Reason of the failure.
        cause: Box<PhoneError>,
    },
    /// A start failed, and the video that it may have started could not be stopped.
    #[error("{cause}; a video may run on the phone: it could not be stopped ({why})")]
    MayRecord {
        /// Reason of the failed start.
        cause: Box<PhoneError>,
        /// Reason of the failed stop.
        why: Box<PhoneError>,
    },
    /// The phone sent no file of its gyroscope.
    #[error("the phone sent no file of its gyroscope")]
    NoGyroscope,
    /// The gyroscope was recorded for far less time than requested.
    #[error(
        "the phone recorded its gyroscope for {:.1} s of the {:.1} s that were asked for",
        got.as_secs_f64(), asked.as_secs_f64()
    )]
    TooShort {
        /// The requested duration.
        asked: Duration,
        /// Time from the first sample to the last.
        got: Duration,
    },
    /// The app has not answered since it received `get_video`.
    #[error(
        "the phone's app hangs: it has not answered get_video within {waited:?}, nor anything else since"
    )]
    Hangs {
        /// The time that was allowed for its answer.
        waited: Duration,
    },
    /// The phone sent bytes without a request.
    #[error("the phone sent {count} byte(s) that belong to no request")]
    Unrequested {
        /// Number of bytes that were seen.
        count: usize,
    },
    /// An argument of the request is out of range. The text is the whole message.
    #[error("{0}")]
    Argument(String),
    /// The target of a download exists.
    #[error("{} is there already and is not overwritten", path.display())]
    TargetExists {
        /// The file that is in the way.
        path: PathBuf,
    },
    /// A file cannot be written.
    #[error("cannot {action} {}: {source}", path.display())]
    File {
        /// The attempted action, as a verb phrase that the path follows.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// Files cannot be copied from the phone by `adb`.
    #[error(transparent)]
    Adb(#[from] AdbError),
    /// [`Settings::cancel`](crate::Settings::cancel) ended the request.
    #[error("stopped on request during {request}")]
    Cancelled {
        /// The request that was under way.
        request: &'static str,
    },
    /// The connection was closed after an earlier error, and not opened again.
    #[error("the connection to the phone was given up after an earlier error")]
    NotConnected,
}

/// A refusal that the app is known to give.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// The sensors are in use, by an IMU request or by a video whose capture session is not closed
    /// yet.
    SensorsBusy,
    /// The phone lacks a requested sensor.
    NoSensor,
    /// The app does not know this form of the request.
    UnknownRequest,
    /// The camera delivered no frames to take a phase from.
    NoPhase,
    /// The last video is not where it was saved. (An app that has recorded none since it was
    /// opened ends instead.)
    VideoGone,
}

impl PhoneError {
    /// Returns the first cause: of a failed start the reason of the failure, else the error itself.
    #[must_use]
    pub fn cause(&self) -> &Self {
        match self {
            Self::StartUndone { cause } | Self::MayRecord { cause, .. } => cause.cause(),
            other => other,
        }
    }

    /// Returns true if the phone is reachable but the app does not listen.
    #[must_use]
    pub fn is_app_gone(&self) -> bool {
        use std::io::ErrorKind::ConnectionRefused;
        matches!(self, Self::Connect { source, .. } if source.kind() == ConnectionRefused)
    }

    /// Returns true if the error occurred before a request with an effect was sent to the app.
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

    /// Returns the app's refusal, if it is a known one.
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

    /// Returns true if the app refused because its sensors are in use.
    pub(crate) fn is_busy(&self) -> bool {
        self.refusal() == Some(Refusal::SensorsBusy)
    }

    /// Converts a failure to write or rename the file `path`.
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
