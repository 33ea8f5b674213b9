//! Errors of a measurement. Each message says what was expected and what to do.

use std::path::{Path, PathBuf};

use phone::video::VideoError;
use recording::RecordingError;
use recording::profile::ProfileError;

use crate::drift::MIN_FRAMES;
use crate::footage::Region;
use crate::footage::frame::{MAX_SIDE, MIN_ROWS};
use crate::led::LedRefusal;

/// Failure of a measurement.
#[derive(Debug, thiserror::Error)]
pub enum EvaluateError {
    /// The region is not inside the image.
    #[error(
        "the region {region} (X,Y,WIDTH,HEIGHT) is not inside the image of {width}x{height} pixels"
    )]
    RegionOutside {
        region: Region,
        /// Width of the image.
        width: usize,
        /// Height of the image.
        height: usize,
    },
    /// The image or region has too few rows.
    #[error(
        "only {rows} sensor rows to look at, at least {MIN_ROWS} are needed: give a larger region or a larger video, and check --rotation"
    )]
    TooFewRows { rows: usize },
    /// A setting cannot be parsed, or is out of range.
    #[error("{0}")]
    Setting(String),
    /// A frame has another size than those before it.
    #[error(
        "a frame of {got_width}x{got_height} pixels after frames of {width}x{height}: all frames of a recording, and all recordings of one evaluation, must have one size"
    )]
    FrameSize {
        /// Width of the frame.
        got_width: usize,
        /// Height of the frame.
        got_height: usize,
        width: usize,
        height: usize,
    },
    /// A side of the picture is longer than that of any sensor.
    #[error(
        "{path}: pictures of {width}x{height} pixels are not supported (1 to {MAX_SIDE} a side)"
    )]
    Unsupported {
        path: PathBuf,
        width: u64,
        height: u64,
    },
    /// `ffmpeg` or `ffprobe` is missing, or cannot be run.
    #[error(transparent)]
    Ffmpeg(VideoError),
    /// A folder does not have one video.
    #[error("{folder}: {found}")]
    NoVideo {
        folder: PathBuf,
        /// Number of videos in words, or the system's reason.
        found: String,
        /// Command that copies the video of the recording from its phone.
        copy: Option<String>,
    },
    /// The file is not a readable video.
    #[error("{path}: not a readable video: {message}")]
    NotAVideo {
        path: PathBuf,
        /// Message of the decoder, and its likely cause.
        message: String,
    },
    /// A file could not be read or written.
    #[error("{path}: {source}")]
    Io {
        path: PathBuf,
        source: std::io::Error,
    },
    /// A timestamp file has a line that is not an integer.
    #[error("{path}: line {line}: expected one integer of nanoseconds a line, found `{found}`")]
    Timestamps {
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        found: String,
    },
    /// There are no frames in the chosen time.
    #[error("{path}: no frames between {from_s} s and {to_s}")]
    NoFrames {
        path: PathBuf,
        /// Start of the window, seconds.
        from_s: f64,
        /// End of the window.
        to_s: String,
    },
    /// No frame has flashes.
    #[error(
        "{path}: no strobe flashes in any of {frames} frames. Is the re-transmitter on and in view, the depth camera running and its light on the photodiode? If the flashes are only in a part of the picture, give --region; if the image is turned against the sensor, --rotation; in another camera mode, --train{}", suffix(.lamp)
    )]
    NoFlashes {
        path: PathBuf,
        /// Number of frames that were examined.
        frames: usize,
        /// Description of a periodic light that was found instead.
        lamp: Option<String>,
    },
    /// Nothing shows that the bands are flashes of the depth camera.
    #[error(
        "{path}: nothing shows that these bands are the depth camera's flashes and not a dimmed lamp or the picture itself: the row time is not known, no end of the train is seen in frames beside some without any bands, and the bands do not move with the trigger{}", suffix(.lamp)
    )]
    Unproven { path: PathBuf, lamp: Option<String> },
    /// The row time of the bands is not that of the camera.
    #[error(
        "{path}: the bands fit a row time of {found_us:.1} µs, and the phone's readout in the rig profile is {expected_us:.1} ± {expected_sigma_us:.1} µs a row: they are not the depth camera's flashes, or the readout is wrong"
    )]
    RowTime {
        path: PathBuf,
        /// Row time that fits the bands, µs.
        found_us: f64,
        /// Row time by the profile, µs.
        expected_us: f64,
        /// Its 1-sigma, µs.
        expected_sigma_us: f64,
    },
    /// The bands move, so they are not flashes of a camera in step with the phone.
    #[error(
        "{path}: the bands move by {motion_us_per_s:.0} µs/s, {scatter_us:.0} µs about it: not the flashes of a camera in step with the phone{}", suffix(.lamp)
    )]
    NotInStep {
        path: PathBuf,
        motion_us_per_s: f64,
        scatter_us: f64,
        lamp: Option<String>,
    },
    /// All frames with flashes have changing room light.
    #[error(
        "{path}: {flicker} of {frames} frames seem to hold flashes, but their light differs from frame to frame (by about {peak_to_peak:.1} grey levels), as under lamps that flicker with the mains or in a moving picture: switch the lamps off and fix the phone"
    )]
    OnlyFlicker {
        path: PathBuf,
        flicker: usize,
        /// Number of frames that were examined.
        frames: usize,
        /// Peak-to-peak size of the flicker, grey levels.
        peak_to_peak: f64,
    },
    /// Too few frames have flashes.
    #[error("{path}: {found} frames with flashes, at least {MIN_FRAMES} are needed")]
    TooFewFrames { path: PathBuf, found: usize },
    /// The phone's video, its timestamps or its clock is missing.
    #[error("{path}: no video with its frame timestamps and the relation of the clocks")]
    LedUnseen { path: PathBuf },
    /// The video does not show the LED.
    #[error(transparent)]
    Led(#[from] LedRefusal),
    /// The rig profile cannot be read or written.
    #[error(transparent)]
    Profile(#[from] ProfileError),
    /// The recording's session cannot be read.
    #[error(transparent)]
    Session(#[from] RecordingError),
}

fn suffix(lamp: &Option<String>) -> String {
    lamp.as_ref()
        .map_or_else(String::new, |lamp| format!("; {lamp}"))
}

impl EvaluateError {
    /// Returns a function that adds the path to an I/O error.
    pub(crate) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self + Copy {
        move |source| Self::Io {
            path: path.to_owned(),
            source,
        }
    }

    pub(crate) fn from_video(path: &Path, error: VideoError) -> Self {
        let not_a_video = |message| Self::NotAVideo {
            path: path.to_owned(),
            message,
        };
        match error {
            VideoError::Missing(_) | VideoError::Run { .. } => Self::Ffmpeg(error),
            VideoError::Endless { .. } => not_a_video(error.to_string()),
            VideoError::NotAVideo(message) => not_a_video(message),
            VideoError::Decode(said) => not_a_video(format!(
                "no frame could be decoded; the file may be truncated, copy it again. ffmpeg says: {said}"
            )),
            VideoError::Size { width, height } => Self::Unsupported {
                path: path.to_owned(),
                width,
                height,
            },
        }
    }
}
