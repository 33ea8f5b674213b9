//! Writes grey frames to an H.264 MP4 through an `ffmpeg` child process.
//!
//! The real encoder, so that tests and the simulated phone meet real compression:
//! blocks, rate control and frames that repeat their predecessor. Settings follow
//! phones: no B-frames, a key frame a second, limited-range 4:2:0.

use std::fs::File;
use std::io::{Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use anyhow::{Error, Result, anyhow, bail, ensure};

use crate::picture::rolling_shutter::GreyImage;

/// Compression of the video.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Quality {
    /// Constant rate factor of x264: 0 is lossless, 23 its default.
    RateFactor(u8),
    /// Average bit rate in bits per second; phones use about 17 Mbit/s for 1080p30.
    BitRate(u64),
    /// Another encoder or other settings, as arguments of `ffmpeg`.
    With(&'static [&'static str]),
}

/// Settings of a video.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VideoSettings {
    /// Pixels in an image row.
    pub width: usize,
    /// Image rows.
    pub height: usize,
    /// Frames per second written to the file.
    pub frame_rate: f64,
    /// Compression.
    pub quality: Quality,
}

/// A video that is being written. Call [`finish`](Self::finish); a writer that
/// is dropped unfinished ends its encoder and leaves an incomplete file.
#[derive(Debug)]
pub struct Mp4Writer {
    settings: VideoSettings,
    path: PathBuf,
    child: Child,
    /// Its messages on standard error.
    messages: File,
}

impl Mp4Writer {
    /// Starts the encoder; an existing file is replaced.
    pub fn create(path: &Path, settings: VideoSettings) -> Result<Self> {
        let VideoSettings { width, height, .. } = settings;
        if width % 2 != 0 || height % 2 != 0 || width == 0 || height == 0 {
            bail!("H.264 needs an even width and height, not {width}x{height}");
        }
        let mut command = Command::new("ffmpeg");
        command
            .args(["-v", "error", "-nostdin", "-y"])
            .args(["-f", "rawvideo", "-pix_fmt", "gray"])
            .args(["-s", &format!("{width}x{height}")])
            .args(["-r", &settings.frame_rate.to_string(), "-i", "pipe:0"])
            .args(["-c:v", "libx264", "-preset", "veryfast", "-bf", "0"])
            .args(["-g", &format!("{:.0}", settings.frame_rate.max(1.0))])
            .args(["-pix_fmt", "yuv420p"]);
        match settings.quality {
            Quality::RateFactor(crf) => command.args(["-crf", &crf.to_string()]),
            Quality::BitRate(rate) => command
                .args(["-b:v", &rate.to_string()])
                .args(["-maxrate", &rate.to_string()])
                .args(["-bufsize", &rate.to_string()]),
            Quality::With(arguments) => command.args(arguments),
        };
        let messages = tempfile::tempfile()?;
        let child = command
            .arg(path)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(messages.try_clone()?)
            .spawn()
            .map_err(|e| match e.kind() {
                std::io::ErrorKind::NotFound => anyhow!(
                    "ffmpeg was not found: videos are encoded by the `ffmpeg` program; install it \
                     (Debian, Ubuntu: `apt install ffmpeg`) and see that it is on the PATH"
                ),
                _ => anyhow!("ffmpeg could not be started: {e}"),
            })?;
        Ok(Self {
            settings,
            path: path.to_owned(),
            child,
            messages,
        })
    }

    /// Appends one frame.
    pub fn write(&mut self, frame: &GreyImage) -> Result<()> {
        let VideoSettings { width, height, .. } = self.settings;
        ensure!(
            (frame.width, frame.height) == (width, height) && frame.pixels.len() == width * height,
            "frame of {}x{} pixels for a video of {width}x{height}",
            frame.width,
            frame.height
        );
        let written = match self.child.stdin.as_mut() {
            Some(pipe) => pipe.write_all(&frame.pixels),
            None => Err(std::io::ErrorKind::BrokenPipe.into()),
        };
        match written {
            Ok(()) => Ok(()),
            // The encoder's own words say more than "broken pipe".
            Err(e) => Err(self.encoder_error(&e.to_string())),
        }
    }

    /// Ends the video and waits for the encoder.
    pub fn finish(mut self) -> Result<()> {
        drop(self.child.stdin.take());
        match self.child.wait() {
            Ok(status) if status.success() => Ok(()),
            Ok(status) => Err(self.encoder_error(&status.to_string())),
            Err(e) => Err(self.encoder_error(&e.to_string())),
        }
    }

    fn encoder_error(&mut self, fallback: &str) -> Error {
        drop(self.child.stdin.take());
        let _ = self.child.wait();
        let mut said = Vec::new();
        // Without its words there is the fallback.
        let _ = self.messages.rewind();
        let _ = (&self.messages).take(4096).read_to_end(&mut said);
        let said = String::from_utf8_lossy(&said);
        let said = said.trim();
        let message = if said.is_empty() { fallback } else { said };
        anyhow!("ffmpeg failed to write {}: {message}", self.path.display())
    }
}

impl Drop for Mp4Writer {
    fn drop(&mut self) {
        if self.child.stdin.take().is_some() {
            // Unfinished: the caller gave up, so the encoder does too.
            let _ = self.child.kill();
        }
        let _ = self.child.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SETTINGS: VideoSettings = VideoSettings {
        width: 64,
        height: 48,
        frame_rate: 30.0,
        quality: Quality::RateFactor(20),
    };

    fn grey(width: usize, height: usize) -> GreyImage {
        GreyImage {
            width,
            height,
            pixels: vec![90; width * height],
        }
    }

    #[test]
    fn refuses_what_cannot_be_encoded() {
        let dir = tempfile::tempdir().unwrap();
        let odd = VideoSettings {
            width: 63,
            ..SETTINGS
        };
        let e = Mp4Writer::create(&dir.path().join("odd.mp4"), odd).unwrap_err();
        assert!(e.to_string().contains("63x48"), "{e}");

        let mut writer = Mp4Writer::create(&dir.path().join("size.mp4"), SETTINGS).unwrap();
        let e = writer.write(&grey(32, 48)).unwrap_err();
        assert!(e.to_string().contains("32x48"), "{e}");
    }

    #[test]
    fn the_encoder_s_words_reach_the_error() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("no such folder").join("video.mp4");
        let mut writer = Mp4Writer::create(&path, SETTINGS).unwrap();
        let failed = loop {
            if let Err(e) = writer.write(&grey(64, 48)) {
                break e;
            }
        };
        assert!(failed.to_string().contains("No such file"), "{failed}");
    }
}
