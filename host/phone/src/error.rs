//! What can go wrong between this program and the phone.

use std::path::{Path, PathBuf};
use std::time::Duration;

use super::answer::{MalformedAnswer, ServerVersion};

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
