//! Raw pictures out of `ffmpeg`.

use std::io::Read;
use std::path::Path;
use std::process::{ChildStdout, Command, Stdio};
use std::sync::OnceLock;

use super::ffmpeg::Ffmpeg;
use super::{Info, VideoError, file_url, probe, program, run_error};

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
    pipe: Option<ChildStdout>,
    ffmpeg: Ffmpeg,
}

impl Video {
    /// Probes a file and starts to decode it.
    ///
    /// # Errors
    ///
    /// As [`probe`]; or `ffmpeg` is missing or cannot be run.
    pub fn open(path: &Path, pixels: Pixels) -> Result<Self, VideoError> {
        let info = probe(path)?;
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
        command
            .args(["-pix_fmt", format, "pipe:1"])
            .stdout(Stdio::piped());
        let mut ffmpeg = Ffmpeg::start(&mut command)?;
        let depth = if pixels == Pixels::Rgb { 3 } else { 1 };
        Ok(Self {
            frame_bytes: info.width as usize * info.height as usize * depth,
            info,
            pipe: ffmpeg.output(),
            ffmpeg,
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
    /// `ffmpeg` complained, or ended within a frame. The frames before are good, and
    /// there are none after.
    pub fn next_frame(&mut self, frame: &mut Vec<u8>) -> Result<bool, VideoError> {
        let Some(pipe) = &mut self.pipe else {
            return Ok(false);
        };
        frame.clear();
        frame.reserve_exact(self.frame_bytes);
        let read = pipe.take(self.frame_bytes as u64).read_to_end(frame);
        if matches!(read, Ok(n) if n == self.frame_bytes) {
            return Ok(true);
        }
        self.pipe = None;
        let read = read.map_err(|error| run_error("ffmpeg", error))?;
        match self.ffmpeg.end()? {
            Some(complaint) => Err(VideoError::Decode(complaint)),
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
        let output = Command::new("ffmpeg")
            .arg("-version")
            .stdin(Stdio::null())
            .output();
        let text = output.map(|o| String::from_utf8_lossy(&o.stdout).into_owned());
        if text.is_ok_and(|text| is_before_5_1(&text)) {
            "-vsync"
        } else {
            "-fps_mode"
        }
    })
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
