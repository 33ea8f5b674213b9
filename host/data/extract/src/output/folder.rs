//! The output folder: which extraction it belongs to, and which steps are finished.
//!
//! A hidden folder `.extraction` has the inputs and options of the extraction (names, sizes and
//! checksums of all files, no paths), and the outcomes of the long steps. A second run with the same
//! inputs continues where the first stopped; a run with others is refused so that the two do not
//! mix. One program at a time writes: it holds a lock of the operating system on a file there, which
//! ends with the program, however that ends.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use recording::contents::{FileContents, FileSums};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::whole_file::write_whole;
use system::ReadMonitor;

/// Version of the output folder's contents; an extraction does not continue in another version's.
const VERSION: u32 = 3;
const FOLDER: &str = ".extraction";
const LOCK: &str = "lock";

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
    /// Another program writes into the folder.
    #[error("another extraction writes into the output folder {path}")]
    Busy {
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
    #[serde(flatten)]
    contents: FileContents,
}

impl FileMark {
    /// Reads the mark of a file.
    ///
    /// # Errors
    ///
    /// Fails if the file cannot be read.
    pub(crate) fn read(
        path: &Path,
        sums: &mut FileSums,
        monitor: &ReadMonitor,
    ) -> io::Result<Self> {
        let name = path.file_name().unwrap_or_default();
        Ok(Self {
            name: name.to_string_lossy().into_owned(),
            contents: sums.of(path, monitor)?,
        })
    }
}

/// Output folder of an extraction.
#[derive(Debug)]
pub(crate) struct OutputDir {
    /// Path of the folder.
    pub(crate) out: PathBuf,
    /// Holds the lock.
    lock: File,
}

impl Drop for OutputDir {
    /// Gives the lock up even where a process that was just started has a copy of the open file.
    fn drop(&mut self) {
        // It ends with the file in any case.
        let _ = self.lock.unlock();
    }
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
        let own = out.join(FOLDER);
        let mark = own.join("job.json");
        fs::create_dir_all(out).map_err(fail)?;
        // An extraction that could not write its mark leaves its own folder alone.
        let is_strange = |path: &Path| path.file_name().is_some_and(|name| name != FOLDER);
        if !mark.exists()
            && entries(out)
                .map_err(fail)?
                .iter()
                .any(|path| is_strange(path))
        {
            return Err(OutputDirError::NotEmpty {
                path: out.to_owned(),
            });
        }
        fs::create_dir_all(&own).map_err(fail)?;
        let lock = lock(&own.join(LOCK)).map_err(fail)?;
        let lock = lock.ok_or_else(|| OutputDirError::Busy {
            path: out.to_owned(),
        })?;
        match fs::read(&mark) {
            Ok(old) if old == job => {}
            Ok(_) if overwrite => {
                // Only the contents are removed: the folder may be the target of a link. The mark is
                // removed last, so that an interrupted removal can be repeated, and the lock never.
                let data = entries(out).map_err(fail)?;
                let data = data.iter().filter(|path| is_strange(path));
                let steps = entries(&own).map_err(fail)?;
                let steps = steps
                    .iter()
                    .filter(|path| **path != mark && !path.ends_with(LOCK));
                data.chain(steps)
                    .try_for_each(|path| remove(path))
                    .map_err(fail)?;
                write_whole(&mark, &job).map_err(fail)?;
            }
            Ok(_) => {
                return Err(OutputDirError::Other {
                    path: out.to_owned(),
                });
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                write_whole(&mark, &job).map_err(fail)?;
            }
            Err(error) => return Err(fail(error)),
        }
        Ok(Self {
            out: out.to_owned(),
            lock,
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

/// Locks a file, which is created; returns `None` if another program holds the lock. A file system
/// without locks is used without.
fn lock(path: &Path) -> io::Result<Option<File>> {
    let file = File::options().create(true).append(true).open(path)?;
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(TryLockError::WouldBlock) => Ok(None),
        Err(TryLockError::Error(error)) if error.kind() == io::ErrorKind::Unsupported => {
            Ok(Some(file))
        }
        Err(TryLockError::Error(error)) => Err(error),
    }
}

/// Returns the entries of a folder.
fn entries(folder: &Path) -> io::Result<Vec<PathBuf>> {
    fs::read_dir(folder)?
        .map(|entry| Ok(entry?.path()))
        .collect()
}

/// Removes a file, or a folder with its contents. A link is removed, not its target.
fn remove(path: &Path) -> io::Result<()> {
    if path.symlink_metadata()?.is_dir() {
        fs::remove_dir_all(path)
    } else {
        fs::remove_file(path)
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

    fn mark(path: &Path) -> FileMark {
        let (mut sums, monitor) = (FileSums::default(), ReadMonitor::default());
        FileMark::read(path, &mut sums, &monitor).unwrap()
    }

    #[test]
    fn only_the_same_extraction_continues_in_a_folder() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        let input = folder.path().join("input");
        fs::write(&input, "x").unwrap();
        let files = [mark(&input)];
        let open = |files: &[FileMark], options: u32, overwrite| {
            OutputDir::open(&out, files, options, overwrite)
        };
        let output = open(&files, 1, false).unwrap();
        assert_eq!(output.outcome::<u32>("depth"), None);
        output.store("depth", &7).unwrap();
        drop(output);
        let outcome = open(&files, 1, true).unwrap().outcome::<u32>("depth");
        assert_eq!(outcome, Some(7));
        let others: [(&[FileMark], u32); 2] = [(&files, 2), (&[], 1)];
        for (files, options) in others {
            let refused = open(files, options, false);
            assert!(matches!(refused, Err(OutputDirError::Other { .. })));
        }
        // Another content of the same length at the same time is another input.
        let changed = input.metadata().unwrap().modified().unwrap();
        fs::write(&input, "y").unwrap();
        fs::File::options()
            .write(true)
            .open(&input)
            .unwrap()
            .set_modified(changed)
            .unwrap();
        let refused = open(&[mark(&input)], 1, false);
        assert!(matches!(refused, Err(OutputDirError::Other { .. })));
        // Only an earlier extraction is replaced, and all of it.
        let taken = OutputDir::open(folder.path(), &files, 1, true);
        assert!(matches!(taken, Err(OutputDirError::NotEmpty { .. })));
        fs::create_dir(out.join("mav0")).unwrap();
        fs::write(out.join("mav0/data.csv"), "old").unwrap();
        let output = open(&files, 2, true).unwrap();
        assert_eq!(output.outcome::<u32>("depth"), None);
        assert!(!out.join("mav0").exists());
        drop(output);
        assert!(open(&files, 2, false).is_ok());
    }

    #[test]
    fn one_program_at_a_time_writes() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        let open = |overwrite| OutputDir::open(&out, &[], 1, overwrite);
        let first = open(false).unwrap();
        for overwrite in [false, true] {
            assert!(matches!(open(overwrite), Err(OutputDirError::Busy { .. })));
        }
        drop(first);
        assert!(open(false).is_ok());
    }

    #[test]
    fn a_folder_whose_mark_could_not_be_written_is_used() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        fs::create_dir_all(out.join(FOLDER)).unwrap();
        fs::write(out.join(FOLDER).join("job.json.partial"), "{").unwrap();
        assert!(OutputDir::open(&out, &[], 1, false).is_ok());
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
