//! What can go wrong between this program and the phone.

use std::path::PathBuf;
use std::time::Duration;

use super::answer::{MalformedAnswer, ServerVersion};
use crate::outcome::{ExitStatus, Failure, file_step};

/// An error of the phone client: what was expected and what came.
/// [`PhoneError::next_step`] says what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
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
    /// The phone did not answer in time.
    #[error("the phone did not finish its answer to {request} within {waited:?}")]
    Timeout {
        /// The request that was under way.
        request: &'static str,
        /// How long it was waited for.
        waited: Duration,
    },
    /// The phone took no more bytes of a request.
    #[error("the phone did not take the request {request} within {waited:?}")]
    SendTimeout {
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

impl PhoneError {
    /// What the user can do about it.
    #[must_use]
    pub fn next_step(&self) -> Option<&'static str> {
        Some(match self {
            Self::Address { .. } => {
                "give <host> or <host>:<port>, as the app's dialog shows it at its start"
            }
            Self::Connect { .. } => {
                "open OpenCamera Sensors with its remote control switched on, and see that both are on the same network"
            }
            Self::Timeout { request, .. } if *request == "get_video" => {
                "stop the video first: the app does not answer while it records. A slow network needs a longer --timeout"
            }
            Self::Timeout { .. } | Self::SendTimeout { .. } => {
                "bring the app to the foreground and close other clients: it serves one at a time. A slow network needs a longer --timeout"
            }
            Self::TooSlow { .. } => "bring the phone nearer to the access point, or use a cable",
            Self::Closed { .. } | Self::Connection { .. } => {
                "see that the app is open and in the foreground, then try again"
            }
            Self::VideoTooShort { .. } | Self::VideoTooLong { .. } => {
                "nothing was saved; try again once the app has finished the file"
            }
            Self::VideoTooLarge { .. } => "raise --max-bytes if the video is really that long",
            Self::UnsupportedVersion { .. } => {
                "install one of these versions of OpenCamera Sensors"
            }
            Self::Refused { request, text, .. } => return refusal_hint(request, text),
            Self::Malformed { .. } => {
                "see that it is OpenCamera Sensors that listens on this port, then try again"
            }
            Self::Unrequested { .. } => "connect again, and see that nothing else talks to the app",
            Self::TargetExists { .. } => "choose another place with --out, or give --overwrite",
            Self::File { source, .. } => file_step(source.kind()),
            Self::NotConnected => "connect again",
            Self::Argument(_) => "`smartdepthsync help phone` says what is accepted",
            Self::Cancelled { .. } => "run the command again when you are ready",
        })
    }

    /// The exit code that a command ends with after this error.
    #[must_use]
    pub fn exit_status(&self) -> ExitStatus {
        match self {
            Self::Address { .. } | Self::Argument(_) => ExitStatus::Usage,
            Self::TargetExists { .. } | Self::File { .. } => ExitStatus::Storage,
            Self::Cancelled { .. } => ExitStatus::Interrupted,
            _ => ExitStatus::Phone,
        }
    }
}

impl From<PhoneError> for Failure {
    fn from(error: PhoneError) -> Self {
        let failure = Self::new(error.exit_status(), error.to_string());
        match error.next_step() {
            Some(step) => failure.next_step(step),
            None => failure,
        }
    }
}

/// What to do about the refusals that the app is known to give.
fn refusal_hint(request: &str, text: &str) -> Option<&'static str> {
    if text.starts_with("Error in IMU recording") {
        Some("stop the video first: the app records its sensors already")
    } else if request == "video_start" && text.contains("phase info") {
        Some(
            "if a video was running, this request has stopped it: try again. Otherwise switch on sync recording of video and IMU in the app, which needs its Camera2 setting",
        )
    } else if text.starts_with("Couldn't get last video") {
        Some("record a video first: the app has none since it was started")
    } else if text.starts_with("Requested sensor") {
        Some("ask for other sensors: this phone lacks one of them")
    } else if text == "Invalid request" && request == "imu" {
        Some("the app does not know this form of the request: install v.0.1 or v.0.1.1")
    } else {
        None
    }
}
