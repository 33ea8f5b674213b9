//! Records of a bag, front to back, one chunk in memory at a time.
//!
//! Damage ends the reading of the chunk it is in; a record whose length leads
//! out of the file ends the bag. Both are noted ([`Bag::damage`]), and what was
//! read before stays valid.

use std::collections::HashMap;
use std::fmt::Display;
use std::io::{self, Read};
use std::sync::Arc;

use recording::chunks::{Budget, FOREIGN_RATIO};

use formats::faults::Faults;

/// The first line of a bag.
pub(super) const MAGIC: &[u8] = b"#ROSBAG V2.0\n";
/// Most bytes of a record's header.
const MAX_HEADER: u32 = 1 << 20;
/// Most bytes of a record, and of a chunk when unpacked: above an uncompressed colour
/// image of 3840x2160.
const MAX_DATA: u64 = 40 << 20;
/// Most connections that are kept, and bytes of a topic or type.
const MAX_CONNECTIONS: usize = 1_000;
const MAX_NAME: usize = 1_000;
/// How much of the name of an unknown compression is told.
const SHOWN_NAME: usize = 16;
/// Most entries in the list of damage.
const MAX_DAMAGE: usize = 1000;

pub(super) const OP_MESSAGE: u8 = 0x02;
pub(super) const OP_BAG: u8 = 0x03;
pub(super) const OP_INDEX: u8 = 0x04;
pub(super) const OP_CHUNK: u8 = 0x05;
pub(super) const OP_CHUNK_INFO: u8 = 0x06;
pub(super) const OP_CONNECTION: u8 = 0x07;

/// Why a bag cannot be read at all.
#[derive(Debug, thiserror::Error)]
pub enum BagError {
    /// Reading failed.
    #[error("reading the bag: {0}")]
    Io(#[from] io::Error),
    /// It begins with something else.
    #[error("this is no ROS 1 bag: expected it to begin with \"#ROSBAG V2.0\", found {found}")]
    NotABag {
        /// What it begins with.
        found: String,
    },
    /// Its content is encrypted.
    #[error("the bag is encrypted ({0}); decrypt it with `rosbag decrypt` first")]
    Encrypted(String),
}

/// A topic with its type.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Connection {
    /// The topic's name.
    pub topic: Arc<str>,
    /// The type, e.g. `sensor_msgs/Imu`.
    pub kind: String,
}

/// One message.
#[derive(Clone, Copy, Debug)]
pub struct Message<'a> {
    /// Its topic.
    pub connection: &'a Connection,
    /// When it was recorded, in ns of the recorder's clock.
    pub received: i64,
    /// Its bytes.
    pub data: &'a [u8],
}

/// An open bag.
pub struct Bag<R> {
    reader: R,
    position: u64,
    connections: HashMap<u32, Connection>,
    damage: Faults,
    ended: bool,
    budget: Budget,
}

impl<R: Read> Bag<R> {
    /// Begins to read.
    ///
    /// # Errors
    ///
    /// It is no bag.
    pub fn open(mut reader: R) -> Result<Self, BagError> {
        let mut magic = Vec::new();
        (&mut reader)
            .take(MAGIC.len() as u64)
            .read_to_end(&mut magic)?;
        if magic != MAGIC {
            let found = if magic.is_empty() {
                "an empty file".into()
            } else {
                format!("{:?}", String::from_utf8_lossy(&magic))
            };
            return Err(BagError::NotABag { found });
        }
        Ok(Self {
            reader,
            position: MAGIC.len() as u64,
            connections: HashMap::new(),
            damage: Faults::new(MAX_DAMAGE),
            ended: false,
            budget: Budget::new(FOREIGN_RATIO),
        })
    }

    /// Bytes read so far.
    #[must_use]
    pub fn position(&self) -> u64 {
        self.position
    }

    /// What could not be read so far, in words.
    #[must_use]
    pub fn damage(&self) -> &[String] {
        self.damage.first()
    }

    /// Reads on to the end of the next chunk and gives its messages to `each`.
    /// False at the end of the bag.
    ///
    /// # Errors
    ///
    /// Reading fails, the bag is encrypted, or `each` returned an error.
    pub fn next_chunk<E: From<BagError>>(
        &mut self,
        mut each: impl FnMut(Message<'_>) -> Result<(), E>,
    ) -> Result<bool, E> {
        while !self.ended {
            let at = self.position;
            let Some((header, length)) = self.record_head()? else {
                return Ok(false);
            };
            let kind = field_u8(&header, "op");
            if kind == Some(OP_CHUNK) {
                let chunk = self.read_chunk(at, &header, length)?;
                self.each_message(at, &chunk, &mut each)?;
                return Ok(true);
            }
            let data = self.read(at, length, "record")?;
            if self.ended {
                return Ok(false);
            }
            match kind {
                Some(OP_BAG) => {
                    if let Some(name) = field(&header, "encryptor").filter(|name| !name.is_empty())
                    {
                        let name = String::from_utf8_lossy(name).into_owned();
                        return Err(BagError::Encrypted(name).into());
                    }
                }
                Some(OP_CONNECTION) => add_connection(&mut self.connections, &header, &data),
                Some(OP_INDEX | OP_CHUNK_INFO) => {}
                // Messages outside of chunks: not in any bag of version 2.0 that
                // rosbag writes, but its reader takes them.
                Some(OP_MESSAGE) => self.give(at, &header, &data, &mut each)?,
                _ => self.note(at, "a record without a known kind"),
            }
        }
        Ok(false)
    }

    fn each_message<E: From<BagError>>(
        &mut self,
        at: u64,
        chunk: &[u8],
        each: &mut impl FnMut(Message<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut rest = chunk;
        while !rest.is_empty() {
            let Some((header, data, after)) = split_record(rest) else {
                self.note(at, "a chunk ends within a record");
                break;
            };
            rest = after;
            match field_u8(header, "op") {
                Some(OP_CONNECTION) => add_connection(&mut self.connections, header, data),
                Some(OP_MESSAGE) => self.give(at, header, data, each)?,
                _ => {
                    self.note(at, "a chunk holds something that is no message");
                    break;
                }
            }
        }
        Ok(())
    }

    fn give<E>(
        &mut self,
        at: u64,
        header: &[u8],
        data: &[u8],
        each: &mut impl FnMut(Message<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let number = field_u32(header, "conn");
        let Some(connection) = number.and_then(|number| self.connections.get(&number)) else {
            self.note(at, "a message of a connection that is not described");
            return Ok(());
        };
        let received = field(header, "time").and_then(time).unwrap_or(0);
        each(Message {
            connection,
            received,
            data,
        })
    }

    /// A record's header and the length of its data; `None` at the end.
    fn record_head(&mut self) -> Result<Option<(Vec<u8>, u32)>, BagError> {
        let at = self.position;
        let Some(length) = self.length(at)? else {
            return Ok(None);
        };
        if length > MAX_HEADER {
            self.end(at, "a record's header is longer than any real one");
            return Ok(None);
        }
        let header = self.read(at, length, "record")?;
        if self.ended {
            return Ok(None);
        }
        let Some(length) = self.length(at)? else {
            self.end(at, "the bag ends within a record");
            return Ok(None);
        };
        if u64::from(length) > MAX_DATA {
            self.end(at, "a record is longer than any real one");
            return Ok(None);
        }
        Ok(Some((header, length)))
    }

    /// Reads and unpacks a chunk; what cannot be unpacked is left empty.
    fn read_chunk(&mut self, at: u64, header: &[u8], length: u32) -> Result<Vec<u8>, BagError> {
        // The last chunk of a bag that was not closed may be cut off: what is
        // there of it counts.
        let packed = self.read(at, length, "chunk")?;
        let limit = MAX_DATA + 1;
        let mut chunk = Vec::new();
        let result = match field(header, "compression") {
            Some(b"none") | None => {
                chunk = packed;
                Ok(0)
            }
            Some(b"bz2") => bzip2::read::BzDecoder::new(packed.as_slice())
                .take(limit)
                .read_to_end(&mut chunk),
            Some(b"lz4") => lz4_flex::frame::FrameDecoder::new(packed.as_slice())
                .take(limit)
                .read_to_end(&mut chunk),
            Some(other) => {
                let other = String::from_utf8_lossy(other);
                let other: String = other.chars().take(SHOWN_NAME).collect();
                let text = format!("chunk compression {other:?}; expected none, bz2 or lz4");
                self.note(at, text);
                return Ok(chunk);
            }
        };
        if let Err(error) = result {
            self.note(at, format!("a chunk cannot be unpacked in full: {error}"));
        }
        let unpacked = chunk.len() as u64;
        if unpacked > MAX_DATA {
            chunk.clear();
            self.note(at, "a chunk is larger than any real one when unpacked");
        }
        if !self.budget.takes(unpacked, self.position) {
            chunk.clear();
            let text = format!(
                "the bag unpacks to more than {FOREIGN_RATIO} times its length, which no real one \
                 does; the rest is left out"
            );
            self.end(at, text);
        }
        Ok(chunk)
    }

    fn length(&mut self, at: u64) -> Result<Option<u32>, BagError> {
        let mut bytes = Vec::with_capacity(4);
        let read = (&mut self.reader).take(4).read_to_end(&mut bytes)?;
        self.position += read as u64;
        match <[u8; 4]>::try_from(bytes) {
            Ok(bytes) => Ok(Some(u32::from_le_bytes(bytes))),
            Err(bytes) => {
                if !bytes.is_empty() {
                    self.end(at, "the bag ends within a record");
                }
                self.ended = true;
                Ok(None)
            }
        }
    }

    /// Reads so many bytes of `what`; fewer where the bag ends within it, which is noted.
    fn read(&mut self, at: u64, length: u32, what: &str) -> Result<Vec<u8>, BagError> {
        let mut data = Vec::new();
        let read = (&mut self.reader)
            .take(length.into())
            .read_to_end(&mut data)?;
        self.position += read as u64;
        if read < length as usize {
            self.end(at, format!("the bag ends within a {what}"));
        }
        Ok(data)
    }

    fn end(&mut self, at: u64, what: impl Display) {
        self.ended = true;
        self.note(at, what);
    }

    fn note(&mut self, at: u64, what: impl Display) {
        self.damage.add(format!("byte {at}: {what}"));
    }
}

fn add_connection(connections: &mut HashMap<u32, Connection>, header: &[u8], data: &[u8]) {
    let (Some(number), Some(topic)) = (field_u32(header, "conn"), field(header, "topic")) else {
        return;
    };
    let kind = field(data, "type").unwrap_or_default();
    if connections.len() >= MAX_CONNECTIONS || topic.len().max(kind.len()) > MAX_NAME {
        return;
    }
    connections.entry(number).or_insert_with(|| Connection {
        topic: String::from_utf8_lossy(topic).into(),
        kind: String::from_utf8_lossy(kind).into_owned(),
    });
}

/// Splits a record in memory into header, data and rest.
fn split_record(data: &[u8]) -> Option<(&[u8], &[u8], &[u8])> {
    let (header, rest) = split_block(data)?;
    let (data, rest) = split_block(rest)?;
    Some((header, data, rest))
}

fn split_block(data: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = data.split_first_chunk::<4>()?;
    rest.split_at_checked(u32::from_le_bytes(*length) as usize)
}

/// The value of a field of a header: a list of {length, `name=value`}.
fn field<'a>(header: &'a [u8], name: &str) -> Option<&'a [u8]> {
    let mut rest = header;
    while !rest.is_empty() {
        let (entry, after) = split_block(rest)?;
        rest = after;
        let split = entry.iter().position(|&byte| byte == b'=')?;
        if &entry[..split] == name.as_bytes() {
            return Some(&entry[split + 1..]);
        }
    }
    None
}

fn field_u8(header: &[u8], name: &str) -> Option<u8> {
    field(header, name)?.first().copied()
}

fn field_u32(header: &[u8], name: &str) -> Option<u32> {
    Some(u32::from_le_bytes(field(header, name)?.try_into().ok()?))
}

/// ROS time (u32 seconds, u32 nanoseconds) in ns.
fn time(bytes: &[u8]) -> Option<i64> {
    let (seconds, rest) = bytes.split_first_chunk::<4>()?;
    let (nanos, _) = rest.split_first_chunk::<4>()?;
    let seconds = i64::from(u32::from_le_bytes(*seconds));
    Some(seconds * 1_000_000_000 + i64::from(u32::from_le_bytes(*nanos)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A header's fields: a list of {length, `name=value`}.
    fn fields(fields: &[(&str, &[u8])]) -> Vec<u8> {
        let mut out = Vec::new();
        for (name, value) in fields {
            out.extend_from_slice(&((name.len() + 1 + value.len()) as u32).to_le_bytes());
            out.extend_from_slice(name.as_bytes());
            out.push(b'=');
            out.extend_from_slice(value);
        }
        out
    }

    /// A record: header and data, each after its length.
    fn record(header: &[(&str, &[u8])], data: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        for bytes in [&fields(header), data] {
            out.extend_from_slice(&(bytes.len() as u32).to_le_bytes());
            out.extend_from_slice(bytes);
        }
        out
    }

    fn small_bag() -> Vec<u8> {
        let mut chunk = record(
            &[("op", &[7]), ("conn", &[0, 0, 0, 0]), ("topic", b"/a")],
            &fields(&[("type", b"std_msgs/String"), ("topic", b"/a")]),
        );
        let message: &[(&str, &[u8])] = &[
            ("op", &[2]),
            ("conn", &[0, 0, 0, 0]),
            ("time", &[5, 0, 0, 0, 7, 0, 0, 0]),
        ];
        chunk.extend(record(message, b"one"));
        chunk.extend(record(message, b"two"));
        let mut bag = MAGIC.to_vec();
        bag.extend(record(
            &[
                ("op", &[3]),
                ("index_pos", &[0; 8]),
                ("conn_count", &[1, 0, 0, 0]),
            ],
            &[b' '; 40],
        ));
        bag.extend(record(&[("op", &[5]), ("compression", b"none")], &chunk));
        bag
    }

    fn read(bag: &[u8]) -> (Vec<Vec<u8>>, usize) {
        let mut bag = Bag::open(bag).unwrap();
        let mut messages = Vec::new();
        while bag
            .next_chunk(|message| {
                assert_eq!(message.connection.kind, "std_msgs/String");
                assert_eq!(message.received, 5_000_000_007);
                messages.push(message.data.to_vec());
                Ok::<(), BagError>(())
            })
            .unwrap()
        {}
        (messages, bag.damage().len())
    }

    #[test]
    fn a_bag_cut_at_any_byte_gives_its_whole_messages() {
        let whole = small_bag();
        assert_eq!(read(&whole), (vec![b"one".to_vec(), b"two".to_vec()], 0));
        for end in MAGIC.len()..whole.len() {
            let (messages, _) = read(&whole[..end]);
            assert!(messages.len() <= 1, "{end}");
        }
        let (messages, damage) = read(&whole[..whole.len() - 1]);
        assert_eq!(messages, [b"one".to_vec()]);
        assert!(damage > 0);
    }

    #[test]
    fn what_is_no_bag_is_said() {
        let error = Bag::open(&b"RIFF\0\0\0\0AVI LIST"[..]).err().unwrap();
        assert!(error.to_string().contains("RIFF"), "{error}");
        assert!(matches!(Bag::open(&b""[..]), Err(BagError::NotABag { .. })));
    }
}
