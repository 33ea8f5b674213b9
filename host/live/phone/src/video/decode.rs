//! Decodes videos with `ffmpeg`.

use std::path::Path;
use std::process::Command;
use std::sync::OnceLock;
use std::time::Duration;

use system::{Limits, ReadMonitor, Running};

use super::{Info, VideoError, failed, file_url, limits, probe, program};

/// Frames that are accepted beyond twice the stated number: some containers count fields or leave
/// out the last frames.
const MORE_FRAMES: u64 = 100;

/// Format of the pixels of a decoded frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pixels {
    /// One byte per pixel: the luma plane as it was coded, without a conversion of its range
    /// ([`Info::full_range`]). Formats without a luma plane are converted.
    Luma,
    /// Three bytes per pixel: red, green and blue.
    Rgb,
}

/// A video being decoded. Dropping it stops the decoder.
#[derive(Debug)]
pub struct Video {
    info: Info,
    frame_bytes: usize,
    /// `None` after the end.
    ffmpeg: Option<Running>,
    /// Frames that were returned, and the most that the file can hold.
    returned: u64,
    most: u64,
}

impl Video {
    /// Probes a file and starts to decode its first video, under `monitor`.
    ///
    /// # Errors
    ///
    /// As [`probe`]; or `ffmpeg` is missing or cannot be run.
    pub fn open(path: &Path, pixels: Pixels, monitor: &ReadMonitor) -> Result<Self, VideoError> {
        let info = probe(path, monitor)?;
        let mut command = program("ffmpeg");
        command
            .args(["-nostdin", "-noautorotate", "-i"])
            .arg(file_url(path))
            .args(["-map", "0:v:0", "-an", "-sn", "-dn"])
            .args([passthrough(), "passthrough", "-f", "rawvideo"]);
        let format = match pixels {
            Pixels::Luma => {
                if info.has_planes() {
                    command.args(["-vf", "extractplanes=y"]);
                }
                "gray"
            }
            Pixels::Rgb => "rgb24",
        };
        command.args(["-pix_fmt", format, "pipe:1"]);
        let ffmpeg =
            Running::start(&mut command, limits(path, monitor)).map_err(failed("ffmpeg"))?;
        let depth = if pixels == Pixels::Rgb { 3 } else { 1 };
        // If the number is not stated: each frame takes at least one byte.
        let announced = info.frames;
        let announced = announced.map(|n| n.saturating_mul(2).saturating_add(MORE_FRAMES));
        Ok(Self {
            frame_bytes: info.width as usize * info.height as usize * depth,
            most: announced.unwrap_or(info.bytes),
            returned: 0,
            info,
            ffmpeg: Some(ffmpeg),
        })
    }

    /// Returns the properties that the file states.
    #[must_use]
    pub const fn info(&self) -> &Info {
        &self.info
    }

    /// Reads the next frame into `frame`, row by row. Returns false after the last frame.
    ///
    /// # Errors
    ///
    /// `ffmpeg` reports an error, ends within a frame, or exceeds a limit; or the read is
    /// cancelled. The frames before are good, and there are none after.
    pub fn next_frame(&mut self, frame: &mut Vec<u8>) -> Result<bool, VideoError> {
        let Some(mut ffmpeg) = self.ffmpeg.take() else {
            return Ok(false);
        };
        let read = ffmpeg.read(self.frame_bytes, frame);
        let read = read.map_err(failed("ffmpeg"))?;
        if read == self.frame_bytes {
            if self.returned == self.most {
                let what = format!(
                    "it returned more than {} frames, the most that the video can hold",
                    self.most
                );
                return Err(VideoError::Endless {
                    program: "ffmpeg",
                    what,
                });
            }
            self.returned += 1;
            self.ffmpeg = Some(ffmpeg);
            return Ok(true);
        }
        let end = ffmpeg.finish(0).map_err(failed("ffmpeg"))?;
        // The first line names the cause.
        match end.messages.lines().next() {
            Some(first) => Err(VideoError::Decode(first.to_owned())),
            None if !end.status.success() => Err(VideoError::Decode("no message".to_owned())),
            None if read > 0 => Err(VideoError::Decode("it ends within a frame".to_owned())),
            None => Ok(false),
        }
    }
}

/// Returns the name of the option that passes every frame once. ffmpeg 5.1 renamed it, and later
/// versions drop the old name.
fn passthrough() -> &'static str {
    static NAME: OnceLock<&str> = OnceLock::new();
    NAME.get_or_init(|| {
        let text = version().unwrap_or_default();
        if is_before_5_1(&text) {
            "-vsync"
        } else {
            "-fps_mode"
        }
    })
}

/// Longest run of `ffmpeg -version`.
const VERSION_TIME: Duration = Duration::from_secs(10);

/// Returns the text of `ffmpeg -version`, or `None` if `ffmpeg` cannot be run.
#[must_use]
pub fn version() -> Option<String> {
    let limits = Limits {
        run: Some(VERSION_TIME),
        own_group: true,
        ..Limits::default()
    };
    let output = system::run(Command::new("ffmpeg").arg("-version"), limits, 64 * 1024);
    let output = output.ok().filter(|output| output.status.success())?;
    Some(String::from_utf8_lossy(&output.stdout).into_owned())
}

/// Returns true for the text of a version before 5.1: `ffmpeg version 4.4.2-0ubuntu...` or `ffmpeg
/// version n4.4`. Development snapshots are named by date or revision, and count as new.
fn is_before_5_1(text: &str) -> bool {
    let version = text.split_whitespace().nth(2).unwrap_or_default();
    let mut numbers = version
        .trim_start_matches('n')
        .split(|c: char| !c.is_ascii_digit())
        .map(str::parse::<u32>);
    let (major, minor) = (numbers.next(), numbers.next());
    matches!(major, Some(Ok(major)) if (major, minor.and_then(Result::ok).unwrap_or(0)) < (5, 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_of_ffmpeg() {
        for (version, before) in [
            ("n4.4", true),
            ("4.4.2-0ubuntu0.22.04.1", true),
            ("5.0", true),
            ("4", true),
            ("5.1.6-0+deb12u1", false),
            ("n7.0.1", false),
            ("8", false),
            // A snapshot by revision, and one by date.
            ("N-109-gabc", false),
            ("N-113007-g8d24a28d06", false),
            ("2024-01-15-git-1e9e0e8-full_build", false),
        ] {
            let text = format!("ffmpeg version {version} Copyright (c) 2000-2024");
            assert_eq!(is_before_5_1(&text), before, "{version}");
        }
        assert!(!is_before_5_1(""));
    }
}
