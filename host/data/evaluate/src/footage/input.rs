//! The video of a recording, and the alignment in its `session.json`.

use std::path::{Path, PathBuf};

use phone::adb::get_files_command;
use phone::file_name::VIDEO_ENDINGS;
use recording::SESSION_FILE;
use recording::depth_files::is_mkv;
use recording::folder::entries;
use recording::session_file::SessionFile;
use system::ReadMonitor;

use super::trigger::Trigger;
use crate::{EvaluateError, KnownReadout};

/// Alignment of a recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Applied {
    /// Bias that was subtracted: the constant one and the intended shift, µs.
    pub bias_us: f64,
    /// The intended shift alone, µs.
    pub shift_us: f64,
    /// 1-sigma of the session's clocks, µs: each launch is off by an error of its own.
    pub clocks_sigma_us: f64,
    /// Exposure of a row as the phone reported it, µs.
    pub exposure_us: f64,
    /// Readout of the profile with which it was recorded.
    pub readout: KnownReadout,
}

/// The video that an input (a video, or the folder of a recording) stands for.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Input {
    pub path: PathBuf,
    /// Alignment of the recording, if the input belongs to one.
    pub applied: Option<Applied>,
    /// The board's pulses, if the recording has them.
    pub trigger: Option<Trigger>,
}

/// Finds the video of a recording's folder, and the session of a video in one.
pub(crate) fn resolve(path: &Path, monitor: &ReadMonitor) -> Result<Input, EvaluateError> {
    let is_folder = std::fs::metadata(path)
        .map_err(EvaluateError::io(path))?
        .is_dir();
    let folder = if is_folder { Some(path) } else { path.parent() };
    let session = folder.filter(|folder| folder.join(SESSION_FILE).is_file());
    let session = session.map(SessionFile::load).transpose()?;
    let trigger = folder.zip(session.as_ref());
    let trigger = trigger.map(|(folder, session)| Trigger::read(folder, session, monitor));
    let reference = |session: &SessionFile| session.phone_folder(&session.profile.phone.name);
    Ok(Input {
        path: if is_folder {
            let place = path.join(session.as_ref().map_or_else(PathBuf::new, reference));
            video_in(&place).map_err(|found| EvaluateError::NoVideo {
                copy: session.as_ref().and_then(|session| {
                    let phase = session.reference()?.video?.phase;
                    Some(get_files_command(phase, &place, true))
                }),
                folder: place,
                found,
            })?
        } else {
            path.to_owned()
        },
        applied: session.and_then(|session| {
            let alignment = session.alignment?;
            Some(Applied {
                bias_us: alignment.bias_us + alignment.shift_us,
                shift_us: alignment.shift_us,
                clocks_sigma_us: alignment.clocks_sigma_us(),
                exposure_us: alignment.exposure_us,
                readout: KnownReadout::of_phone(&session.profile.phone),
            })
        }),
        trigger: trigger.transpose()?.flatten(),
    })
}

/// Returns the one video in a folder, or what is there instead.
fn video_in(folder: &Path) -> Result<PathBuf, String> {
    let is_video = |file: &Path| {
        let ending = file.extension().and_then(|e| e.to_str()).unwrap_or("");
        VIDEO_ENDINGS.contains(&ending.to_ascii_lowercase().as_str()) && file.is_file()
    };
    let mut videos = entries(folder, is_video).map_err(|error| error.to_string())?;
    if videos.len() > 1 {
        // The depth recorder's own file is not the phone's.
        videos.retain(|video| !is_mkv(video));
    }
    match (videos.pop(), videos.len()) {
        (Some(video), 0) => Ok(video),
        (Some(_), _) => Err(String::from("more than one video in this folder")),
        (None, _) => Err(String::from("no video in this folder")),
    }
}

#[cfg(test)]
mod tests {
    use recording::profile::{Phone, Profile};
    use recording::session_file::Alignment;

    use super::*;

    fn resolve(path: &Path) -> Result<Input, EvaluateError> {
        super::resolve(path, &ReadMonitor::default())
    }

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
                shift_us: 0.0,
                clocks_sigma_us: session.alignment.unwrap().clocks_sigma_us(),
                exposure_us: 500.0,
                readout: KnownReadout::of_phone(&session.profile.phone),
            }),
            trigger: None,
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

    #[test]
    fn the_video_is_that_of_the_phone_to_which_the_trigger_was_aligned() {
        let dir = tempfile::tempdir().unwrap();
        let mut profile = Profile::published().unwrap();
        profile.phones.push(Phone {
            name: String::from("other"),
            ..profile.phone.clone()
        });
        let session = SessionFile::new(String::from("walk"), profile);
        session.save(dir.path()).unwrap();
        let video = |name: &str| dir.path().join(session.phone_folder(name)).join("VID.MOV");
        for name in ["other", &session.profile.phone.name] {
            assert!(resolve(dir.path()).is_err());
            std::fs::create_dir_all(video(name).parent().unwrap()).unwrap();
            std::fs::write(video(name), "").unwrap();
        }
        let found = resolve(dir.path()).unwrap().path;
        assert_eq!(found, video(&session.profile.phone.name));

        // Without a session, the folders of phones are not searched.
        std::fs::remove_file(dir.path().join(SESSION_FILE)).unwrap();
        let e = resolve(dir.path()).unwrap_err().to_string();
        assert!(e.contains("no video"), "{e}");
    }
}
