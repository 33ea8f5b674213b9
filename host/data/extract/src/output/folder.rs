//! The output folder: whose it is, and what was already done in it.
//!
//! A hidden folder `.extraction` holds the inputs and options that the output was
//! made from (names, sizes, times of change, no paths), and the outcome of the
//! long steps. A second run on the same inputs goes on where the first stopped; a
//! run on others is refused rather than mixed in.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::output::image::write_whole;

/// Version of what is in the output folder: a new one cannot go on in an old one's.
const VERSION: u32 = 2;
const FOLDER: &str = ".extraction";

/// Why the output folder cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum OutputDirError {
    /// It cannot be read or written.
    #[error("using the output folder {path}: {error}")]
    Io {
        /// Which.
        path: PathBuf,
        /// Why.
        error: io::Error,
    },
    /// It holds something else.
    #[error(
        "the output folder {path} is not empty and holds no extraction; give another with --out"
    )]
    NotEmpty {
        /// Which.
        path: PathBuf,
    },
    /// It holds another extraction.
    #[error("the output folder {path} holds an extraction of other inputs or with other options")]
    Other {
        /// Which.
        path: PathBuf,
    },
    /// The inputs would be written to.
    #[error(
        "the output folder {path} lies in the recording, which is never written to; give another with --out"
    )]
    InInputs {
        /// Which.
        path: PathBuf,
    },
}

/// A file as it was read.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct FileMark {
    name: String,
    size: u64,
    changed_ns: u128,
}

impl FileMark {
    /// Of a file.
    ///
    /// # Errors
    ///
    /// It is not there.
    pub(crate) fn of(path: &Path) -> io::Result<Self> {
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

/// An output folder in use.
#[derive(Debug)]
pub(crate) struct OutputDir {
    /// The folder.
    pub(crate) out: PathBuf,
}

#[derive(Serialize)]
struct Job<'a, T> {
    version: u32,
    files: &'a [FileMark],
    options: T,
}

impl OutputDir {
    /// Takes the folder for an extraction of these files with these options. With
    /// `overwrite`, an extraction of others in it is removed first; nothing else ever is.
    ///
    /// # Errors
    ///
    /// See [`OutputDirError`].
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
        let job = serde_json::to_vec_pretty(&Job {
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
                // What is in it goes, and the folder stays: it may be a link's target.
                for entry in fs::read_dir(out).map_err(fail)? {
                    let path = entry.map_err(fail)?.path();
                    let is_folder = path.symlink_metadata().map_err(fail)?.is_dir();
                    // The mark goes last: a stop on the way leaves an extraction to be replaced.
                    if path.file_name().is_some_and(|name| name == FOLDER) {
                        continue;
                    }
                    match is_folder {
                        true => fs::remove_dir_all(&path),
                        false => fs::remove_file(&path),
                    }
                    .map_err(fail)?;
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

    /// The outcome of a step that an earlier run finished.
    pub(crate) fn done<T: DeserializeOwned>(&self, step: &str) -> Option<T> {
        let text = fs::read(self.step_path(step)).ok()?;
        serde_json::from_slice(&text).ok()
    }

    /// Keeps the outcome of a finished step.
    ///
    /// # Errors
    ///
    /// Writing fails.
    pub(crate) fn keep<T: Serialize>(&self, step: &str, outcome: &T) -> io::Result<()> {
        write_whole(&self.step_path(step), &serde_json::to_vec(outcome)?)
    }

    fn step_path(&self, step: &str) -> PathBuf {
        self.out.join(FOLDER).join(format!("{step}.json"))
    }
}

/// Makes sure that `out` does not lie within the recording's folder.
///
/// # Errors
///
/// It does.
pub(crate) fn check_outside(out: &Path, recording: &Path) -> Result<(), OutputDirError> {
    let Ok(recording) = recording.canonicalize() else {
        return Ok(());
    };
    // The folder itself may not be there yet: its first ancestor that is.
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
    fn a_folder_goes_on_with_its_own_job_only() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        let input = folder.path().join("input");
        fs::write(&input, "x").unwrap();
        let files = [FileMark::of(&input).unwrap()];
        let output = OutputDir::open(&out, &files, 1, false).unwrap();
        assert_eq!(output.done::<u32>("depth"), None);
        output.keep("depth", &7).unwrap();
        assert_eq!(
            OutputDir::open(&out, &files, 1, true)
                .unwrap()
                .done::<u32>("depth"),
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
        // Only a former extraction is replaced, and all of it.
        let taken = OutputDir::open(folder.path(), &files, 1, true);
        assert!(matches!(taken, Err(OutputDirError::NotEmpty { .. })));
        fs::create_dir(out.join("mav0")).unwrap();
        fs::write(out.join("mav0/data.csv"), "old").unwrap();
        let output = OutputDir::open(&out, &files, 2, true).unwrap();
        assert_eq!(output.done::<u32>("depth"), None);
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
