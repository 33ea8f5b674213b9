//! Properties of videos, by `ffprobe`.

use std::path::Path;
use std::process::Command;

use serde::Deserialize;
use system::{Output, ReadMonitor};

use super::{MAX_SIDE, VideoError, failed, file_url, limits, program};

/// Most bytes of an answer: times of five million frames.
const MAX_ANSWER: usize = 64 << 20;
/// Least bytes of a coded frame: encoders take a few dozen for a frame in which nothing changes.
const LEAST_FRAME: u64 = 8;
/// Frames that are accepted besides.
const FEW_FRAMES: u64 = 100;
/// Pixels of a picture that need no file of some length: ffmpeg takes 26 bytes for each (measured with version
/// 5.1 and two processors).
const FEW_PIXELS: u64 = 3 << 22;
/// Most pixels of a larger picture for each byte of the file: a second of 8K takes more bytes than that.
const PIXELS_A_BYTE: u64 = 8;
/// Most bytes of an answer besides those for each byte of a small file.
const SMALL_ANSWER: u64 = 64 << 10;
/// Bytes of a video that may be holes. A larger part may be holes only up to half of the file.
const MAX_MISSING: u64 = 64 << 20;

/// Properties that a file states about its first video.
#[derive(Clone, Debug, PartialEq)]
pub struct Info {
    /// Width in pixels, 1 to [`MAX_SIDE`].
    pub width: u32,
    /// Height in pixels, 1 to [`MAX_SIDE`].
    pub height: u32,
    /// Number of frames, if stated.
    pub frames: Option<u64>,
    /// Mean number of frames per second, if stated.
    pub rate: Option<f64>,
    /// Length of the file in bytes.
    pub bytes: u64,
    /// True if black is 0 and white 255; false if they are 16 and 235.
    pub full_range: bool,
    /// ffmpeg's name of the pixel format.
    pixel_format: String,
}

impl Info {
    /// Returns true if the luma is one plane of several.
    pub(crate) fn has_planes(&self) -> bool {
        has_luma(&self.pixel_format) && !self.pixel_format.starts_with("gray")
    }
}

#[derive(Default, Deserialize)]
struct Answer {
    #[serde(default)]
    streams: Vec<Stream>,
}

#[derive(Default, Deserialize)]
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

/// Returns the properties of the first video in a file, by `ffprobe`.
///
/// # Errors
///
/// `ffprobe` is missing or cannot be run, the read is cancelled, or the file has no video with
/// sides up to [`MAX_SIDE`].
pub fn probe(path: &Path, monitor: &ReadMonitor) -> Result<Info, VideoError> {
    let bytes = check_written(path, monitor)?;
    let mut command = program("ffprobe");
    command
        .args(["-select_streams", "v:0", "-of", "json", "-show_entries"])
        .arg("stream=width,height,pix_fmt,color_range,avg_frame_rate,nb_frames,duration");
    let answer = ask(&mut command, path, monitor)?;
    if answer.status.success() {
        let info = parse_probe(&answer.stdout)?;
        let Info { width, height, .. } = info;
        let most = FEW_PIXELS.max(bytes.saturating_mul(PIXELS_A_BYTE));
        if u64::from(width) * u64::from(height) > most {
            return Err(VideoError::NotAVideo(format!(
                "it states pictures of {width}x{height} pixels, which {bytes} bytes cannot hold"
            )));
        }
        let most = bytes / LEAST_FRAME + FEW_FRAMES;
        return match info.frames.filter(|frames| *frames > most) {
            Some(frames) => Err(VideoError::NotAVideo(format!(
                "it states {frames} frames, which {bytes} bytes cannot hold"
            ))),
            None => Ok(Info { bytes, ..info }),
        };
    }
    let said = answer.messages.lines().next().unwrap_or("no reason given");
    let hint = if said.contains("moov atom not found") {
        "; the file is truncated: the camera writes its index at the end. Copy it again"
    } else if said.contains("not on whitelist") {
        "; expected a file that holds its frames itself (mp4, mov, mkv, webm, avi, ts), and no \
         playlist, which would read other files"
    } else {
        ""
    };
    let said: String = said.chars().take(300).collect();
    Err(VideoError::NotAVideo(format!("ffprobe says: {said}{hint}")))
}

/// Returns the length of a file in bytes. Refuses one with large holes: ffmpeg would read through
/// a terabyte of them.
fn check_written(path: &Path, monitor: &ReadMonitor) -> Result<u64, VideoError> {
    let fail = |error: std::io::Error| VideoError::NotAVideo(error.to_string());
    let mut file = system::open(path, monitor).map_err(fail)?;
    let bytes = file.length();
    let least = bytes.saturating_sub(MAX_MISSING.max(bytes / 2));
    let written = file.written(least).map_err(fail)?;
    if written < least {
        return Err(VideoError::NotAVideo(format!(
            "of its {bytes} bytes only {written} were ever written; copy it again"
        )));
    }
    Ok(bytes)
}

/// Runs `ffprobe` on a file.
fn ask(command: &mut Command, path: &Path, monitor: &ReadMonitor) -> Result<Output, VideoError> {
    command.arg("-i").arg(file_url(path));
    // A line of a time takes as many bytes as the smallest frame.
    let length = path.metadata().map_or(u64::MAX, |meta| meta.len());
    let most = length.saturating_mul(2).saturating_add(SMALL_ANSWER);
    let most = usize::try_from(most).unwrap_or(MAX_ANSWER).min(MAX_ANSWER);
    let answer = system::run(command, limits(path, monitor), most);
    answer.map_err(failed("ffprobe"))
}

/// Parses the JSON answer of `ffprobe` for [`probe`].
///
/// # Errors
///
/// The answer is malformed, or states no video with sides up to [`MAX_SIDE`].
pub fn parse_probe(answer: &[u8]) -> Result<Info, VideoError> {
    let answer: Answer = serde_json::from_slice(answer).map_err(|error| {
        VideoError::NotAVideo(format!("ffprobe's answer was not understood: {error}"))
    })?;
    let stream = answer.streams.into_iter().next();
    let stream =
        stream.ok_or_else(|| VideoError::NotAVideo("the file has no video in it".to_owned()))?;
    let side = |pixels| {
        let sides = 1..=MAX_SIDE;
        u32::try_from(pixels).ok().filter(|n| sides.contains(n))
    };
    let (Some(width), Some(height)) = (side(stream.width), side(stream.height)) else {
        return Err(VideoError::Size {
            width: stream.width,
            height: stream.height,
        });
    };
    Ok(Info {
        width,
        height,
        frames: stream.nb_frames.parse().ok().filter(|&frames| frames > 0),
        rate: frame_rate(&stream),
        bytes: u64::MAX,
        full_range: stream.color_range == "pc" || !has_luma(&stream.pix_fmt),
        pixel_format: stream.pix_fmt,
    })
}

fn has_luma(pixel_format: &str) -> bool {
    let formats = ["yuv", "nv", "gray", "p0"];
    formats.iter().any(|name| pixel_format.starts_with(name))
}

fn frame_rate(stream: &Stream) -> Option<f64> {
    let sane = |rate: f64| (rate.is_finite() && rate > 0.1 && rate < 10_000.0).then_some(rate);
    let ratio = |a: &str, b: &str| sane(a.parse::<f64>().ok()? / b.parse::<f64>().ok()?);
    let stated = stream.avg_frame_rate.split_once('/');
    stated
        .and_then(|(frames, seconds)| ratio(frames, seconds))
        .or_else(|| ratio(&stream.nb_frames, &stream.duration))
}

/// Returns the times at which the frames of a video are shown, in nanoseconds from the first, in
/// ascending order. Returns `None` if the file does not state them or `ffprobe` cannot be run.
#[must_use]
pub fn presentation_times(path: &Path, monitor: &ReadMonitor) -> Option<Vec<i64>> {
    check_written(path, monitor).ok()?;
    let mut command = program("ffprobe");
    command
        .args(["-select_streams", "v:0", "-of", "csv=p=0"])
        .args(["-show_entries", "packet=pts:stream=time_base"]);
    let answer = ask(&mut command, path, monitor).ok()?;
    parse_presentation_times(&String::from_utf8_lossy(&answer.stdout))
}

/// Parses the answer of `ffprobe` for [`presentation_times`]: lines of integers, and one line with
/// their unit as a fraction of a second such as `1/90000`. Returns `None` if the unit or the times
/// are missing.
#[must_use]
pub fn parse_presentation_times(text: &str) -> Option<Vec<i64>> {
    let mut base = None;
    let mut times: Vec<i128> = Vec::new();
    for line in text.lines() {
        let line = line.trim().trim_end_matches(',');
        if let Some((num, den)) = line.split_once('/') {
            // With 32 bits each, no product below overflows 128 bits.
            base = Some((
                i128::from(num.parse::<u32>().ok()?),
                i128::from(den.parse::<u32>().ok().filter(|&den| den > 0)?),
            ));
        } else if let Ok(time) = line.parse::<i64>() {
            times.push(time.into());
        }
    }
    let (num, den) = base?;
    // Packets are in decoding order.
    times.sort_unstable();
    let first = *times.first()?;
    let nanos = times
        .into_iter()
        .map(|time| i64::try_from((time - first) * num * 1_000_000_000 / den).ok());
    nanos.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

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

    #[test]
    fn answers_are_parsed_and_files_without_video_refused() {
        let answer = r#"{"streams": [{"width": 1920, "height": 1080, "pix_fmt": "yuv420p",
            "avg_frame_rate": "30000/1001", "nb_frames": "90", "color_range": "tv"}]}"#;
        let info = parse_probe(answer.as_bytes()).unwrap();
        assert_eq!(
            (info.width, info.height, info.frames),
            (1920, 1080, Some(90))
        );
        assert!(!info.full_range && info.has_planes());
        for (answer, words) in [
            (r#"{"streams": []}"#, "no video in it"),
            ("{", "not understood"),
            (r#"{"streams": [{"width": 99999, "height": 8}]}"#, "99999x8"),
            (r#"{"streams": [{"height": 8}]}"#, "0x8"),
        ] {
            let error = parse_probe(answer.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(words), "{answer}: {error}");
        }
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
