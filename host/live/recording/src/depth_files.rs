//! The depth recordings in the folder of a recording: MKV files of the Azure Kinect's recorder,
//! and folders of ROS 2 bags.

use std::io;
use std::path::{Path, PathBuf};

use super::{bag, folder};

/// Returns true if the name of a path ends in `.mkv`, as the files of the Azure Kinect's
/// recorder do.
#[must_use]
pub fn is_mkv(path: &Path) -> bool {
    let ending = path.extension();
    ending.is_some_and(|ending| ending.eq_ignore_ascii_case("mkv"))
}

/// Returns the depth recordings in a recording's folder, sorted by name.
///
/// # Errors
///
/// Returns an error if the folder cannot be read.
pub fn depth_recordings(folder: &Path) -> io::Result<Vec<PathBuf>> {
    folder::entries(folder, |path| {
        if path.is_dir() {
            bag::is_bag(path)
        } else {
            is_mkv(path) && path.is_file()
        }
    })
}

/// Returns the size of a depth recording in bytes: of the file, or of all files in a bag's
/// folder.
///
/// # Errors
///
/// Returns an error if it cannot be read.
pub fn bytes_of(path: &Path) -> io::Result<u64> {
    if !path.is_dir() {
        return Ok(path.metadata()?.len());
    }
    let lengths = std::fs::read_dir(path)?.map(|entry| Ok(entry?.metadata()?.len()));
    lengths.sum()
}
