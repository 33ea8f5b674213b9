//! Contents of a closed recording: what a reader must find again.
//!
//! When a session is closed, it writes into `session.json` the number of messages of each topic, the
//! numbers and times of the first and the last, and a checksum over all of them, and size and checksum
//! of each file beside `recording.mcap`. An MCAP file alone cannot show that a part is missing: its own
//! statistics are written again by every program that cuts it.
//!
//! Checksums are CRC-32, as those of MCAP are: they show damage, not forgery.

use std::collections::BTreeMap;
use std::io::{self, Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use crc32fast::Hasher;
use mcap::records::MessageHeader;
use protocol::Ticks;
use serde::{Deserialize, Serialize};
use system::{ReadMonitor, Sparse as _};

use super::{depth_files, folder, ticks_of_nanos};

/// Bytes that are read at a time.
const WINDOW: usize = 1 << 20;

/// Contents of a closed recording.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Contents {
    /// Topics that have messages, by their names.
    pub topics: BTreeMap<String, TopicContents>,
    /// Files besides `recording.mcap`, by their paths relative to the recording; nothing if the user
    /// did not wait for their checksums.
    pub files: Option<BTreeMap<String, FileContents>>,
}

/// Messages of a topic.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TopicContents {
    /// Number of messages.
    pub messages: u64,
    /// Numbers of the first and the last message.
    pub numbers: [u32; 2],
    /// Board times of the first and the last message.
    pub times: [Ticks; 2],
    /// Checksum over numbers, times and contents of all messages, in their order.
    pub checksum: u32,
}

/// Size and checksum of a file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileContents {
    /// Length, bytes.
    pub bytes: u64,
    /// Checksum over the whole file.
    pub checksum: u32,
}

/// Counts messages by topic, as they are written or read.
#[derive(Clone, Debug, Default)]
pub struct Tally(BTreeMap<String, (TopicContents, Hasher)>);

impl Tally {
    /// Adds a message.
    pub(crate) fn add(&mut self, topic: &str, header: &MessageHeader, data: &[u8]) {
        if !self.0.contains_key(topic) {
            self.0.insert(topic.to_owned(), Default::default());
        }
        let Some((contents, hasher)) = self.0.get_mut(topic) else {
            return;
        };
        let (number, at) = (header.sequence, ticks_of_nanos(header.log_time));
        if contents.messages == 0 {
            (contents.numbers[0], contents.times[0]) = (number, at);
        }
        contents.messages += 1;
        (contents.numbers[1], contents.times[1]) = (number, at);
        hasher.update(&number.to_le_bytes());
        hasher.update(&header.log_time.to_le_bytes());
        hasher.update(data);
    }

    /// Returns the contents by topic.
    #[must_use]
    pub fn topics(&self) -> BTreeMap<String, TopicContents> {
        let topics = self.0.iter().map(|(name, (contents, hasher))| {
            let checksum = hasher.clone().finalize();
            let contents = TopicContents {
                checksum,
                ..*contents
            };
            (name.clone(), contents)
        });
        topics.collect()
    }
}

impl FileContents {
    /// Reads a file. Holes count as zeros and take no time.
    ///
    /// # Errors
    ///
    /// Returns an error if the file cannot be read, is no regular file, or reads are cancelled.
    pub fn read(path: &Path, monitor: &ReadMonitor) -> io::Result<Self> {
        let mut file = system::open(path, monitor)?;
        let length = file.length();
        let mut hasher = Hasher::new();
        let mut window = vec![0; WINDOW];
        let mut at = 0;
        while at < length {
            let data = file.next_data(at)?.clamp(at, length);
            hasher.combine(&zeros(data - at));
            file.seek(SeekFrom::Start(data))?;
            let most = usize::try_from(length - data).unwrap_or(WINDOW).min(WINDOW);
            let read = file.read(window.get_mut(..most).unwrap_or_default())?;
            hasher.update(window.get(..read).unwrap_or_default());
            at = data + read as u64;
            if read == 0 && data < length {
                return Err(io::ErrorKind::UnexpectedEof.into());
            }
        }
        Ok(Self {
            bytes: length,
            checksum: hasher.finalize(),
        })
    }
}

/// Returns the checksum over a number of zeros, in as many steps as the number has bits.
fn zeros(mut count: u64) -> Hasher {
    let mut sum = Hasher::new();
    let mut power = Hasher::new();
    power.update(&[0]);
    while count > 0 {
        if count & 1 == 1 {
            sum.combine(&power);
        }
        power.combine(&power.clone());
        count >>= 1;
    }
    sum
}

/// Checksums of files that were read, so that no file is read twice for them.
#[derive(Clone, Debug, Default)]
pub struct FileSums(BTreeMap<PathBuf, FileContents>);

impl FileSums {
    /// Returns size and checksum of a file, which is read at the first call.
    ///
    /// # Errors
    ///
    /// As [`FileContents::read`].
    pub fn of(&mut self, path: &Path, monitor: &ReadMonitor) -> io::Result<FileContents> {
        let path = path.canonicalize()?;
        if let Some(known) = self.0.get(&path) {
            return Ok(*known);
        }
        let found = FileContents::read(&path, monitor)?;
        self.0.insert(path, found);
        Ok(found)
    }
}

/// Returns the files of a recording besides its own three: those that the session names, and those of
/// the depth recorder, as paths relative to the folder.
///
/// # Errors
///
/// Returns an error if a folder cannot be read.
pub fn files_of(recording: &Path, named: &[String]) -> io::Result<Vec<String>> {
    let mut files: Vec<String> = named.to_vec();
    for depth in depth_files::depth_recordings(recording)? {
        let parts = if depth.is_dir() {
            folder::entries(&depth, Path::is_file)?
        } else {
            vec![depth]
        };
        let relative = parts
            .iter()
            .filter_map(|part| part.strip_prefix(recording).ok());
        files.extend(relative.map(|part| part.to_string_lossy().into_owned()));
    }
    files.sort();
    files.dedup();
    Ok(files)
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::FileExt as _;

    use super::*;

    #[test]
    fn holes_have_the_checksum_of_zeros_and_take_no_time() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sparse");
        let file = std::fs::File::create(&path).unwrap();
        file.set_len(3_000_017).unwrap();
        file.write_all_at(b"middle", 1_500_001).unwrap();
        let whole = std::fs::read(&path).unwrap();
        let monitor = ReadMonitor::default();
        let found = FileContents::read(&path, &monitor).unwrap();
        let expected = crc32fast::hash(&whole);
        assert_eq!((found.bytes, found.checksum), (3_000_017, expected));
        file.set_len(1 << 40).unwrap();
        assert_eq!(FileContents::read(&path, &monitor).unwrap().bytes, 1 << 40);
    }
}
