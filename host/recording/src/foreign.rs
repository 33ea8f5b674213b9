//! The messages of an MCAP file of any program, with topic and type.
//!
//! What is wanted of them is the caller's choice, by the type that the file states: names
//! of topics are the choice of whoever recorded it.
//!
//! Limits: those of [`chunks`](super::chunks).

use std::collections::HashMap;
use std::io;
use std::path::Path;

use mcap::records::Record;

use super::chunks::{BadChunk, Chunks, ChunksError};
use super::scan::parse;

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
    /// It cannot be used; others may follow.
    LeftOut(BadChunk),
    /// There was none left.
    End,
}

/// The messages of a file.
pub struct Messages {
    chunks: Chunks,
    /// Of the last chunk, for the next one.
    memory: Vec<u8>,
    /// Names of types.
    schemas: HashMap<u16, String>,
    channels: HashMap<u16, Channel>,
}

struct Channel {
    topic: String,
    encoding: String,
    schema: u16,
}

impl Messages {
    /// Begins at the front of a file.
    ///
    /// # Errors
    ///
    /// It cannot be opened.
    pub fn open(path: &Path) -> io::Result<Self> {
        Ok(Self {
            chunks: Chunks::open(path)?,
            memory: Vec::new(),
            schemas: HashMap::new(),
            channels: HashMap::new(),
        })
    }

    /// Gives the messages of the next chunk to `each`.
    ///
    /// # Errors
    ///
    /// The file breaks off here, or cannot be read; nothing more comes then.
    pub fn next_chunk(&mut self, mut each: impl FnMut(Message<'_>)) -> Result<Next, ChunksError> {
        let packed = match self.chunks.next_packed() {
            Ok(Some(packed)) => packed,
            Ok(None) => return Ok(Next::End),
            // Only an index and statistics are missing.
            Err(_) if self.chunks.data_complete() => return Ok(Next::End),
            Err(error) => return Err(error),
        };
        let chunk = match packed.unpack(std::mem::take(&mut self.memory)) {
            Ok(chunk) => chunk,
            Err(why) => return Ok(Next::LeftOut(why)),
        };
        for (opcode, body) in chunk.records() {
            match parse(opcode, body) {
                Some(Record::Schema { header, .. }) => {
                    self.schemas.insert(header.id, header.name);
                }
                Some(Record::Channel(channel)) => {
                    let known = Channel {
                        topic: channel.topic,
                        encoding: channel.message_encoding,
                        schema: channel.schema_id,
                    };
                    self.channels.insert(channel.id, known);
                }
                Some(Record::Message { header, data }) => {
                    let Some(channel) = self.channels.get(&header.channel_id) else {
                        continue;
                    };
                    each(Message {
                        topic: &channel.topic,
                        kind: self.schemas.get(&channel.schema).map_or("", String::as_str),
                        encoding: &channel.encoding,
                        data: &data,
                    });
                }
                _ => {}
            }
        }
        self.memory = chunk.into_memory();
        Ok(Next::Given)
    }

    /// The topics so far, with messages or without, in no order.
    pub fn topics(&self) -> impl Iterator<Item = &str> {
        self.channels.values().map(|channel| channel.topic.as_str())
    }

    /// Bytes of the file that were read so far.
    #[must_use]
    pub const fn position(&self) -> u64 {
        self.chunks.position()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::io::Cursor;

    use mcap::records::MessageHeader;

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
                if matches!(next.unwrap(), Next::End) {
                    break;
                }
            }
            let names = ["/a", "a_msgs/msg/A", "cdr"].map(String::from);
            assert_eq!(found, [(names, vec![7, 8])], "chunks: {in_chunks}");
            assert_eq!(messages.topics().collect::<Vec<_>>(), ["/a"]);
        }
    }
}
