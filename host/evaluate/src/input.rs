//! The video of a recording, and what its `session.json` says about the alignment.

use std::path::{Path, PathBuf};

use phone::video_files::{self, FilesError};
use recording::SESSION_FILE;
use recording::session_file::SessionFile;

use super::EvaluateError;

/// Alignment of a recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Applied {
    /// What was subtracted: the constant bias, and a shift on purpose, µs.
    pub bias_us: f64,
    /// Exposure of a row as the phone reported it, µs.
    pub exposure_us: f64,
}

/// An input made definite: a recording's folder stands for its video.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Input {
    pub path: PathBuf,
    /// Alignment of the recording, if the input belongs to one.
    pub applied: Option<Applied>,
}

/// Finds the video of a recording's folder, and the session of a video in one.
pub(crate) fn resolve(path: &Path) -> Result<Input, EvaluateError> {
    let is_folder = std::fs::metadata(path)
        .map_err(EvaluateError::io(path))?
        .is_dir();
    let folder = if is_folder { Some(path) } else { path.parent() };
    let session = folder.filter(|folder| folder.join(SESSION_FILE).is_file());
    Ok(Input {
        path: if is_folder {
            video_in(path)?
        } else {
            path.to_owned()
        },
        applied: session.map(applied).transpose()?.flatten(),
    })
}

fn applied(folder: &Path) -> Result<Option<Applied>, EvaluateError> {
    let session = SessionFile::load(folder)?;
    Ok(session.alignment.map(|alignment| Applied {
        bias_us: alignment.bias_us + alignment.shift_us,
        exposure_us: alignment.exposure_us,
    }))
}

fn video_in(folder: &Path) -> Result<PathBuf, EvaluateError> {
    let wrong = |found: &str| {
        let folder = folder.display();
        let step = "give the phone's video itself";
        EvaluateError::Setting(format!("{folder}: {found} in this folder; {step}"))
    };
    let files = video_files::find(folder, None).map_err(|error| match error {
        FilesError::Io { path, error } => EvaluateError::io(&path)(error),
        FilesError::Several { .. } => wrong("more than one video"),
    })?;
    let video = files.and_then(|files| files.video);
    video.ok_or_else(|| wrong("no video"))
}

#[cfg(test)]
mod tests {
    use recording::profile::Profile;
    use recording::session_file::Alignment;

    use super::*;

    fn alignment(bias_us: f64, exposure_us: f64) -> Alignment {
        Alignment {
            bias_us,
            exposure_us,
            ..Alignment::default()
        }
    }

    #[test]
    fn a_recording_stands_for_its_video() {
        let dir = tempfile::tempdir().unwrap();
        let path = |name: &str| dir.path().join(name);
        assert!(resolve(dir.path()).is_err());
        let profile = Profile::published().unwrap();
        let mut session = SessionFile::new(String::from("walk"), profile);
        session.alignment = Some(alignment(-3.5, 500.0));
        session.save(dir.path()).unwrap();
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

        session.alignment = None;
        session.save(dir.path()).unwrap();
        assert_eq!(resolve(&path("VID_1.mp4")).unwrap().applied, None);
        std::fs::write(path(SESSION_FILE), "{").unwrap();
        assert!(resolve(&path("VID_1.mp4")).is_err());
    }
}
