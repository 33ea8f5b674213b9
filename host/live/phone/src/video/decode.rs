//! Raw pictures out of `ffmpeg`.

use std::path::Path;
use std::process::Command;
use std::sync::OnceLock;
use std::time::Duration;

use system::{Limits, ReadMonitor, Running};

use super::{Info, VideoError, failed, file_url, limits, probe, program};

/// Frames beyond those that a file announces that are taken: some containers count in fields
/// or leave out the last.
const MORE_FRAMES: u64 = 100;

/// What a frame is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pixels {
    /// The luma plane as it was coded, 8 bits, without a conversion of its range
    /// ([`Info::full_range`]). Colours that are not luma and chroma are converted.
    Luma,
    /// 8 bits each of red, green and blue.
    Rgb,
}

/// A video being decoded. Dropping it stops the decoder.
#[derive(Debug)]
pub struct Video {
    info: Info,
    frame_bytes: usize,
    /// `None` after the end.
    ffmpeg: Option<Running>,
    /// Frames that came, and the most that the file can hold.
    came: u64,
    most: u64,
}

impl Video {
    /// Probes a file and starts to decode it.
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
        // Where it does not say, each frame takes at least a byte of it.
        let announced = info.frames;
        let announced = announced.map(|n| n.saturating_mul(2).saturating_add(MORE_FRAMES));
        Ok(Self {
            frame_bytes: info.width as usize * info.height as usize * depth,
            most: announced.unwrap_or(info.bytes),
            came: 0,
            info,
            ffmpeg: Some(ffmpeg),
        })
    }

    /// What the file says about itself.
    #[must_use]
    pub const fn info(&self) -> &Info {
        &self.info
    }

    /// Reads the next frame, row by row, into `frame`; false after the last.
    ///
    /// # Errors
    ///
    /// `ffmpeg` complained, ended within a frame, or would not end. The frames before are
    /// good, and there are none after.
    pub fn next_frame(&mut self, frame: &mut Vec<u8>) -> Result<bool, VideoError> {
        let Some(mut ffmpeg) = self.ffmpeg.take() else {
            return Ok(false);
        };
        let read = ffmpeg.read(self.frame_bytes, frame);
        let read = read.map_err(failed("ffmpeg"))?;
        if read == self.frame_bytes {
            if self.came == self.most {
                let what = format!(
                    "it gave more than {} frames, the most that the video can hold",
                    self.most
                );
                return Err(VideoError::Endless {
                    program: "ffmpeg",
                    what,
                });
            }
            self.came += 1;
            self.ffmpeg = Some(ffmpeg);
            return Ok(true);
        }
        let end = ffmpeg.finish().map_err(failed("ffmpeg"))?;
        // The first line names the cause; with `-v error` there is little else.
        match end.messages.lines().next() {
            Some(first) => Err(VideoError::Decode(first.to_owned())),
            None if !end.status.success() => Err(VideoError::Decode("no message".to_owned())),
            None if read > 0 => Err(VideoError::Decode("it ends within a frame".to_owned())),
            None => Ok(false),
        }
    }
}

/// The option that passes every frame once: renamed in ffmpeg 5.1, and the old name
/// is on its way out.
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

/// Returns what `ffmpeg` prints about its version; `None` if it cannot be run.
#[must_use]
pub fn version() -> Option<String> {
    let limits = Limits {
        run: Some(Duration::from_secs(10)),
        own_group: true,
        ..Limits::default()
    };
    let output = system::run(Command::new("ffmpeg").arg("-version"), limits, 64 * 1024);
    let output = output.ok().filter(|output| output.status.success())?;
    Some(String::from_utf8_lossy(&output.stdout).into_owned())
}

/// `ffmpeg version 4.4.2-0ubuntu...`, `ffmpeg version n4.4`. Builds of a development
/// snapshot are named by date or revision, and are new.
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
