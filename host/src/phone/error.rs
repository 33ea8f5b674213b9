//! What can go wrong between this program and the phone.

use std::path::PathBuf;
use std::time::Duration;

use super::answer::MalformedAnswer;

/// An error of the phone client. The text says what was expected and what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PhoneError {
    /// The address cannot be understood or resolved.
    #[error(
        "{address:?} is not an address of a phone: {reason}. Give <host> or <host>:<port>, as the app's dialog shows it at its start"
    )]
    Address {
        /// What was given.
        address: String,
        /// Why it was refused.
        reason: String,
    },
    /// Nothing answers at the address.
    #[error(
        "no connection to the phone at {address}: {source}. Is OpenCamera Sensors open with remote control switched on, and are both on the same network?"
    )]
    Connect {
        /// Where the connection was tried.
        address: String,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// The phone did not answer in time.
    #[error(
        "the phone did not finish its answer to {request} within {waited:?}. Is the app in the foreground, with no other client connected? A slow network needs a longer --timeout"
    )]
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
    /// The phone closed the connection within an answer.
    #[error(
        "the phone closed the connection in the middle of its answer to {request} (after {received} bytes of it)"
    )]
    Closed {
        /// The request that was under way.
        request: &'static str,
        /// Bytes of the answer that had come by then.
        received: u64,
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
        "the phone's app says it is version {found:?}; this program knows v.0.1 and v.0.1.1. Install one of these versions of OpenCamera Sensors"
    )]
    UnsupportedVersion {
        /// The version line as it came, escaped and shortened.
        found: String,
    },
    /// The phone answered with an error.
    #[error("the phone refused {request}: {text:?}{}", hint(request, text))]
    Refused {
        /// The refused request.
        request: &'static str,
        /// The phone's own words, shortened.
        text: String,
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
    #[error(
        "the phone sent {count} byte(s) that belong to no request: connect again, and see that nothing else talks to the app"
    )]
    Unrequested {
        /// How many bytes were seen.
        count: usize,
    },
    /// More bytes came than the phone had announced.
    #[error(
        "the phone sent more than the {size} bytes that it had announced for its video: the download is not trusted. Try again when the app has finished the file"
    )]
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
    #[error("the connection was given up after an earlier error: connect again")]
    NotConnected,
}

/// What to do about the refusals that the app is known to give.
fn hint(request: &str, text: &str) -> &'static str {
    if text.starts_with("Error in IMU recording") {
        ". It records its sensors already: stop the video first"
    } else if request == "video_start" && text.contains("phase info") {
        ". No frame timestamps came within 10 s: a video that was already running has been stopped by this request; else switch on sync recording of video and IMU in the app (it needs Camera2)"
    } else if text.starts_with("Couldn't get last video") {
        ". It has no recorded video since the app was started"
    } else if text.starts_with("Requested sensor") {
        ". This phone does not have one of the requested sensors"
    } else {
        ""
    }
}
