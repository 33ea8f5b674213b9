//! Reads `recording.mcap`, whole or broken off.
//!
//! Records are read front to back with bounded memory (one chunk). A file whose
//! writer was killed ends in the middle of a record: the whole chunks before are given
//! out, then [`Reader::broken_off`] says that the end is missing.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use mcap::McapError;
use mcap::records::{Record, op};
use protocol::Ticks;

use super::chunks::{self, BadChunk, Chunk, Chunks, ChunksError, OWN_RATIO, split_record};
pub use super::topic::Item;
use super::topic::Topic;
use super::{RecordingError, mcap_of};

/// A message with its time.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Board time.
    pub at: Ticks,
    /// Running number on its topic.
    pub sequence: u32,
    /// The message.
    pub item: Item,
}

/// A recording that is being read. It is an iterator of [`Entry`]; topics that this
/// version does not know are left out.
pub struct Reader {
    chunks: Chunks,
    path: PathBuf,
    topics: BTreeMap<u16, Topic>,
    /// The chunk whose records are being given out, and where the next of them begins.
    chunk: Option<(Chunk, usize)>,
    broken_off: bool,
    ended: bool,
}

/// Board time of a `log_time` or stamp, exactly.
#[must_use]
pub fn ticks_of_nanos(nanos: u64) -> Ticks {
    // round(ns · 6 / 125); ticks are 20.83 ns apart, so rounding to nanoseconds
    // and back is exact.
    let ticks = (u128::from(nanos) * 6 + 62) / 125;
    Ticks(u64::try_from(ticks).unwrap_or(u64::MAX))
}

impl Reader {
    /// Opens the recording in a folder, or an MCAP file.
    ///
    /// # Errors
    ///
    /// The file cannot be read.
    pub fn open(folder_or_file: &Path) -> Result<Self, RecordingError> {
        let path = mcap_of(folder_or_file);
        Ok(Self {
            chunks: Chunks::open(&path, OWN_RATIO).map_err(RecordingError::io("read", &path))?,
            path,
            topics: BTreeMap::new(),
            chunk: None,
            broken_off: false,
            ended: false,
        })
    }

    /// Whether the file ends in the middle, or is damaged from some byte on: its writer
    /// did not come to its end. Known once the last entry was given out.
    #[must_use]
    pub const fn broken_off(&self) -> bool {
        self.broken_off
    }

    fn step(&mut self) -> Result<Option<Entry>, RecordingError> {
        loop {
            if let Some(entry) = self.step_in_chunk()? {
                return Ok(Some(entry));
            }
            let packed = match self.chunks.next_packed() {
                Ok(Some(packed)) => packed,
                Ok(None) => return Ok(None),
                Err(ChunksError::CutOff) => {
                    self.broken_off = true;
                    return Ok(None);
                }
                Err(ChunksError::Mcap(source)) => return Err(self.failed(source)),
                Err(ChunksError::Read(source)) => {
                    return Err(RecordingError::io("read", &self.path)(source));
                }
            };
            match packed.unpack(Vec::new()) {
                Ok(chunk) => self.chunk = Some((chunk, 0)),
                Err(BadChunk::Checksum) => {
                    self.broken_off = true;
                    return Ok(None);
                }
                Err(source) => {
                    return Err(RecordingError::Chunk {
                        path: self.path.clone(),
                        source,
                    });
                }
            }
        }
    }

    /// The next message of the chunk at hand; `None` if there is none left in it.
    fn step_in_chunk(&mut self) -> Result<Option<Entry>, RecordingError> {
        while let Some((chunk, at)) = &mut self.chunk {
            let rest = chunk.bytes().get(*at..).unwrap_or_default();
            if rest.is_empty() {
                self.chunk = None;
                break;
            }
            let Some((opcode, body, after)) = split_record(rest) else {
                return Err(self.failed(McapError::UnexpectedEoc));
            };
            *at = chunk.bytes().len() - after.len();
            if !matches!(opcode, op::CHANNEL | op::MESSAGE) {
                continue;
            }
            match chunks::parse(opcode, body) {
                Some(Record::Channel(channel)) => {
                    if let Some(topic) = Topic::of(&channel.topic) {
                        self.topics.insert(channel.id, topic);
                    }
                }
                Some(Record::Message { header, data }) => {
                    let Some(topic) = self.topics.get(&header.channel_id) else {
                        continue;
                    };
                    let item = topic
                        .read(&data)
                        .map_err(|source| RecordingError::Message {
                            topic: topic.name().to_owned(),
                            source,
                        })?;
                    return Ok(Some(Entry {
                        at: ticks_of_nanos(header.log_time),
                        sequence: header.sequence,
                        item,
                    }));
                }
                _ => return Err(self.failed(McapError::UnexpectedEoc)),
            }
        }
        Ok(None)
    }

    fn failed(&self, source: McapError) -> RecordingError {
        RecordingError::mcap(&self.path)(source)
    }
}

impl Iterator for Reader {
    type Item = Result<Entry, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        let result = self.step();
        self.ended = !matches!(result, Ok(Some(_)));
        result.transpose()
    }
}
