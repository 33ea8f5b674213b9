//! Files that are read: the one place where a long reading is seen and ended.
//!
//! Each read of an [`Input`] first asks the watchers of the process ([`watch`]), because what
//! they stand for (a signal, a line on the terminal) is the process's too. So a loop over an
//! input needs no look of its own: its next read fails with an error that [`is_stopped`] knows.
//!
//! Sparse files: [`Sparse::next_data`] tells where the next bytes are that were ever written. A
//! search goes on from there, and a file of a terabyte of holes takes no time.

use std::fs::File;
use std::io::{self, BufReader, Cursor, Read, Seek, SeekFrom};
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};

/// How far a reading is.
#[derive(Clone, Copy, Debug)]
pub struct Reading<'a> {
    /// The file, or what stands for it.
    pub path: &'a Path,
    /// Bytes from its beginning.
    pub position: u64,
    /// Bytes in all; 0 if not known.
    pub length: u64,
}

type Watcher = Arc<dyn Fn(&Reading<'_>) -> bool + Send + Sync>;

static WATCHERS: RwLock<Vec<Watcher>> = RwLock::new(Vec::new());

/// A watcher; it goes when this is dropped.
#[must_use = "a watcher goes when this is dropped"]
pub struct Watching(Watcher);

/// Has `watcher` asked before each read of the process; what it says no to ends with an error.
pub fn watch(watcher: impl Fn(&Reading<'_>) -> bool + Send + Sync + 'static) -> Watching {
    let watcher: Watcher = Arc::new(watcher);
    let mut watchers = WATCHERS.write().unwrap_or_else(PoisonError::into_inner);
    watchers.push(Arc::clone(&watcher));
    Watching(watcher)
}

impl Drop for Watching {
    fn drop(&mut self) {
        let mut watchers = WATCHERS.write().unwrap_or_else(PoisonError::into_inner);
        watchers.retain(|watcher| !Arc::ptr_eq(watcher, &self.0));
    }
}

/// Asks the watchers; for those who wait for input that is no [`Input`], such as a program's.
///
/// # Errors
///
/// A watcher says no.
pub fn look(reading: &Reading<'_>) -> io::Result<()> {
    let watchers = WATCHERS.read().unwrap_or_else(PoisonError::into_inner);
    match watchers.iter().all(|watcher| watcher(reading)) {
        true => Ok(()),
        false => Err(io::Error::other(Stopped)),
    }
}

/// The reading of a path was ended by a watcher, or would be.
#[must_use]
pub fn is_stopped(path: &Path) -> bool {
    let reading = Reading {
        path,
        position: 0,
        length: 0,
    };
    look(&reading).is_err()
}

#[derive(Debug, thiserror::Error)]
#[error("stopped before its end")]
struct Stopped;

/// A file that is read.
#[derive(Debug)]
pub struct Input {
    file: File,
    path: PathBuf,
    position: u64,
    length: u64,
    skips_holes: bool,
}

impl Input {
    pub(crate) fn open(path: &Path) -> io::Result<Self> {
        let file = File::open(path)?;
        Ok(Self {
            length: file.metadata()?.len(),
            file,
            path: path.to_owned(),
            position: 0,
            skips_holes: false,
        })
    }

    /// Bytes of the file when it was opened.
    #[must_use]
    pub const fn length(&self) -> u64 {
        self.length
    }

    /// The same as if there were no holes in it: for texts, of whose bytes nobody asks the
    /// place.
    #[must_use]
    pub fn skipping_holes(self) -> Self {
        Self {
            skips_holes: true,
            ..self
        }
    }

    /// Bytes that were ever written: all but the holes, up to `most`.
    ///
    /// # Errors
    ///
    /// The system does not say, or a watcher says no.
    pub fn written(&mut self, most: u64) -> io::Result<u64> {
        let (mut at, mut written) = (0, 0);
        while at < self.length && written < most {
            look(&self.reading())?;
            let data = self.next_data(at)?;
            let hole = rustix::fs::seek(&self.file, rustix::fs::SeekFrom::Hole(data));
            at = hole.unwrap_or(self.length).max(data);
            written += at - data;
        }
        Ok(written)
    }

    fn reading(&self) -> Reading<'_> {
        Reading {
            path: &self.path,
            position: self.position,
            length: self.length,
        }
    }
}

impl Read for Input {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        look(&self.reading())?;
        if self.skips_holes {
            self.position = self.next_data(self.position)?;
        }
        let read = self.file.read_at(buffer, self.position)?;
        self.position += read as u64;
        Ok(read)
    }
}

impl Seek for Input {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let position = match to {
            SeekFrom::Start(position) => Some(position),
            SeekFrom::End(offset) => self.length.checked_add_signed(offset),
            SeekFrom::Current(offset) => self.position.checked_add_signed(offset),
        };
        self.position = position.ok_or(io::ErrorKind::InvalidInput)?;
        Ok(self.position)
    }
}

/// A reader that knows its holes.
pub trait Sparse: Read + Seek {
    /// The first place at or after `from` that was ever written; the end if there is none. The
    /// next read is where it was.
    ///
    /// # Errors
    ///
    /// A watcher says no.
    fn next_data(&mut self, from: u64) -> io::Result<u64>;
}

impl Sparse for Input {
    fn next_data(&mut self, from: u64) -> io::Result<u64> {
        use rustix::fs::SeekFrom::Data;
        look(&self.reading())?;
        // All reads say their place, so the file's own may move.
        Ok(match rustix::fs::seek(&self.file, Data(from)) {
            Ok(data) => data,
            Err(rustix::io::Errno::NXIO) => self.length.max(from),
            // A file system without holes.
            Err(_) => from,
        })
    }
}

impl<R: Sparse> Sparse for BufReader<R> {
    fn next_data(&mut self, from: u64) -> io::Result<u64> {
        self.get_mut().next_data(from)
    }
}

impl<T: AsRef<[u8]>> Sparse for Cursor<T> {
    fn next_data(&mut self, from: u64) -> io::Result<u64> {
        Ok(from)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use super::*;

    const HOLE: u64 = 1 << 40;

    /// A terabyte of holes with a word at its beginning and one at its end.
    fn sparse(folder: &Path) -> PathBuf {
        let path = folder.join("sparse");
        let mut file = File::create(&path).unwrap();
        file.write_all(b"begin\n").unwrap();
        file.write_at(b"end\n", HOLE).unwrap();
        path
    }

    #[test]
    fn holes_take_no_time() {
        let folder = tempfile::tempdir().unwrap();
        let path = sparse(folder.path());
        let mut input = crate::open(&path).unwrap();
        let data = input.next_data(1 << 20).unwrap();
        assert!(data <= HOLE && HOLE - data < 1 << 20, "{data}");
        assert_eq!(input.next_data(u64::MAX >> 1).unwrap(), u64::MAX >> 1);
        assert!(input.written(u64::MAX).unwrap() < 1 << 21);
        let mut text = String::new();
        let mut lines = BufReader::new(input.skipping_holes());
        lines.read_to_string(&mut text).unwrap();
        let words: Vec<&str> = text.split(['\0', '\n']).filter(|w| !w.is_empty()).collect();
        assert_eq!(words, ["begin", "end"]);
    }

    #[test]
    fn a_watcher_sees_and_ends_a_reading() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::fs::write(&path, [7; 100]).unwrap();
        let own = path.clone();
        let watching = watch(move |reading| {
            reading.path != own || reading.length == 100 && reading.position < 50
        });
        let mut input = crate::open(&path).unwrap();
        input.read_exact(&mut [0; 60]).unwrap();
        let error = input.read(&mut [0; 60]).unwrap_err();
        assert_eq!(error.to_string(), "stopped before its end");
        drop(watching);
        assert_eq!(input.read(&mut [0; 60]).unwrap(), 40);
    }
}
