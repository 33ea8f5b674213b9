//! The folder of a recording: a readable name that never overwrites, and the depth
//! recordings in it.

use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use super::{RecordingError, bag};

/// How many names are tried.
const TRIES: u32 = 1_000;

/// Makes a new folder in `parent` (which is made too) and returns its path.
///
/// `name` is taken as it is, with `_2`, `_3`, … after it where it exists
/// already; making the folder is what claims the name, so two programs never get
/// the same one.
///
/// # Errors
///
/// No folder can be made there.
pub fn create(parent: &Path, name: &str) -> Result<PathBuf, RecordingError> {
    let failed = |path| RecordingError::io("make the folder", path);
    std::fs::create_dir_all(parent).map_err(failed(parent))?;
    let mut path = parent.join(name);
    for number in 2..=TRIES {
        match std::fs::create_dir(&path) {
            Ok(()) => return Ok(path),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {
                path = parent.join(format!("{name}_{number}"));
            }
            Err(error) => return Err(failed(&path)(error)),
        }
    }
    Err(failed(&path)(ErrorKind::AlreadyExists.into()))
}

/// Whether a path is named as what the recorder of an Azure Kinect writes: `….mkv`.
#[must_use]
pub fn is_mkv(path: &Path) -> bool {
    let ending = path.extension();
    ending.is_some_and(|ending| ending.eq_ignore_ascii_case("mkv"))
}

/// The depth recordings in a recording's folder, by name: MKV files, and folders of ROS 2 bags.
///
/// # Errors
///
/// The folder cannot be read.
pub fn depth_recordings(folder: &Path) -> io::Result<Vec<PathBuf>> {
    entries(folder, |path| match path.is_dir() {
        true => bag::is_bag(path),
        false => is_mkv(path) && path.is_file(),
    })
}

/// What is in a folder and is asked for, by name.
///
/// # Errors
///
/// The folder cannot be read.
pub fn entries(folder: &Path, is_it: impl Fn(&Path) -> bool) -> io::Result<Vec<PathBuf>> {
    let paths = std::fs::read_dir(folder)?.map(|entry| Ok(entry?.path()));
    let mut found = paths.collect::<io::Result<Vec<PathBuf>>>()?;
    found.retain(|path| is_it(path));
    found.sort();
    Ok(found)
}

/// Bytes of a depth recording: of the file, or of all files in a bag's folder.
///
/// # Errors
///
/// It cannot be read.
pub fn bytes_of(path: &Path) -> io::Result<u64> {
    if !path.is_dir() {
        return Ok(path.metadata()?.len());
    }
    let lengths = std::fs::read_dir(path)?.map(|entry| Ok(entry?.metadata()?.len()));
    lengths.sum()
}

/// A name that a user gave, as a single path component.
///
/// # Errors
///
/// It is empty, begins with a dot, or has a character that does not belong into
/// a file's name; the text says so.
pub fn check_name(name: &str) -> Result<String, String> {
    let bad = |c: char| c == '/' || c == '\\' || c.is_control();
    if name.is_empty() || name.starts_with('.') || name.len() > 200 || name.contains(bad) {
        return Err(String::from(
            "expected a name for a folder: up to 200 characters, no slash, no dot first",
        ));
    }
    Ok(name.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_that_is_taken_gets_a_number() {
        let parent = tempfile::tempdir().unwrap();
        let place = parent.path().join("deep/er");
        let first = create(&place, "walk").unwrap();
        let second = create(&place, "walk").unwrap();
        let third = create(&place, "walk").unwrap();
        assert_eq!(first, place.join("walk"));
        assert_eq!(second, place.join("walk_2"));
        assert_eq!(third, place.join("walk_3"));
    }

    #[test]
    fn a_place_that_is_a_file_is_named() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let error = create(file.path(), "walk").unwrap_err();
        assert!(error.to_string().contains("make the folder"), "{error}");
    }

    #[test]
    fn names_stay_in_their_folder() {
        for name in ["", ".", "..", "../x", "a/b", "a\\b", "a\nb"] {
            assert!(check_name(name).is_err(), "{name:?}");
        }
        assert_eq!(
            check_name("Stairs, 2nd floor"),
            Ok(String::from("Stairs, 2nd floor"))
        );
    }
}
