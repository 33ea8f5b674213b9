//! A part of a bag in MCAP.

use std::collections::HashMap;
use std::io;
use std::path::Path;

use mcap::records::Record;

use super::{Message, Next, Part};
use crate::chunks::{Chunks, FOREIGN_RATIO, parse};

pub(super) struct File {
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

impl File {
    pub(super) fn open(path: &Path) -> io::Result<Self> {
        Ok(Self {
            chunks: Chunks::open(path, FOREIGN_RATIO)?,
            memory: Vec::new(),
            schemas: HashMap::new(),
            channels: HashMap::new(),
        })
    }
}

impl Part for File {
    fn next_chunk(&mut self, each: &mut dyn FnMut(Message<'_>)) -> Next {
        let packed = match self.chunks.next_packed() {
            Ok(Some(packed)) => packed,
            Ok(None) => return Next::End,
            // Only an index and statistics are missing.
            Err(_) if self.chunks.data_complete() => return Next::End,
            Err(error) => {
                let at = self.position();
                return Next::Damaged(format!("cannot be read beyond byte {at}: {error}"));
            }
        };
        let chunk = match packed.unpack(std::mem::take(&mut self.memory)) {
            Ok(chunk) => chunk,
            Err(why) => return Next::Damaged(format!("a chunk is left out: {why}")),
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
        let cut_off = chunk.cut_off();
        self.memory = chunk.into_memory();
        match cut_off {
            0 => Next::Given,
            bytes => Next::Damaged(format!(
                "a chunk ends within a record: {bytes} bytes are left out"
            )),
        }
    }

    fn topics(&self) -> Vec<String> {
        let channels = self.channels.values();
        channels.map(|channel| channel.topic.clone()).collect()
    }

    fn position(&self) -> u64 {
        self.chunks.position()
    }
}
