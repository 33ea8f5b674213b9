//! Videos: `ffprobe` for what the file says, `ffmpeg` for its grey pixels.
//!
//! The decoder writes raw grey frames into a pipe. Only one frame is ever held,
//! whatever the length and size of the video. The picture is taken as it was
//! coded (`-noautorotate`), because it is the sensor's rows that count, and the
//! luma plane as it is, without a conversion of its range.

use std::ffi::OsString;
use std::io::{ErrorKind, Read};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::thread::JoinHandle;

use serde::Deserialize;

use super::timestamps::beside;
use super::{FrameSource, FrameTimes, SourceInfo, check_size, read_timestamps};
use crate::EvaluateError;
use crate::frame::GreyView;

/// Rate taken when the file does not say one, frames per second.
const DEFAULT_RATE: f64 = 30.0;
/// How much of the decoder's messages is kept.
const KEPT_MESSAGES: usize = 2048;

#[derive(Debug, Default, Deserialize)]
struct Probe {
    #[serde(default)]
    streams: Vec<Stream>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Stream {
    width: u64,
    height: u64,
    pix_fmt: String,
    color_range: String,
    avg_frame_rate: String,
    nb_frames: String,
    duration: String,
}

pub(super) struct Video {
    info: SourceInfo,
    child: Child,
    pipe: Option<ChildStdout>,
    messages: Option<JoinHandle<String>>,
    frame: Vec<u8>,
    read: u64,
}

impl Video {
    pub(super) fn open(path: &Path, timestamps: Option<&Path>) -> Result<Self, EvaluateError> {
        let stream = probe(path)?;
        let (width, height) = check_size(path, stream.width, stream.height)?;
        let mut notes = Vec::new();
        let frames = stream.nb_frames.parse::<u64>().ok().filter(|&n| n > 0);
        let times = match timestamps.map(Path::to_owned).or_else(|| beside(path)) {
            Some(file) => {
                let times = read_timestamps(&file)?;
                if let Some(n) = frames.filter(|&n| n != times.len() as u64) {
                    notes.push(format!(
                        "{}: {} timestamps for a video of {n} frames; frames without a timestamp are left out",
                        file.display(),
                        times.len()
                    ));
                }
                FrameTimes::Listed(times)
            }
            None => FrameTimes::Rate(frame_rate(&stream).unwrap_or_else(|| {
                notes.push(format!(
                    "the video does not say its frame rate: taken as {DEFAULT_RATE} frames per second"
                ));
                DEFAULT_RATE
            })),
        };

        // 10-bit video is reduced to 8 bits; colours that are not luma and chroma
        // are converted.
        let has_luma = ["yuv", "nv", "gray", "p0"]
            .iter()
            .any(|p| stream.pix_fmt.starts_with(p));
        let full_range = stream.color_range == "pc" || !has_luma;
        let mut command = Command::new("ffmpeg");
        command
            .args(["-v", "error", "-nostdin", "-noautorotate"])
            .args(["-protocol_whitelist", "file"])
            .arg("-i")
            .arg(file_url(path))
            .args(["-map", "0:v:0", "-an", "-sn", "-dn"])
            .args(keep_every_frame());
        if has_luma && !stream.pix_fmt.starts_with("gray") {
            command.args(["-vf", "extractplanes=y"]);
        }
        let mut child = command
            .args(["-f", "rawvideo", "-pix_fmt", "gray", "pipe:1"])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|e| start_error("ffmpeg", e))?;
        let pipe = child.stdout.take();
        let messages = child
            .stderr
            .take()
            .map(|pipe| std::thread::spawn(move || keep_start(pipe)));
        Ok(Self {
            info: SourceInfo {
                encoded: true,
                path: path.to_owned(),
                width,
                height,
                white: if full_range { 253 } else { 234 },
                frames,
                times,
                notes,
            },
            child,
            pipe,
            messages,
            frame: vec![0; width * height],
            read: 0,
        })
    }

    fn said(&mut self) -> String {
        let said = self.messages.take().and_then(|m| m.join().ok());
        said.unwrap_or_default().trim().to_owned()
    }
}

impl FrameSource for Video {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn next_frame(&mut self) -> Result<Option<GreyView<'_>>, EvaluateError> {
        let Some(pipe) = self.pipe.as_mut() else {
            return Ok(None);
        };
        let mut filled = 0;
        while let Some(rest) = self.frame.get_mut(filled..).filter(|r| !r.is_empty()) {
            match pipe.read(rest) {
                Ok(0) => break,
                Ok(n) => filled += n,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(source) => {
                    return Err(EvaluateError::Io {
                        path: self.info.path.clone(),
                        source,
                    });
                }
            }
        }
        if filled == self.frame.len() {
            self.read += 1;
            return Ok(Some(GreyView {
                width: self.info.width,
                height: self.info.height,
                pixels: &self.frame,
            }));
        }
        self.pipe = None;
        if self.read == 0 {
            let said = self.said();
            return Err(EvaluateError::NotAVideo {
                path: self.info.path.clone(),
                message: format!(
                    "no frame could be decoded; the file may be truncated, copy it again. ffmpeg says: {}",
                    if said.is_empty() { "nothing" } else { &said }
                ),
            });
        }
        if filled > 0 {
            self.info
                .notes
                .push("the decoder ended in the middle of a frame".to_owned());
        }
        Ok(None)
    }

    fn closing_notes(&mut self) -> Vec<String> {
        let mut notes = std::mem::take(&mut self.info.notes);
        if self.pipe.is_some() {
            // Stopped on purpose before the end.
            return notes;
        }
        let said = self.said();
        let missing = self.info.frames.filter(|&n| self.read < n);
        if let Some(n) = missing {
            notes.push(format!(
                "truncated: {} of {n} frames could be read",
                self.read
            ));
        }
        if !said.is_empty() {
            let first = said.lines().next().unwrap_or_default();
            notes.push(format!("damaged video, ffmpeg says: {first}"));
        }
        notes
    }
}

impl Drop for Video {
    fn drop(&mut self) {
        self.pipe = None;
        // Only a decoder that is still at work is stopped; both calls may find
        // that it has ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn probe(path: &Path) -> Result<Stream, EvaluateError> {
    let output = Command::new("ffprobe")
        .args(["-v", "error", "-protocol_whitelist", "file"])
        .args(["-select_streams", "v:0", "-of", "json"])
        .args([
            "-show_entries",
            "stream=width,height,pix_fmt,color_range,avg_frame_rate,nb_frames,duration",
        ])
        .arg("-i")
        .arg(file_url(path))
        .stdin(Stdio::null())
        .output()
        .map_err(|e| start_error("ffprobe", e))?;
    let not_a_video = |message: String| EvaluateError::NotAVideo {
        path: path.to_owned(),
        message,
    };
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        let said = said.lines().next().unwrap_or("no reason given");
        let hint = if said.contains("moov atom not found") {
            "; the file is truncated: the camera writes its index at the end. Copy it again"
        } else {
            ""
        };
        let said: String = said.chars().take(300).collect();
        return Err(not_a_video(format!("ffprobe says: {said}{hint}")));
    }
    first_stream(&output.stdout).map_err(not_a_video)
}

/// The first stream in `ffprobe`'s answer.
fn first_stream(answer: &[u8]) -> Result<Stream, String> {
    let probe: Probe = serde_json::from_slice(answer)
        .map_err(|e| format!("ffprobe's answer was not understood: {e}"))?;
    let first = probe.streams.into_iter().next();
    first.ok_or_else(|| "the file has no video in it".to_owned())
}

/// Width and height in pixels, and frames a second where they are stated, of a
/// video by `ffprobe`'s answer in JSON.
///
/// # Errors
///
/// Why it was not understood.
pub fn parse_probe(answer: &[u8]) -> Result<(u64, u64, Option<f64>), String> {
    let stream = first_stream(answer)?;
    Ok((stream.width, stream.height, frame_rate(&stream)))
}

fn start_error(program: &'static str, source: std::io::Error) -> EvaluateError {
    match source.kind() {
        ErrorKind::NotFound => EvaluateError::NoFfmpeg(program),
        _ => EvaluateError::RunFfmpeg { program, source },
    }
}

/// A path that `ffmpeg` cannot take for an option, a device or a network address.
fn file_url(path: &Path) -> OsString {
    let mut url = OsString::from("file:");
    url.push(path);
    url
}

/// `ffmpeg` repeats and drops frames to a constant rate unless told not to; the
/// option's name changed with 5.1.
fn keep_every_frame() -> [&'static str; 2] {
    let version = Command::new("ffmpeg")
        .arg("-version")
        .stdin(Stdio::null())
        .output()
        .map(|o| String::from_utf8_lossy(&o.stdout).into_owned())
        .unwrap_or_default();
    if is_before_5_1(&version) {
        ["-vsync", "passthrough"]
    } else {
        ["-fps_mode", "passthrough"]
    }
}

fn is_before_5_1(version: &str) -> bool {
    let word = version.split_whitespace().nth(2).unwrap_or_default();
    let mut numbers = word
        .trim_start_matches('n')
        .split(|c: char| !c.is_ascii_digit())
        .map(str::parse::<u32>);
    match (numbers.next(), numbers.next()) {
        (Some(Ok(major)), Some(Ok(minor))) => (major, minor) < (5, 1),
        (Some(Ok(major)), _) => major < 5,
        // Development snapshots are named by date or revision.
        _ => false,
    }
}

fn frame_rate(stream: &Stream) -> Option<f64> {
    let sane = |rate: f64| (rate.is_finite() && rate > 0.1 && rate < 10_000.0).then_some(rate);
    let said = stream
        .avg_frame_rate
        .split_once('/')
        .and_then(|(n, d)| Some(n.parse::<f64>().ok()? / d.parse::<f64>().ok()?))
        .and_then(sane);
    said.or_else(|| {
        let frames: f64 = stream.nb_frames.parse().ok()?;
        let seconds: f64 = stream.duration.parse().ok()?;
        sane(frames / seconds)
    })
}

/// Reads everything, so that the decoder never waits, and keeps the beginning.
fn keep_start(mut pipe: impl Read) -> String {
    let mut kept = Vec::new();
    let mut buffer = [0u8; 1024];
    loop {
        match pipe.read(&mut buffer) {
            Ok(0) => break,
            Ok(n) => {
                let room = KEPT_MESSAGES.saturating_sub(kept.len()).min(n);
                kept.extend_from_slice(buffer.get(..room).unwrap_or_default());
            }
            Err(e) if e.kind() == ErrorKind::Interrupted => {}
            Err(_) => break,
        }
    }
    String::from_utf8_lossy(&kept).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_of_ffmpeg() {
        assert!(is_before_5_1(
            "ffmpeg version 4.4.2-0ubuntu0.22.04.1 Copyright"
        ));
        assert!(is_before_5_1("ffmpeg version 5.0 Copyright"));
        assert!(!is_before_5_1("ffmpeg version 5.1.9-0+deb12u1 Copyright"));
        assert!(!is_before_5_1("ffmpeg version n7.0.1 Copyright"));
        assert!(!is_before_5_1("ffmpeg version N-113007-g8d24a28d06 C"));
        assert!(!is_before_5_1("ffmpeg version 8 Copyright"));
        assert!(!is_before_5_1(""));
    }

    #[test]
    fn frame_rates_of_metadata() {
        let stream = |rate: &str, frames: &str, seconds: &str| Stream {
            avg_frame_rate: rate.to_owned(),
            nb_frames: frames.to_owned(),
            duration: seconds.to_owned(),
            ..Stream::default()
        };
        assert_eq!(frame_rate(&stream("30/1", "", "")), Some(30.0));
        assert_eq!(frame_rate(&stream("0/0", "60", "2.0")), Some(30.0));
        assert_eq!(frame_rate(&stream("0/0", "", "")), None);
        assert_eq!(frame_rate(&stream("1/0", "5", "0")), None);
        assert_eq!(frame_rate(&stream("-30/1", "N/A", "1")), None);
    }
}
