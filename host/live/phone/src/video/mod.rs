//! Frames and times of videos, by the programs `ffmpeg` and `ffprobe` of `PATH`.
//!
//! [`probe`] asks what a file says about itself, [`presentation_times`] when its
//! frames are shown, and [`Video`] decodes it: `ffmpeg` writes raw pictures into a
//! pipe, and memory is one frame whatever the length of the video. Each coded frame
//! comes once (nothing is dropped or doubled to reach a constant rate), and it is not
//! turned upright: rows stay the sensor's rows, which is what a rolling shutter is
//! about.
//!
//! Both programs run within limits: a video that was mostly never written is refused, and a
//! program is ended that gives more frames than the file can hold, more messages than any
//! damage makes, or nothing for a minute. A [`ReadMonitor`] follows and cancels them.

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

/// Longest side of a frame, pixels: a damaged head of a file must not allocate
/// gigabytes.
pub const MAX_SIDE: u32 = 16_384;

/// Why there are no frames, or no more of them.
#[derive(Debug, thiserror::Error)]
pub enum VideoError {
    /// The program is not there.
    #[error(
        "`{0}` was not found: ffmpeg is needed to decode videos; install it (Debian, Ubuntu: \
         `sudo apt install ffmpeg`) and see that it is on the PATH"
    )]
    Missing(&'static str),
    /// The program could not be run, or its output could not be read.
    #[error("running {program}: {source}")]
    Run {
        /// Which of the two.
        program: &'static str,
        /// Why.
        source: io::Error,
    },
    /// `ffprobe` finds no video in the file.
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
    /// The program would not end, and was ended.
    #[error("{program} was ended: {what}")]
    Endless {
        /// Which of the two.
        program: &'static str,
        /// What it did.
        what: String,
    },
    /// `ffmpeg` complained, in these words. The frames before are good.
    #[error("ffmpeg cannot decode the video to its end: {0}")]
    Decode(String),
}

/// The formats that hold their video themselves, by ffmpeg's names: what phones and
/// cameras write, and streams as they come out of an encoder. A playlist (HLS, DASH,
/// concat, SDP) names other files, of which nobody has said that they may be read.
const FORMATS: &str = "mov,matroska,avi,mpegts,h264,hevc,ivf,yuv4mpegpipe";

/// A program of the two that reads the file alone: without a terminal, quiet but for
/// errors.
fn program(name: &'static str) -> Command {
    let mut command = Command::new(name);
    command
        .args(["-v", "error", "-protocol_whitelist", "file"])
        .args(["-format_whitelist", FORMATS]);
    command
}

/// A path as an address that can be taken neither for an option nor for a device or
/// another protocol.
fn file_url(path: &Path) -> OsString {
    let mut url = OsString::from("file:");
    url.push(path);
    url
}

/// Limits of a program that reads the file at `path`. A damaged video makes some 100 bytes of
/// messages a frame.
fn limits(path: &Path, monitor: &ReadMonitor) -> Limits {
    Limits {
        silence: Some(Duration::from_secs(60)),
        messages: 64 << 20,
        cancel: monitor.cancel_reading(path),
        own_group: true,
        ..Limits::default()
    }
}

/// Returns the conversion of the errors of `program`.
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
