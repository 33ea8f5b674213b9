//! State of an MCAP file as bytes: its damage, and how much can be read.

use protocol::Ticks;
use serde::Serialize;

use super::chunks::BadChunk;

/// Longest name of a topic that is read, bytes. There may be 65,536 topics.
pub(crate) const MAX_NAME: usize = 1_000;

/// State of a file as bytes.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct FileReport {
    /// Length of the file, bytes.
    pub bytes: u64,
    /// Chunks whose checksum is right.
    pub chunks: u64,
    /// Chunks that cannot be used.
    pub bad_chunks: u64,
    /// Bytes that belong to no record.
    pub skipped_bytes: u64,
    /// Byte at which the whole records end, if the writer was stopped before it closed the file.
    pub cut_off_at: Option<u64>,
    /// True if the record that closes the data is there: only the index may be missing.
    pub data_complete: bool,
    /// True if the writer closed the file.
    pub closed: bool,
    /// Messages that can be read.
    pub messages: u64,
}

/// A damage of the file.
#[derive(Debug, thiserror::Error)]
pub enum Damage {
    /// A chunk cannot be used.
    #[error("the chunk at byte {at}, from {:.1} s of board time on, cannot be used: {why}", .from.as_secs_f64())]
    Chunk {
        /// Byte at which it begins.
        at: u64,
        /// Board time of its first message, from its head.
        from: Ticks,
        /// Reason.
        why: BadChunk,
    },
    /// A chunk ends within a record.
    #[error("a chunk ends within a record: its last {bytes} bytes cannot be read")]
    ChunkEnd {
        /// Bytes after its last whole record.
        bytes: usize,
    },
    /// Bytes belong to no record.
    #[error("{} bytes from byte {from} on are not records", to - from)]
    Bytes {
        /// First of these bytes.
        from: u64,
        /// First byte after them.
        to: u64,
    },
    /// The file ends within a record, or without the records that close it.
    #[error("the file was not closed: its last whole record ends at byte {at} of {length}")]
    CutOff {
        /// Byte at which the whole records end.
        at: u64,
        /// Length of the file, bytes.
        length: u64,
        /// True if the data are complete: only the index is missing.
        complete: bool,
    },
    /// A record does not have the form of its kind.
    #[error("a record is not of its kind")]
    Record,
    /// A message stands outside of a chunk, where this program puts none.
    #[error("a message stands outside of a chunk and is left out")]
    OutsideChunk,
    /// The name of a topic is longer than any real one.
    #[error("a topic's name has {bytes} bytes; up to {MAX_NAME} are read")]
    TopicName {
        /// Length of the name, bytes.
        bytes: usize,
    },
    /// The file does not describe the topic of a message.
    #[error("a message belongs to channel {channel}, which is not described")]
    UnknownTopic {
        /// Number of its channel.
        channel: u16,
    },
    /// The description of the topics is damaged: those of this program are assumed.
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
    /// The head of a chunk states other times than its messages have.
    #[error("the chunk at byte {at} states other times than its messages have")]
    ChunkTimes {
        /// Byte at which it begins.
        at: u64,
    },
    /// The index names other chunks than the file has.
    #[error("the index at the end names other chunks than the file has")]
    ChunkIndex,
    /// The file's statistics state other topics, chunks or times than it has.
    #[error("the file's statistics state other counts or times than its messages have")]
    Statistics,
    /// The file's statistics state another number of messages.
    #[error("{found} messages can be read where the file's statistics say {expected}")]
    MessageCount {
        /// Messages that can be read.
        found: u64,
        /// Messages by the statistics.
        expected: u64,
    },
}

impl Damage {
    /// Returns a stable word for the kind of damage.
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
            Self::ChunkTimes { .. } => "chunk_times",
            Self::ChunkIndex => "chunk_index",
            Self::Statistics => "statistics",
            Self::MessageCount { .. } => "message_count",
        }
    }

    /// Returns true if messages may be missing here.
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

    /// Returns true if the file once held something that cannot be read.
    #[must_use]
    pub const fn is_loss(&self) -> bool {
        match self {
            Self::TopicName { .. } | Self::UnknownTopic { .. } => true,
            Self::CutOff { complete, .. } => !*complete,
            _ => self.is_gap(),
        }
    }

    /// Returns the board time of the damage, if it is known.
    #[must_use]
    pub const fn at(&self) -> Option<Ticks> {
        match self {
            Self::Chunk { from, .. } => Some(*from),
            _ => None,
        }
    }
}
