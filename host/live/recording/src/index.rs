//! Compares the index of an MCAP file with the chunks and messages that were read: other programs
//! find messages by it.

use std::collections::BTreeMap;

use mcap::records::{ChunkHeader, ChunkIndex, MessageHeader, Statistics};

use super::damage::Damage;

/// Place of a chunk in the file, and times of its messages as its head states them, ns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct ChunkPlace {
    pub(crate) at: u64,
    pub(crate) length: u64,
    times: [u64; 2],
}

impl ChunkPlace {
    /// Returns the place of a chunk, which begins at byte `at` and is `length` bytes long.
    pub(crate) const fn new(at: u64, length: u64, header: &ChunkHeader) -> Self {
        Self {
            at,
            length,
            times: [header.message_start_time, header.message_end_time],
        }
    }
}

/// Everything that an index states, once as it was read and once as it was found.
#[derive(Default)]
pub(crate) struct Index {
    chunks: Vec<ChunkPlace>,
    listed: Vec<ChunkPlace>,
    messages: BTreeMap<u16, u64>,
    statistics: Option<Statistics>,
    /// First and last time of the messages in the current chunk, and in the whole file, ns.
    chunk_times: Option<[u64; 2]>,
    times: Option<[u64; 2]>,
}

fn add_time(times: &mut Option<[u64; 2]>, at: u64) {
    let [from, to] = times.unwrap_or([at; 2]);
    *times = Some([from.min(at), to.max(at)]);
}

impl Index {
    /// Adds a message.
    pub(crate) fn message(&mut self, header: &MessageHeader) {
        *self.messages.entry(header.channel_id).or_default() += 1;
        add_time(&mut self.chunk_times, header.log_time);
        add_time(&mut self.times, header.log_time);
    }

    /// Adds a chunk after its messages, and compares its head with them.
    pub(crate) fn chunk(&mut self, place: ChunkPlace) -> Result<(), Damage> {
        self.chunks.push(place);
        match self.chunk_times.take() {
            Some(times) if times != place.times => Err(Damage::ChunkTimes { at: place.at }),
            _ => Ok(()),
        }
    }

    /// Adds an entry of the index.
    pub(crate) fn listed(&mut self, entry: &ChunkIndex) {
        self.listed.push(ChunkPlace {
            at: entry.chunk_start_offset,
            length: entry.chunk_length,
            times: [entry.message_start_time, entry.message_end_time],
        });
    }

    /// Sets the statistics of the file.
    pub(crate) fn statistics(&mut self, statistics: Statistics) {
        self.statistics = Some(statistics);
    }

    /// Returns the number of messages by the statistics.
    pub(crate) fn counted(&self) -> Option<u64> {
        Some(self.statistics.as_ref()?.message_count)
    }

    /// Returns the number of messages of a channel that were read.
    pub(crate) fn messages_of(&self, channel: u16) -> u64 {
        self.messages.get(&channel).copied().unwrap_or_default()
    }

    /// Returns the times of the first and the last message that were read, ns.
    pub(crate) const fn times(&self) -> Option<[u64; 2]> {
        self.times
    }

    /// Compares the index with what was read, of a file without any damage.
    pub(crate) fn compare(&mut self) -> Result<(), Damage> {
        self.listed.sort_unstable();
        if !self.listed.is_empty() && self.listed != self.chunks {
            return Err(Damage::ChunkIndex);
        }
        let Some(statistics) = &self.statistics else {
            return Ok(());
        };
        let counts = &statistics.channel_message_counts;
        let counted = counts.iter().filter(|(_, count)| **count > 0);
        let times = [statistics.message_start_time, statistics.message_end_time];
        let is_same = (counts.is_empty() || counted.eq(&self.messages))
            && statistics.chunk_count as usize == self.chunks.len()
            && self.times.is_none_or(|found| found == times);
        is_same.then_some(()).ok_or(Damage::Statistics)
    }
}
