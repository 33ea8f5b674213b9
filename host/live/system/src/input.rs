//! Files that are read, with holes.
//!
//! Sparse files: [`Sparse::next_data`] returns the position of the next bytes that were ever
//! written. A search goes on from there, so a file with a terabyte of holes takes no time.

use std::fs::File;
use std::io::{self, BufReader, Cursor, ErrorKind, Read, Seek, SeekFrom};
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};

use crate::monitor::{ReadMonitor, ReadProgress};

/// Opens a regular file for reading.
///
/// # Errors
///
/// The file does not exist or may not be read, or `path` is a folder, a pipe or a device. A pipe
/// may wait for ever, and a device may never end.
pub fn open(path: &Path, monitor: &ReadMonitor) -> io::Result<Input> {
    let kind = std::fs::metadata(path)?.file_type();
    if kind.is_dir() {
        return Err(ErrorKind::IsADirectory.into());
    }
    if !kind.is_file() {
        let reason = "it is a pipe or a device; expected a file";
        return Err(io::Error::new(ErrorKind::InvalidInput, reason));
    }
    let file = File::open(path)?;
    Ok(Input {
        length: file.metadata()?.len(),
        file,
        path: path.to_owned(),
        monitor: monitor.clone(),
        position: 0,
        skips_holes: false,
    })
}

/// Reads a whole text of at most `most` bytes.
///
/// # Errors
///
/// As [`open`]; or the file cannot be read, is longer, or is not UTF-8
/// ([`ErrorKind::InvalidData`]).
pub fn read_text(path: &Path, most: u64) -> io::Result<String> {
    let mut text = String::new();
    let input = open(path, &ReadMonitor::default())?;
    let read = input.take(most + 1).read_to_string(&mut text)? as u64;
    if read > most {
        let reason = format!("it is longer than {most} bytes, the most that such a file can have");
        return Err(io::Error::new(ErrorKind::InvalidData, reason));
    }
    Ok(text)
}

/// A file that is read. Its [`ReadMonitor`] sees each read.
#[derive(Debug)]
pub struct Input {
    file: File,
    path: PathBuf,
    monitor: ReadMonitor,
    position: u64,
    length: u64,
    skips_holes: bool,
}

impl Input {
    /// Returns the file's length at its opening in bytes.
    #[must_use]
    pub const fn length(&self) -> u64 {
        self.length
    }

    /// Leaves out the holes: for texts, where positions do not matter.
    #[must_use]
    pub fn skipping_holes(self) -> Self {
        Self {
            skips_holes: true,
            ..self
        }
    }

    /// Counts the bytes that were ever written, which are those outside of holes. Stops counting
    /// at `most`.
    ///
    /// # Errors
    ///
    /// The system does not report it, or reads are cancelled.
    pub fn written(&mut self, most: u64) -> io::Result<u64> {
        let (mut at, mut written) = (0, 0);
        while at < self.length && written < most {
            self.check()?;
            let data = self.next_data(at)?;
            let hole = rustix::fs::seek(&self.file, rustix::fs::SeekFrom::Hole(data));
            at = hole.unwrap_or(self.length).max(data);
            written += at - data;
        }
        Ok(written)
    }

    fn check(&self) -> io::Result<()> {
        self.monitor.check(&ReadProgress {
            path: &self.path,
            position: self.position,
            length: self.length,
        })
    }
}

impl Read for Input {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.check()?;
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

/// A reader that knows where its file has holes.
pub trait Sparse: Read + Seek {
    /// Returns the first position at or after `from` that was ever written, or the end if there
    /// is none. The position of the next read stays as it was.
    ///
    /// # Errors
    ///
    /// Reads are cancelled.
    fn next_data(&mut self, from: u64) -> io::Result<u64>;
}

impl Sparse for Input {
    fn next_data(&mut self, from: u64) -> io::Result<u64> {
        use rustix::fs::SeekFrom::Data;
        self.check()?;
        // Reads are at given positions, so the file's own may move.
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
    use std::sync::Arc;
    use std::sync::atomic::{AtomicU64, Ordering};

    use super::*;
    use crate::monitor::{Cancel, is_cancelled};

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
        let mut input = open(&path, &ReadMonitor::default()).unwrap();
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
    fn a_monitor_sees_and_ends_a_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::fs::write(&path, [7; 100]).unwrap();
        let last = Arc::new(AtomicU64::new(0));
        let (seen, own) = (Arc::clone(&last), path.clone());
        let cancel = Cancel::when(move || last.load(Ordering::Relaxed) >= 50);
        let monitor = ReadMonitor::new(cancel, move |progress| {
            assert_eq!((progress.path, progress.length), (own.as_path(), 100));
            seen.store(progress.position, Ordering::Relaxed);
        });
        let mut input = open(&path, &monitor).unwrap();
        input.read_exact(&mut [0; 60]).unwrap();
        let error = input.read(&mut [0; 60]).unwrap_err();
        assert!(is_cancelled(&error), "{error}");
        let mut other = open(&path, &ReadMonitor::default()).unwrap();
        assert_eq!(other.read(&mut [0; 160]).unwrap(), 100);
    }
}
