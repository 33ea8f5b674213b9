//! The folder of a recording: creation under a readable name that never overwrites, and its
//! entries.

use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use super::RecordingError;

/// Most names that are tried.
const TRIES: u32 = 1_000;

/// Creates a new folder in `parent`, which is created too, and returns its path.
///
/// If `name` exists already, `_2`, `_3`, … is appended. The creation of the folder claims the
/// name, so two programs never get the same one.
///
/// # Errors
///
/// Returns an error if no folder can be created there.
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

/// Returns the entries of a folder that `matches` selects, sorted by name.
///
/// # Errors
///
/// Returns an error if the folder cannot be read.
pub fn entries(folder: &Path, matches: impl Fn(&Path) -> bool) -> io::Result<Vec<PathBuf>> {
    let paths = std::fs::read_dir(folder)?.map(|entry| Ok(entry?.path()));
    let mut found = paths.collect::<io::Result<Vec<PathBuf>>>()?;
    found.retain(|path| matches(path));
    found.sort();
    Ok(found)
}

/// Checks that a name given by a user is a single component of a path, and returns it.
///
/// # Errors
///
/// Returns a sentence on the expected form if the name is empty, begins with a dot, is longer
/// than 200 bytes, or has a character that does not belong in the name of a file.
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
