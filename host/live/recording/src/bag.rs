//! Finds the one MCAP file of a recording or of a ROS 2 bag.
//!
//! Bags of other forms (ROS 1, sqlite3, several parts, compressed) are refused with the command
//! that converts them: `rosbags-convert` of the Python package `rosbags`.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use super::rosbag2::METADATA_FILE;
use super::{MCAP_FILE, RecordingError, folder};

/// Endings of the files of bags, and their meanings in words.
const FORMS: [(&str, &str); 6] = [
    (".mcap", MCAP),
    (".bag", "a ROS 1 bag"),
    (".bag.active", "a ROS 1 bag that was not closed"),
    (".db3", "a ROS 2 bag in sqlite3"),
    (".mcap.zstd", "a packed ROS 2 bag"),
    (".db3.zstd", "a packed ROS 2 bag"),
];

const MCAP: &str = "an MCAP file";

/// Returns the form of a bag by the name of its file; `None` if it is not a bag.
fn form_of(path: &Path) -> Option<&'static str> {
    let name = path.file_name()?.to_string_lossy().to_ascii_lowercase();
    let forms = FORMS.iter().rev();
    let mut found = forms.filter(|(ending, _)| name.ends_with(ending));
    found.next().map(|&(_, form)| form)
}

/// Returns true if a path may be a bag of a depth camera's driver: a folder that
/// `ros2 bag record` wrote (and not a recording of this program), or a file of such a bag.
#[must_use]
pub fn is_bag(path: &Path) -> bool {
    if path.is_dir() {
        path.join(METADATA_FILE).is_file() && !path.join(MCAP_FILE).is_file()
    } else {
        form_of(path).is_some()
    }
}

/// Returns the MCAP file of a recording's or a bag's folder; a file is returned as it is.
///
/// # Errors
///
/// Returns [`RecordingError::ForeignBag`] for a bag of another form,
/// [`RecordingError::NoRecording`] for anything else, and [`RecordingError::Io`] if the folder
/// cannot be read.
pub fn mcap_in(path: &Path) -> Result<PathBuf, RecordingError> {
    if !path.is_dir() {
        return match form_of(path) {
            Some(form) if form != MCAP => Err(foreign(path, form)),
            // Its first bytes decide, whatever its name.
            _ => Ok(path.to_owned()),
        };
    }
    let own = path.join(MCAP_FILE);
    if own.is_file() {
        return Ok(own);
    }
    let files = folder::entries(path, |file| file.is_file() && form_of(file).is_some());
    let files = files.map_err(RecordingError::io("read", path))?;
    match files.as_slice() {
        [] => Err(RecordingError::NoRecording {
            path: path.to_owned(),
        }),
        [one] if one.extension() == Some(OsStr::new("bag")) => mcap_in(one),
        [one] => match mcap_in(one) {
            // `rosbags-convert` takes the folder, with the types in its metadata.
            Err(RecordingError::ForeignBag { form, .. }) => Err(foreign(path, form)),
            found => found,
        },
        _ => Err(foreign(path, "a bag in several parts")),
    }
}

/// Returns the refusal of a bag of another form.
pub(crate) fn foreign(path: &Path, form: &'static str) -> RecordingError {
    RecordingError::ForeignBag {
        path: path.to_owned(),
        form,
    }
}

/// Returns the command that converts a bag of another form.
pub(crate) fn conversion(path: &Path) -> String {
    let mut to = path.with_extension("").into_os_string();
    to.push("-mcap");
    let [from, to] = [path, Path::new(&to)].map(system::shell_word);
    format!("rosbags-convert --src {from} --dst {to} --dst-storage mcap")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_mcap_file_is_read_and_others_are_refused_with_the_command() {
        let parent = tempfile::tempdir().unwrap();
        for (files, expected) in [
            (
                &["recording.mcap", "a.mcap", "b.db3"][..],
                Ok("recording.mcap"),
            ),
            (&["a.mcap", "metadata.yaml"], Ok("a.mcap")),
            (&["a_0.mcap", "a_1.mcap"], Err("several parts")),
            (&["a.db3"], Err("sqlite3")),
            (&["a.mcap.zstd"], Err("packed")),
            (&["a.bag"], Err("a.bag is a ROS 1 bag")),
            (&["a.csv"], Err("expected a folder with recording.mcap")),
        ] {
            let folder = parent.path().join(files.concat());
            std::fs::create_dir(&folder).unwrap();
            for file in files {
                std::fs::write(folder.join(file), "").unwrap();
            }
            match (mcap_in(&folder), expected) {
                (Ok(found), Ok(expected)) => assert_eq!(found, folder.join(expected)),
                (Err(error), Err(expected)) => {
                    let said = error.to_string();
                    assert!(said.contains(expected), "{said}");
                    let is_bag = matches!(error, RecordingError::ForeignBag { .. });
                    assert_eq!(is_bag, said.contains("rosbags-convert --src"), "{said}");
                }
                (found, _) => panic!("{files:?}: {found:?}"),
            }
        }
        assert_eq!(
            conversion(Path::new("a b/it's.bag")),
            r"rosbags-convert --src 'a b/it'\''s.bag' --dst 'a b/it'\''s-mcap' --dst-storage mcap"
        );
    }
}
