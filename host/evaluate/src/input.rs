//! Fields of a recording's `session.json` that help the evaluation.
//!
//! Only the few fields that are needed are read, so that a recording of another
//! version of the program can still be evaluated.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::EvaluateError;
use recording::SESSION_FILE;
use recording::session_file::MAX_LENGTH;

/// Endings of the videos that phones make.
const VIDEO_ENDINGS: [&str; 4] = ["mp4", "mkv", "mov", "webm"];

/// Alignment of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Applied {
    /// The constant bias that was subtracted, µs.
    pub bias_us: f64,
    /// Exposure of a row as the phone reported it, µs.
    pub exposure_us: f64,
}

#[derive(Deserialize)]
struct SessionPart {
    alignment: Option<Applied>,
}

/// An input made definite: a recording's folder stands for its video.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Input {
    /// Video, folder of images, or image.
    pub path: PathBuf,
    /// Alignment of the recording, if the input belongs to one.
    pub applied: Option<Applied>,
}

/// Finds the video of a recording's folder, and the session of a video in one.
pub(crate) fn resolve(path: &Path) -> Result<Input, EvaluateError> {
    let own = path.join(SESSION_FILE);
    if path.is_dir() && own.is_file() {
        return Ok(Input {
            path: video_in(path)?,
            applied: read(&own)?,
        });
    }
    let beside = path.parent().map(|p| p.join(SESSION_FILE));
    let applied = match beside.filter(|f| f.is_file()) {
        Some(file) => read(&file)?,
        None => None,
    };
    Ok(Input {
        path: path.to_owned(),
        applied,
    })
}

fn read(file: &Path) -> Result<Option<Applied>, EvaluateError> {
    let text = files::read_text(file, MAX_LENGTH).map_err(EvaluateError::io(file))?;
    let part: SessionPart = serde_json::from_str(&text).map_err(|e| EvaluateError::Profile {
        path: file.to_owned(),
        message: format!("the recording's session was not understood: {e}"),
    })?;
    Ok(part
        .alignment
        .filter(|a| a.bias_us.is_finite() && a.exposure_us.is_finite()))
}

fn video_in(folder: &Path) -> Result<PathBuf, EvaluateError> {
    let io = EvaluateError::io(folder);
    let mut videos = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let file = entry.map_err(io)?.path();
        let ending = file.extension().and_then(|e| e.to_str()).unwrap_or("");
        // The depth recorder's own file is not the phone's.
        if VIDEO_ENDINGS.contains(&ending.to_ascii_lowercase().as_str()) && file.is_file() {
            videos.push(file);
        }
    }
    if videos.len() > 1 {
        videos.retain(|v| v.extension().is_some_and(|e| e != "mkv"));
    }
    match (videos.pop(), videos.len()) {
        (Some(video), 0) => Ok(video),
        (video, _) => Err(EvaluateError::Setting(format!(
            "{}: {} in this recording; give the phone's video itself",
            folder.display(),
            if video.is_some() {
                "more than one video"
            } else {
                "no video"
            }
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_stands_for_its_video() {
        let dir = tempfile::tempdir().unwrap();
        let path = |name: &str| dir.path().join(name);
        assert_eq!(resolve(dir.path()).unwrap().applied, None);
        std::fs::write(
            path(SESSION_FILE),
            r#"{"name": "x", "alignment": {"bias_us": -3.5, "exposure_us": 500, "other": 1}}"#,
        )
        .unwrap();
        let e = resolve(dir.path()).unwrap_err().to_string();
        assert!(e.contains("no video"), "{e}");
        std::fs::write(path("VID_1.mp4"), "").unwrap();
        let expected = Input {
            path: path("VID_1.mp4"),
            applied: Some(Applied {
                bias_us: -3.5,
                exposure_us: 500.0,
            }),
        };
        assert_eq!(resolve(dir.path()).unwrap(), expected);
        assert_eq!(resolve(&path("VID_1.mp4")).unwrap(), expected);
        // The depth recorder's file beside it changes nothing; a second video does.
        std::fs::write(path("depth.mkv"), "").unwrap();
        assert_eq!(resolve(dir.path()).unwrap(), expected);
        std::fs::write(path("VID_2.mp4"), "").unwrap();
        let e = resolve(dir.path()).unwrap_err().to_string();
        assert!(e.contains("more than one video"), "{e}");

        std::fs::write(path(SESSION_FILE), "{}").unwrap();
        assert_eq!(resolve(&path("VID_1.mp4")).unwrap().applied, None);
        std::fs::write(path(SESSION_FILE), "{").unwrap();
        assert!(resolve(&path("VID_1.mp4")).is_err());
    }
}
