//! Frames of the phone's video, decoded by ffmpeg.
//!
//! ffmpeg runs as a process of its own and writes each frame as a PPM image into
//! a pipe: the frames come one by one with their size in front, nothing is
//! dropped or doubled to reach a constant rate, and memory is one frame. The
//! video is not turned upright (rows stay the sensor's rows, which is what a
//! rolling shutter is about).
//!
//! ffmpeg is looked up as `ffmpeg` in `PATH`. Without it there are no images;
//! everything else is extracted.

use std::ffi::OsString;
use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::thread::JoinHandle;

/// Largest side of a frame.
const MAX_SIDE: u32 = 16_384;
/// Bytes of ffmpeg's messages that are kept.
const MAX_MESSAGES: u64 = 16 * 1024;

/// Why there are no frames.
#[derive(Debug, thiserror::Error)]
pub enum VideoError {
    /// There is no ffmpeg.
    #[error(
        "ffmpeg is needed to decode the video and was not found in PATH; install it \
         (Debian, Ubuntu: `sudo apt install ffmpeg`) and run the extraction again: \
         it goes on where it stopped"
    )]
    NoFfmpeg,
    /// It could not be run.
    #[error("running ffmpeg: {0}")]
    Run(io::Error),
    /// It stopped with an error.
    #[error("ffmpeg cannot decode the video to its end: {0}")]
    Decode(String),
    /// Its output is not as asked for.
    #[error("ffmpeg's output is no sequence of PPM images: {0}")]
    Output(&'static str),
}

/// A decoded frame: 8 bits each of red, green and blue.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RgbFrame {
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Row by row.
    pub pixels: Vec<u8>,
}

/// A video being decoded.
#[derive(Debug)]
pub struct Video {
    child: Child,
    pipe: BufReader<ChildStdout>,
    messages: Option<JoinHandle<String>>,
    ended: bool,
}

impl Video {
    /// Starts ffmpeg on a file.
    ///
    /// # Errors
    ///
    /// There is no ffmpeg, or it cannot be run.
    pub fn open(path: &Path) -> Result<Self, VideoError> {
        // As a `file:` address, no file name can be taken for an option or for
        // another protocol of ffmpeg's.
        let mut input = OsString::from("file:");
        input.push(path);
        let mut child = Command::new("ffmpeg")
            .args(["-nostdin", "-v", "error", "-noautorotate", "-i"])
            .arg(input)
            .args(["-map", "0:v:0", passthrough()[0], passthrough()[1]])
            .args([
                "-f",
                "image2pipe",
                "-c:v",
                "ppm",
                "-pix_fmt",
                "rgb24",
                "pipe:1",
            ])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|error| match error.kind() {
                io::ErrorKind::NotFound => VideoError::NoFfmpeg,
                _ => VideoError::Run(error),
            })?;
        let pipe = child.stdout.take().ok_or(VideoError::Output("no pipe"))?;
        let messages = child.stderr.take().map(|mut stderr| {
            std::thread::spawn(move || {
                let mut text = Vec::new();
                // What is beyond the limit is read too, or ffmpeg would wait.
                let _ = (&mut stderr).take(MAX_MESSAGES).read_to_end(&mut text);
                let _ = io::copy(&mut stderr, &mut io::sink());
                String::from_utf8_lossy(&text).trim().to_owned()
            })
        });
        Ok(Self {
            child,
            pipe: BufReader::with_capacity(1 << 20, pipe),
            messages,
            ended: false,
        })
    }

    /// The next frame; `None` at the end of the video.
    ///
    /// # Errors
    ///
    /// ffmpeg stopped with an error. Frames before are good.
    pub fn next_frame(&mut self) -> Result<Option<RgbFrame>, VideoError> {
        if self.ended {
            return Ok(None);
        }
        match read_ppm(&mut self.pipe) {
            Ok(Some(frame)) => Ok(Some(frame)),
            Ok(None) => {
                self.ended = true;
                self.verdict()?;
                Ok(None)
            }
            Err(error) => {
                self.ended = true;
                if !matches!(error, PpmError::End) {
                    // It may still be writing into the pipe.
                    let _ = self.child.kill();
                }
                self.verdict()?;
                Err(match error {
                    PpmError::Io(error) => VideoError::Run(error),
                    PpmError::End => VideoError::Output("it ends within a frame"),
                    PpmError::Format(what) => VideoError::Output(what),
                })
            }
        }
    }

    /// Waits for ffmpeg's end.
    fn verdict(&mut self) -> Result<(), VideoError> {
        let status = self.child.wait().map_err(VideoError::Run)?;
        let messages = self.messages.take().and_then(|thread| thread.join().ok());
        let messages = messages.unwrap_or_default();
        if status.success() && messages.is_empty() {
            return Ok(());
        }
        // The first line names the cause; with `-v error` there is little else.
        let mut lines = messages.lines();
        let first = lines.next().unwrap_or("no message").to_owned();
        Err(VideoError::Decode(first))
    }
}

impl Drop for Video {
    fn drop(&mut self) {
        if !self.ended {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}

/// The option that passes every frame once: renamed in ffmpeg 5.1, and the old
/// name is on its way out.
fn passthrough() -> [&'static str; 2] {
    static NAME: std::sync::OnceLock<&str> = std::sync::OnceLock::new();
    let name = NAME.get_or_init(|| {
        let version = Command::new("ffmpeg")
            .arg("-version")
            .stdin(Stdio::null())
            .output();
        let text = version.map(|output| String::from_utf8_lossy(&output.stdout).into_owned());
        if text.is_ok_and(|text| is_before_5_1(&text)) {
            "-vsync"
        } else {
            "-fps_mode"
        }
    });
    [name, "passthrough"]
}

/// `ffmpeg version 4.4.2-0ubuntu...`; builds from a repository have no number
/// and are new.
fn is_before_5_1(version: &str) -> bool {
    let Some(word) = version.split_whitespace().nth(2) else {
        return false;
    };
    let mut numbers = word.split(|c: char| !c.is_ascii_digit());
    let major: Option<u32> = numbers.next().and_then(|number| number.parse().ok());
    let minor: Option<u32> = numbers.next().and_then(|number| number.parse().ok());
    matches!((major, minor), (Some(major), minor) if (major, minor.unwrap_or(0)) < (5, 1))
}

#[derive(Debug)]
enum PpmError {
    Io(io::Error),
    End,
    Format(&'static str),
}

impl From<io::Error> for PpmError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

/// Reads a binary PPM image; `None` at the end of the stream.
fn read_ppm(reader: &mut impl BufRead) -> Result<Option<RgbFrame>, PpmError> {
    let mut bytes = reader.by_ref().bytes();
    let mut word = || -> Result<Option<String>, PpmError> {
        let mut word = String::new();
        for byte in bytes.by_ref() {
            let byte = byte?;
            if byte.is_ascii_whitespace() {
                return Ok(Some(word));
            }
            if word.len() > 8 {
                return Err(PpmError::Format("a word of the head is too long"));
            }
            word.push(byte.into());
        }
        Ok((!word.is_empty()).then_some(word))
    };
    match word()?.as_deref() {
        None => return Ok(None),
        Some("P6") => {}
        Some(_) => return Err(PpmError::Format("it does not begin with P6")),
    }
    let mut number = || -> Result<u32, PpmError> {
        let word = word()?.ok_or(PpmError::End)?;
        word.parse()
            .map_err(|_| PpmError::Format("a size is no number"))
    };
    let (width, height, depth) = (number()?, number()?, number()?);
    let sides = 1..=MAX_SIDE;
    if !sides.contains(&width) || !sides.contains(&height) || depth != 255 {
        return Err(PpmError::Format("a frame's size is out of range"));
    }
    let size = u64::from(width) * u64::from(height) * 3;
    let mut pixels = Vec::new();
    reader.take(size).read_to_end(&mut pixels)?;
    if (pixels.len() as u64) < size {
        return Err(PpmError::End);
    }
    Ok(Some(RgbFrame {
        width,
        height,
        pixels,
    }))
}

/// Presentation times of the video's frames in ns from the first, by ffprobe.
/// `None` if it is not there or the file has none.
#[must_use]
pub fn presentation_times(path: &Path) -> Option<Vec<i64>> {
    let mut input = OsString::from("file:");
    input.push(path);
    let output = Command::new("ffprobe")
        .args(["-v", "error", "-select_streams", "v:0"])
        .args([
            "-show_entries",
            "packet=pts:stream=time_base",
            "-of",
            "csv=p=0",
        ])
        .arg(input)
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .output()
        .ok()?;
    parse_presentation_times(&String::from_utf8_lossy(&output.stdout))
}

/// Times in ns from the first, in order, of `ffprobe`'s answer: lines of integers in
/// units of a fraction such as `1/90000` s that stands in a line of its own. `None`
/// if there is no fraction, or no times.
#[must_use]
pub fn parse_presentation_times(text: &str) -> Option<Vec<i64>> {
    let mut base = None;
    let mut times: Vec<i128> = Vec::new();
    for line in text.lines() {
        let line = line.trim().trim_end_matches(',');
        if let Some((num, den)) = line.split_once('/') {
            // 32 bits each in the file; no product below leaves 128.
            base = Some((
                i128::from(num.parse::<u32>().ok()?),
                i128::from(den.parse::<u32>().ok().filter(|&den| den > 0)?),
            ));
        } else if let Ok(time) = line.parse::<i64>() {
            times.push(time.into());
        }
    }
    let (num, den) = base?;
    // Packets stand in decoding order.
    times.sort_unstable();
    let first = *times.first()?;
    let nanos = times.into_iter().map(|time| {
        let nanos = (time - first) * num * 1_000_000_000 / den;
        i64::try_from(nanos).ok()
    });
    nanos.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_follow_each_other_in_the_pipe() {
        let stream = b"P6\n2 1\n255\nabcdefP6 1 1 255 xyz";
        let mut reader = &stream[..];
        let first = read_ppm(&mut reader).unwrap().unwrap();
        assert_eq!(
            (first.width, first.height, first.pixels.as_slice()),
            (2, 1, &b"abcdef"[..])
        );
        assert_eq!(read_ppm(&mut reader).unwrap().unwrap().pixels, b"xyz");
        assert!(read_ppm(&mut reader).unwrap().is_none());
        for broken in [
            &b"P5\n2 1\n255\nab"[..],
            b"P6\n2 1\n255\nabc",
            b"P6\n99999 1\n255\n",
            b"P6\n2",
        ] {
            assert!(read_ppm(&mut { broken }).is_err(), "{broken:?}");
        }
    }

    #[test]
    fn the_option_follows_the_version() {
        assert!(is_before_5_1(
            "ffmpeg version 4.4.2-0ubuntu0.22.04.1 Copyright"
        ));
        assert!(is_before_5_1("ffmpeg version 5.0 Copyright"));
        assert!(!is_before_5_1("ffmpeg version 5.1.9-0+deb12u1 Copyright"));
        assert!(!is_before_5_1("ffmpeg version N-109-gabc Copyright"));
        assert!(!is_before_5_1(""));
    }

    #[test]
    fn presentation_times_are_integers() {
        let text = "0,\n3003\n1501,\n1/90000\n";
        let times = parse_presentation_times(text).unwrap();
        assert_eq!(times, [0, 16_677_777, 33_366_666]);
        assert_eq!(parse_presentation_times("garbage"), None);
        assert_eq!(parse_presentation_times("1\n1/0\n"), None);
    }
}
