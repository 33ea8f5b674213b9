//! The messages of a ROS 2 bag of any program, with topic and type.
//!
//! A bag is a file, or a folder of parts that are read one behind the other; its storage is
//! MCAP or sqlite3. What is wanted of the messages is the caller's choice, by the type that
//! the bag states: names of topics are the choice of whoever recorded it.
//!
//! Limits: those of [`chunks`](super::chunks); of sqlite3 a message has 40 MiB at most, and
//! bags whose parts or messages `ros2 bag` has packed (`--compression-mode`) are not read.

mod mcap;
mod sqlite;

use std::collections::{BTreeSet, VecDeque};
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

use super::MCAP_FILE;
use super::rosbag2::METADATA_FILE;

/// What the names of parts end with.
const ENDINGS: [&str; 2] = ["mcap", "db3"];

/// One message.
#[derive(Clone, Copy, Debug)]
pub struct Message<'a> {
    /// Its topic.
    pub topic: &'a str,
    /// Its type, e.g. `sensor_msgs/msg/Imu`; empty if the file does not say.
    pub kind: &'a str,
    /// How it is encoded, e.g. `cdr`.
    pub encoding: &'a str,
    /// Its bytes.
    pub data: &'a [u8],
}

/// What came of a chunk.
#[derive(Debug)]
pub enum Next {
    /// Its messages were given.
    Given,
    /// Some of them are missing, and why; others may follow.
    Damaged(String),
    /// There was none left.
    End,
}

/// The messages of a bag.
pub struct Messages {
    parts: VecDeque<PathBuf>,
    /// The part that is being read, with its name.
    open: Option<(String, Box<dyn Part + Send>)>,
    topics: BTreeSet<String>,
    /// Bytes of the parts that were read to their end.
    before: u64,
}

/// A part of a bag.
trait Part {
    /// Gives the messages of the next chunk to `each`.
    fn next_chunk(&mut self, each: &mut dyn FnMut(Message<'_>)) -> Next;

    /// The topics so far.
    fn topics(&self) -> Vec<String>;

    /// About as many bytes of it were read so far.
    fn position(&self) -> u64;
}

impl Messages {
    /// Begins at the front of a bag: a file, or a folder.
    ///
    /// # Errors
    ///
    /// The folder cannot be read, or has no parts. What is wrong with a part is told when
    /// its turn comes.
    pub fn open(path: &Path) -> io::Result<Self> {
        Ok(Self {
            parts: parts(path)?.into(),
            open: None,
            topics: BTreeSet::new(),
            before: 0,
        })
    }

    /// Gives the messages of the next chunk to `each`.
    pub fn next_chunk(&mut self, mut each: impl FnMut(Message<'_>)) -> Next {
        loop {
            let Some((name, part)) = &mut self.open else {
                let Some(path) = self.parts.pop_front() else {
                    return Next::End;
                };
                let name = path.file_name().unwrap_or_default().to_string_lossy();
                match open_part(&path) {
                    Ok(part) => self.open = Some((name.into_owned(), part)),
                    Err(why) => return Next::Damaged(format!("{name}: {why}")),
                }
                continue;
            };
            match part.next_chunk(&mut each) {
                Next::Given => return Next::Given,
                Next::Damaged(why) => return Next::Damaged(format!("{name}: {why}")),
                Next::End => {
                    self.topics.extend(part.topics());
                    self.before += part.position();
                    self.open = None;
                }
            }
        }
    }

    /// The topics of the parts that were read to their end, with messages or without.
    pub fn topics(&self) -> impl Iterator<Item = &str> {
        self.topics.iter().map(String::as_str)
    }

    /// About as many bytes of the bag were read so far.
    #[must_use]
    pub fn position(&self) -> u64 {
        let open = self.open.as_ref();
        self.before + open.map_or(0, |(_, part)| part.position())
    }
}

fn open_part(path: &Path) -> Result<Box<dyn Part + Send>, String> {
    let mut first = Vec::new();
    let begin = files::open(path).and_then(|file| {
        let length = sqlite::MAGIC.len() as u64;
        file.take(length).read_to_end(&mut first)
    });
    begin.map_err(|error| error.to_string())?;
    if first == sqlite::MAGIC {
        return Ok(Box::new(sqlite::Tables::open(path)?));
    }
    let file = mcap::File::open(path).map_err(|error| error.to_string())?;
    Ok(Box::new(file))
}

/// Whether a path may be such a bag: a folder as `ros2 bag record` leaves it, which is no
/// recording of ours, or one of its parts.
#[must_use]
pub fn is_bag(path: &Path) -> bool {
    match path.is_dir() {
        true => path.join(METADATA_FILE).is_file() && !path.join(MCAP_FILE).is_file(),
        false => has_ending(path),
    }
}

/// Whether a file begins as parts of bags do, by its first bytes.
#[must_use]
pub fn is_part(first: &[u8]) -> bool {
    first.starts_with(::mcap::MAGIC) || first.starts_with(sqlite::MAGIC)
}

fn has_ending(path: &Path) -> bool {
    let ending = path.extension().and_then(|ending| ending.to_str());
    ending.is_some_and(|ending| ENDINGS.contains(&ending))
}

/// The files of a bag in their order.
///
/// # Errors
///
/// The folder cannot be read, or has none.
pub fn parts(path: &Path) -> io::Result<Vec<PathBuf>> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(path)? {
        let path = entry?.path();
        if has_ending(&path) && path.is_file() {
            paths.push(path);
        }
    }
    if paths.is_empty() {
        let what = "no part of a ROS 2 bag is in it; expected files .mcap or .db3 (unpack .zstd)";
        return Err(io::Error::new(io::ErrorKind::NotFound, what));
    }
    // rosbag2 numbers them without leading zeros: `depth_0.mcap`, ..., `depth_10.mcap`.
    paths.sort_by_key(|path| (path.as_os_str().len(), path.clone()));
    Ok(paths)
}

#[cfg(test)]
#[path = "../../../cli/tests/support/sqlite_bag.rs"]
mod sqlite_bag;

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::io::Cursor;

    use ::mcap::records::MessageHeader;

    use super::*;
    use crate::writer;

    /// `ros2 bag record` does without chunks in its preset `fastwrite`: types, topics and
    /// messages stand one behind the other then.
    #[test]
    fn messages_have_topic_and_type_in_chunks_and_without() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bag.mcap");
        for in_chunks in [true, false] {
            let mut bytes = Cursor::new(Vec::new());
            let options = writer::options().use_chunks(in_chunks);
            let mut mcap = options.create(&mut bytes).unwrap();
            let schema = mcap.add_schema("a_msgs/msg/A", "ros2msg", b"").unwrap();
            let channel = mcap.add_channel(schema, "/a", "cdr", &BTreeMap::new());
            let header = MessageHeader {
                channel_id: channel.unwrap(),
                sequence: 0,
                log_time: 1,
                publish_time: 1,
            };
            mcap.write_to_known_channel(&header, &[7, 8]).unwrap();
            mcap.finish().unwrap();
            drop(mcap);
            std::fs::write(&path, bytes.into_inner()).unwrap();

            let mut messages = Messages::open(&path).unwrap();
            let mut found = Vec::new();
            loop {
                let next = messages.next_chunk(|message| {
                    let names = [message.topic, message.kind, message.encoding];
                    found.push((names.map(String::from), message.data.to_vec()));
                });
                if matches!(next, Next::End) {
                    break;
                }
            }
            let names = ["/a", "a_msgs/msg/A", "cdr"].map(String::from);
            assert_eq!(found, [(names, vec![7, 8])], "chunks: {in_chunks}");
            assert_eq!(messages.topics().collect::<Vec<_>>(), ["/a"]);
        }
    }

    /// A bag with its tables changed by `more`.
    fn sqlite(path: &Path, messages: i64, more: &str) {
        let messages = (0..messages).map(|number| (number, vec![number as u8; 40_000]));
        let bag = sqlite_bag::write(path, ("/a", "a_msgs/msg/A"), messages).unwrap();
        bag.execute_batch(more).unwrap();
    }

    /// The first byte of each message, and the damage.
    fn read(path: &Path) -> (Vec<u8>, Vec<String>) {
        let mut messages = Messages::open(path).unwrap();
        let (mut found, mut damage) = (Vec::new(), Vec::new());
        loop {
            let next = messages.next_chunk(|message| {
                if [message.topic, message.kind, message.encoding] == ["/a", "a_msgs/msg/A", "cdr"]
                {
                    found.push(message.data.first().copied().unwrap_or(0));
                }
            });
            match next {
                Next::Given => {}
                Next::Damaged(why) => damage.push(why),
                Next::End => return (found, damage),
            }
            assert!(damage.len() < 100, "{damage:?}");
        }
    }

    #[test]
    fn parts_in_sqlite3_come_one_behind_the_other() {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("a bag, 100 %?#");
        std::fs::create_dir(&bag).unwrap();
        assert!(Messages::open(&bag).is_err());
        // More than a chunk.
        sqlite(&bag.join("x_9.db3"), 200, "");
        let wal = "PRAGMA journal_mode=WAL; UPDATE topics SET name = name";
        sqlite(&bag.join("x_10.db3"), 3, wal);
        let expected: Vec<u8> = (0..200).chain(0..3).collect();
        assert_eq!(read(&bag), (expected.clone(), Vec::new()));
        let left = std::fs::read_dir(&bag).unwrap().count();
        assert_eq!(left, 2, "nothing is written beside the parts");

        // A recorder that was killed.
        std::fs::write(bag.join("x_10.db3-wal"), "pages").unwrap();
        let (found, damage) = read(&bag);
        assert_eq!(found, expected);
        assert!(damage[0].contains("x_10.db3: was not closed"), "{damage:?}");
        // The end of a file is missing; the next one is read.
        let first = bag.join("x_9.db3");
        let bytes = std::fs::read(&first).unwrap();
        std::fs::write(&first, &bytes[..bytes.len() / 2]).unwrap();
        let (found, damage) = read(&bag);
        assert!(found.ends_with(&[0, 1, 2]), "{found:?}");
        assert!(damage[0].contains("x_9.db3"), "{damage:?}");
    }

    #[test]
    fn tables_that_compute_are_no_bag() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.db3");
        let endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) \
            SELECT i AS rowid, 1 AS topic_id, zeroblob(1000) AS data FROM n";
        for more in [
            format!("DROP TABLE messages; CREATE VIEW messages AS {endless}"),
            String::from(
                "DROP TABLE messages; CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, \
                 data AS (zeroblob(id * 1000000))); INSERT INTO messages VALUES (1, 1), (2, 1)",
            ),
            String::from(
                "DROP TABLE messages; CREATE VIRTUAL TABLE messages USING fts5(topic_id, data)",
            ),
            String::from("ALTER TABLE topics RENAME COLUMN type TO kind"),
        ] {
            let _ = std::fs::remove_file(&path);
            sqlite(&path, 1, &more);
            let (found, damage) = read(&path);
            assert!(found.is_empty(), "{more}");
            assert!(damage[0].contains("no ROS 2 bag"), "{more}: {damage:?}");
        }
        // A message of another kind, and one that is longer than any.
        for data in ["NULL", "'text'", "zeroblob(41 << 20)"] {
            std::fs::remove_file(&path).unwrap();
            let put = format!(
                "DROP TABLE messages; CREATE TABLE messages(topic_id, data); \
                INSERT INTO messages VALUES (1, x'07'), (1, {data}), (1, x'08')"
            );
            sqlite(&path, 0, &put);
            let (found, damage) = read(&path);
            assert_eq!(found, [7], "{data}");
            assert!(damage[0].contains("beyond message 1"), "{damage:?}");
        }
    }

    /// Whatever the bytes are, it ends.
    #[test]
    fn changed_bytes_of_a_database_end_in_words() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.db3");
        sqlite(&path, 3, "");
        let whole = std::fs::read(&path).unwrap();
        let mut damaged = 0;
        for at in (16..whole.len()).step_by(53) {
            let mut bytes = whole.clone();
            bytes[at] ^= 0xFF;
            std::fs::write(&path, &bytes).unwrap();
            damaged += usize::from(!read(&path).1.is_empty());
        }
        assert!(damaged > 5, "{damaged}");
    }
}
