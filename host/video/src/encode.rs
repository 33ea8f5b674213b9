//! Pictures into a video by `ffmpeg`.

use std::io::Write as _;
use std::path::Path;
use std::process::{ChildStdin, Command, Stdio};

use super::ffmpeg::Ffmpeg;
use super::{VideoError, file_url};

/// Frames from one that stands by itself to the next: each is found fast.
const KEY_FRAMES: &str = "2";

/// An MP4 file of H.264 that is being written, of frames at one distance.
#[derive(Debug)]
pub struct Encoder {
    /// `None` after the end.
    pipe: Option<ChildStdin>,
    ffmpeg: Ffmpeg,
}

impl Encoder {
    /// Begins a file; one that is there is replaced. Frames are `size` (width, height), `fps`
    /// of them a second.
    ///
    /// # Errors
    ///
    /// `ffmpeg` is missing or cannot be run.
    pub fn create(path: &Path, size: (u32, u32), fps: u32) -> Result<Self, VideoError> {
        let (width, height) = size;
        // Half as many colours need even sides.
        let format = match width % 2 + height % 2 {
            0 => "yuv420p",
            _ => "yuv444p",
        };
        let mut command = Command::new("ffmpeg");
        command
            .args(["-v", "error", "-nostdin", "-y"])
            .args(["-f", "rawvideo", "-pix_fmt", "rgb24"])
            .args(["-video_size", &format!("{width}x{height}")])
            .args(["-framerate", &fps.to_string(), "-i", "pipe:0"])
            .args(["-c:v", "libx264", "-crf", "18", "-g", KEY_FRAMES])
            .args(["-pix_fmt", format, "-fflags", "+bitexact", "-f", "mp4"])
            .arg(file_url(path))
            .stdin(Stdio::piped())
            .stdout(Stdio::null());
        let mut ffmpeg = Ffmpeg::start(&mut command)?;
        Ok(Self {
            pipe: ffmpeg.input(),
            ffmpeg,
        })
    }

    /// Adds a frame: red, green and blue of each pixel, row by row.
    ///
    /// # Errors
    ///
    /// `ffmpeg` complained.
    pub fn write(&mut self, frame: &[u8]) -> Result<(), VideoError> {
        match self.pipe.as_mut().map(|pipe| pipe.write_all(frame)) {
            Some(Ok(())) => Ok(()),
            // What it says is the reason; it has closed the pipe.
            Some(Err(_)) | None => self.end(),
        }
    }

    /// Finishes the file.
    ///
    /// # Errors
    ///
    /// `ffmpeg` complained.
    pub fn finish(mut self) -> Result<(), VideoError> {
        self.end()
    }

    fn end(&mut self) -> Result<(), VideoError> {
        self.pipe = None;
        match self.ffmpeg.end()? {
            Some(complaint) => Err(VideoError::Encode(complaint)),
            None => Ok(()),
        }
    }
}
