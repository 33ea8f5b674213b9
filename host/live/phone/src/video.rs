//! Frames and times of videos, by the programs `ffmpeg` and `ffprobe` on the `PATH`.
//!
//! [`probe`] returns the properties that a file states, [`presentation_times`] the times at which
//! its frames are shown, and [`Video`] its pictures: `ffmpeg` writes them into a pipe, so memory is
//! one frame for a video of any length. Each coded frame is returned once (none is dropped or
//! repeated to reach a constant rate) and without rotation: rows stay the sensor's rows, which is
//! what matters for a rolling shutter.
//!
//! Both programs run within limits. A file that consists mostly of holes is refused. A program is
//! killed if it returns more frames than the file can hold, writes more messages than any damage
//! causes, or is silent for a minute. A [`ReadMonitor`] follows and cancels them.

mod decode;
mod probe;

use std::ffi::OsString;
use std::io::{self, ErrorKind};
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use system::{Limits, ReadMonitor, RunError};

pub use decode::{Pixels, Video, version};
pub use probe::{Info, parse_presentation_times, parse_probe, presentation_times, probe};

/// Longest side of a frame in pixels. Keeps a damaged header from allocating gigabytes.
pub const MAX_SIDE: u32 = 16_384;

/// Failure to read a video.
#[derive(Debug, thiserror::Error)]
pub enum VideoError {
    /// The program is not on the `PATH`.
    #[error(
        "`{0}` was not found: ffmpeg is needed to decode videos; install it (Debian, Ubuntu: \
         `sudo apt install ffmpeg`) and see that it is on the PATH"
    )]
    Missing(&'static str),
    /// The program could not be run, or its output could not be read.
    #[error("running {program}: {source}")]
    Run {
        /// `ffmpeg` or `ffprobe`.
        program: &'static str,
        /// The operating system's reason, or that the read was cancelled.
        source: io::Error,
    },
    /// The file has no video that `ffprobe` can read. The text is the reason.
    #[error("not a readable video: {0}")]
    NotAVideo(String),
    /// The file states a size that no camera has.
    #[error("frames of {width}x{height} pixels are not supported (1 to {MAX_SIDE} a side)")]
    Size {
        /// Width, pixels.
        width: u64,
        /// Height, pixels.
        height: u64,
    },
    /// The program exceeded a limit and was killed.
    #[error("{program} was ended: {what}")]
    Endless {
        /// `ffmpeg` or `ffprobe`.
        program: &'static str,
        /// The limit that it exceeded, as a sentence about "it".
        what: String,
    },
    /// `ffmpeg` reported an error, with this message. The frames before it are good.
    #[error("ffmpeg cannot decode the video to its end: {0}")]
    Decode(String),
}

/// Formats that contain their video, by ffmpeg's names: those of phones and cameras, and the raw
/// streams of encoders. Playlists (HLS, DASH, concat, SDP) are excluded, because they would have
/// ffmpeg read files that the user has not named.
const FORMATS: &str = "mov,matroska,avi,mpegts,h264,hevc,ivf,yuv4mpegpipe";

/// Returns the command of `ffmpeg` or `ffprobe` that reads no other file and prints only errors.
fn program(name: &'static str) -> Command {
    let mut command = Command::new(name);
    command
        .args(["-v", "error", "-protocol_whitelist", "file"])
        .args(["-format_whitelist", FORMATS]);
    command
}

/// Returns a path as a URL, which cannot be mistaken for an option, a device or another protocol.
fn file_url(path: &Path) -> OsString {
    let mut url = OsString::from("file:");
    url.push(path);
    url
}

/// Returns the limits of a program that reads the file at `path`. A damaged video causes about 100
/// bytes of messages per frame.
fn limits(path: &Path, monitor: &ReadMonitor) -> Limits {
    Limits {
        silence: Some(Duration::from_secs(60)),
        messages: 64 << 20,
        cancel: monitor.cancel_reading(path),
        own_group: true,
        ..Limits::default()
    }
}

/// Returns a function that converts errors of `program`.
fn failed(program: &'static str) -> impl Fn(RunError) -> VideoError {
    move |error| match error {
        RunError::Start(source) if source.kind() == ErrorKind::NotFound => {
            VideoError::Missing(program)
        }
        RunError::Start(_) | RunError::Read(_) | RunError::Cancelled => VideoError::Run {
            program,
            source: error.into(),
        },
        error => VideoError::Endless {
            program,
            what: error.to_string(),
        },
    }
}
