//! Contents of a finished data set: size and checksum of each of its files, in `contents.json`.
//!
//! Tables and images do not show by themselves that rows or files are missing. The pages that are drawn
//! again ([`PAGE`]) are left out, and what begins with a point.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::{fs, io};

use rayon::prelude::*;
use recording::contents::FileContents;
use recording::folder::entries;
use serde::Serialize;
use system::ReadMonitor;

use super::whole_file::PARTIAL;

/// Name of the file, in the output folder.
pub(crate) const FILE: &str = "contents.json";

/// The page over a data set.
const PAGE: &str = "report.html";

/// Version of the file's form.
const VERSION: u32 = 1;

/// Content of the file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct DataSetContents {
    version: u32,
    /// Files by their paths in the output folder, with forward slashes.
    pub(crate) files: BTreeMap<String, FileContents>,
}

/// Reads all files of a data set that is finished, and removes those that a killed run left unfinished.
///
/// # Errors
///
/// Fails if a file cannot be read or removed, or reads are cancelled.
pub(crate) fn of(out: &Path, monitor: &ReadMonitor) -> io::Result<DataSetContents> {
    let mut paths = Vec::new();
    collect(out, &mut paths)?;
    let read = |path: &PathBuf| {
        let name = path.strip_prefix(out).unwrap_or(path);
        let name = name.to_string_lossy().into_owned();
        Ok((name, FileContents::read(path, monitor)?))
    };
    let files: io::Result<BTreeMap<_, _>> = paths.par_iter().map(read).collect();
    let mut files = files?;
    for own in [FILE, PAGE] {
        files.remove(own);
    }
    Ok(DataSetContents {
        version: VERSION,
        files,
    })
}

/// Collects the files of a folder and of those in it.
fn collect(folder: &Path, paths: &mut Vec<PathBuf>) -> io::Result<()> {
    let is_shown = |path: &Path| {
        let name = path.file_name().unwrap_or_default();
        !name.to_string_lossy().starts_with('.')
    };
    for path in entries(folder, is_shown)? {
        if path.is_dir() {
            collect(&path, paths)?;
        } else if path.extension().is_some_and(|end| end == PARTIAL) {
            fs::remove_file(&path)?;
        } else {
            paths.push(path);
        }
    }
    Ok(())
}
