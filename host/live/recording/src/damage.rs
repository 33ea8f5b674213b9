//! The state of a file as bytes: what is damaged in it, and how much can be read.

use protocol::Ticks;
use serde::Serialize;

use super::chunks::BadChunk;

/// The longest name of a topic that is taken, bytes. There may be 65,536 of them.
pub(crate) const MAX_NAME: usize = 1_000;

/// The file as bytes.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct FileReport {
    /// Length.
    pub bytes: u64,
    /// Chunks whose checksum is right.
    pub chunks: u64,
    /// Chunks that cannot be used.
    pub bad_chunks: u64,
    /// Bytes that are no records.
    pub skipped_bytes: u64,
    /// Whole records end at this byte: the writer did not come to its end.
    pub cut_off_at: Option<u64>,
    /// The record that closes the data is there: only the index may be missing.
    pub data_complete: bool,
    /// The end that a writer makes is there.
    pub closed: bool,
    /// Messages that can be read.
    pub messages: u64,
}

/// Something that is damaged.
#[derive(Debug, thiserror::Error)]
pub enum Damage {
    /// A chunk cannot be used.
    #[error("the chunk at byte {at}, from {:.1} s of board time on, cannot be used: {why}", .from.as_secs_f64())]
    Chunk {
        /// Byte at which it begins.
        at: u64,
        /// Board time of its first message, as its head says.
        from: Ticks,
        /// What is wrong with it.
        why: BadChunk,
    },
    /// A chunk ends within a record.
    #[error("a chunk ends within a record: its last {bytes} bytes cannot be read")]
    ChunkEnd {
        /// Bytes after its last whole record.
        bytes: usize,
    },
    /// Bytes are no records.
    #[error("{} bytes from byte {from} on are no records", to - from)]
    Bytes {
        /// From this byte.
        from: u64,
        /// Up to this one.
        to: u64,
    },
    /// The file ends within a record, or without the records that close it.
    #[error("the file was not closed: its last whole record ends at byte {at} of {length}")]
    CutOff {
        /// Whole records end here.
        at: u64,
        /// Length of the file.
        length: u64,
        /// The data are complete: only the index is missing.
        complete: bool,
    },
    /// A record is not of its kind.
    #[error("a record is not of its kind")]
    Record,
    /// A message stands outside of a chunk, where this program puts none.
    #[error("a message stands outside of a chunk and is left out")]
    OutsideChunk,
    /// A topic's name is longer than any.
    #[error("a topic's name has {bytes} bytes; up to {MAX_NAME} are read")]
    TopicName {
        /// Its bytes.
        bytes: usize,
    },
    /// A message's topic is not described.
    #[error("a message belongs to channel {channel}, which is not described")]
    UnknownTopic {
        /// Number of its channel.
        channel: u16,
    },
    /// No topic is described: those of this program are taken.
    #[error("the part that describes the topics is damaged; those of this program are taken")]
    TopicsAssumed,
    /// The checksum over all data is wrong.
    #[error("the checksum over all data is wrong")]
    DataChecksum,
    /// The checksum over the index is wrong.
    #[error("the checksum over the index at the end is wrong")]
    IndexChecksum,
    /// The record that closes the data is damaged.
    #[error("the record that closes the data is damaged")]
    NoEndOfData,
    /// The file's statistics tell another number of messages.
    #[error("{found} messages can be read where the file's statistics say {expected}")]
    MessageCount {
        /// Messages that can be read.
        found: u64,
        /// As the statistics say.
        expected: u64,
    },
}

impl Damage {
    /// A stable word for its kind.
    #[must_use]
    pub const fn kind(&self) -> &'static str {
        match self {
            Self::Chunk { .. } => "chunk_damaged",
            Self::ChunkEnd { .. } => "chunk_cut_off",
            Self::Bytes { .. } => "bytes_damaged",
            Self::CutOff { .. } => "cut_off",
            Self::Record => "record_damaged",
            Self::OutsideChunk => "message_outside_chunk",
            Self::TopicName { .. } => "topic_name",
            Self::UnknownTopic { .. } => "unknown_topic",
            Self::TopicsAssumed => "topics_assumed",
            Self::DataChecksum => "data_checksum",
            Self::IndexChecksum => "index_checksum",
            Self::NoEndOfData => "no_end_of_data",
            Self::MessageCount { .. } => "message_count",
        }
    }

    /// Whether messages are missing here.
    #[must_use]
    pub const fn is_gap(&self) -> bool {
        matches!(
            self,
            Self::Chunk { .. }
                | Self::ChunkEnd { .. }
                | Self::Bytes { .. }
                | Self::CutOff { .. }
                | Self::Record
                | Self::OutsideChunk
        )
    }

    /// Whether something was left out that the file once held.
    #[must_use]
    pub const fn is_loss(&self) -> bool {
        match self {
            Self::TopicName { .. } | Self::UnknownTopic { .. } => true,
            Self::CutOff { complete, .. } => !*complete,
            _ => self.is_gap(),
        }
    }

    /// Board time of it, where that is known.
    #[must_use]
    pub const fn at(&self) -> Option<Ticks> {
        match self {
            Self::Chunk { from, .. } => Some(*from),
            _ => None,
        }
    }
}
