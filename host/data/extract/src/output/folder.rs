//! The output folder: which extraction it belongs to, and which steps are finished.
//!
//! A hidden folder `.extraction` has the inputs and options of the extraction
//! (names, sizes, modification times, no paths), and the outcomes of the
//! long steps. A second run with the same inputs continues where the first stopped; a
//! run with others is refused so that the two do not mix.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::whole_file::write_whole;

/// Version of the output folder's contents; an extraction does not continue in another version's.
const VERSION: u32 = 2;
const FOLDER: &str = ".extraction";

/// Reason why the output folder cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum OutputDirError {
    /// The folder cannot be read or written.
    #[error("using the output folder {path}: {error}")]
    Io {
        /// The folder.
        path: PathBuf,
        /// The reason.
        error: io::Error,
    },
    /// The folder has other contents.
    #[error(
        "the output folder {path} is not empty and holds no extraction; give another with --out"
    )]
    NotEmpty {
        /// The folder.
        path: PathBuf,
    },
    /// The folder has another extraction.
    #[error("the output folder {path} holds an extraction of other inputs or with other options")]
    Other {
        /// The folder.
        path: PathBuf,
    },
    /// The folder is within the recording.
    #[error(
        "the output folder {path} lies in the recording, which is never written to; give another with --out"
    )]
    InInputs {
        /// The folder.
        path: PathBuf,
    },
}

/// Identity of an input file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct FileMark {
    name: String,
    size: u64,
    changed_ns: u128,
}

impl FileMark {
    /// Reads the mark of a file.
    ///
    /// # Errors
    ///
    /// Fails if the file cannot be examined.
    pub(crate) fn read(path: &Path) -> io::Result<Self> {
        let meta = fs::metadata(path)?;
        let changed = meta.modified()?.duration_since(UNIX_EPOCH);
        Ok(Self {
            name: path
                .file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned(),
            size: meta.len(),
            changed_ns: changed.map_or(0, |since| since.as_nanos()),
        })
    }
}

/// Output folder of an extraction.
#[derive(Debug)]
pub(crate) struct OutputDir {
    /// Path of the folder.
    pub(crate) out: PathBuf,
}

/// Content of `job.json`, which identifies an extraction.
#[derive(Serialize)]
struct Identity<'a, T> {
    version: u32,
    files: &'a [FileMark],
    options: T,
}

impl OutputDir {
    /// Opens the folder for an extraction of these files with these options. With
    /// `overwrite`, another extraction in it is removed first, but never anything else.
    ///
    /// # Errors
    ///
    /// Returns an [`OutputDirError`] if the folder cannot be used.
    pub(crate) fn open<T: Serialize>(
        out: &Path,
        files: &[FileMark],
        options: T,
        overwrite: bool,
    ) -> Result<Self, OutputDirError> {
        let fail = |error| OutputDirError::Io {
            path: out.to_owned(),
            error,
        };
        let job = serde_json::to_vec_pretty(&Identity {
            version: VERSION,
            files,
            options,
        })
        .map_err(|error| fail(error.into()))?;
        let mark = out.join(FOLDER).join("job.json");
        fs::create_dir_all(out).map_err(fail)?;
        match fs::read(&mark) {
            Ok(old) if old == job => {}
            Ok(_) if overwrite => {
                // Only the contents are removed: the folder may be the target of a link.
                for entry in fs::read_dir(out).map_err(fail)? {
                    let path = entry.map_err(fail)?.path();
                    let is_folder = path.symlink_metadata().map_err(fail)?.is_dir();
                    // The mark is removed last, so that an interrupted removal can be repeated.
                    if path.file_name().is_some_and(|name| name == FOLDER) {
                        continue;
                    }
                    let removed = if is_folder {
                        fs::remove_dir_all(&path)
                    } else {
                        fs::remove_file(&path)
                    };
                    removed.map_err(fail)?;
                }
                fs::remove_dir_all(out.join(FOLDER)).map_err(fail)?;
                write_whole(&mark, &job).map_err(fail)?;
            }
            Ok(_) => {
                return Err(OutputDirError::Other {
                    path: out.to_owned(),
                });
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                if fs::read_dir(out).map_err(fail)?.next().is_some() {
                    return Err(OutputDirError::NotEmpty {
                        path: out.to_owned(),
                    });
                }
                write_whole(&mark, &job).map_err(fail)?;
            }
            Err(error) => return Err(fail(error)),
        }
        Ok(Self {
            out: out.to_owned(),
        })
    }

    /// Returns the outcome of a step that an earlier run finished.
    pub(crate) fn outcome<T: DeserializeOwned>(&self, step: &str) -> Option<T> {
        let text = fs::read(self.step_path(step)).ok()?;
        serde_json::from_slice(&text).ok()
    }

    /// Stores the outcome of a finished step.
    ///
    /// # Errors
    ///
    /// Fails if the outcome cannot be written.
    pub(crate) fn store<T: Serialize>(&self, step: &str, outcome: &T) -> io::Result<()> {
        write_whole(&self.step_path(step), &serde_json::to_vec(outcome)?)
    }

    fn step_path(&self, step: &str) -> PathBuf {
        self.out.join(FOLDER).join(format!("{step}.json"))
    }
}

/// Checks that `out` is not within the recording's folder.
///
/// # Errors
///
/// Fails if it is.
pub(crate) fn check_outside(out: &Path, recording: &Path) -> Result<(), OutputDirError> {
    let Ok(recording) = recording.canonicalize() else {
        return Ok(());
    };
    // The folder may not exist yet: the first ancestor that exists stands for it.
    let existing = out.ancestors().find_map(|path| {
        let path = if path.as_os_str().is_empty() {
            Path::new(".")
        } else {
            path
        };
        path.canonicalize().ok()
    });
    if recording.is_dir() && existing.is_some_and(|path| path.starts_with(&recording)) {
        return Err(OutputDirError::InInputs {
            path: out.to_owned(),
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_same_extraction_continues_in_a_folder() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        let input = folder.path().join("input");
        fs::write(&input, "x").unwrap();
        let files = [FileMark::read(&input).unwrap()];
        let output = OutputDir::open(&out, &files, 1, false).unwrap();
        assert_eq!(output.outcome::<u32>("depth"), None);
        output.store("depth", &7).unwrap();
        assert_eq!(
            OutputDir::open(&out, &files, 1, true)
                .unwrap()
                .outcome::<u32>("depth"),
            Some(7)
        );
        assert!(matches!(
            OutputDir::open(&out, &files, 2, false),
            Err(OutputDirError::Other { .. })
        ));
        assert!(matches!(
            OutputDir::open(&out, &[], 1, false),
            Err(OutputDirError::Other { .. })
        ));
        // Only an earlier extraction is replaced, and all of it.
        let taken = OutputDir::open(folder.path(), &files, 1, true);
        assert!(matches!(taken, Err(OutputDirError::NotEmpty { .. })));
        fs::create_dir(out.join("mav0")).unwrap();
        fs::write(out.join("mav0/data.csv"), "old").unwrap();
        let output = OutputDir::open(&out, &files, 2, true).unwrap();
        assert_eq!(output.outcome::<u32>("depth"), None);
        assert!(!out.join("mav0").exists());
        assert!(OutputDir::open(&out, &files, 2, false).is_ok());
    }

    #[test]
    fn the_recording_is_never_written_to() {
        let recording = tempfile::tempdir().unwrap();
        let inside = recording.path().join("a/b");
        assert!(check_outside(&inside, recording.path()).is_err());
        assert!(check_outside(recording.path(), recording.path()).is_err());
        let other = tempfile::tempdir().unwrap();
        assert!(check_outside(&other.path().join("x"), recording.path()).is_ok());
    }
}
