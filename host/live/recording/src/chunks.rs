//! The chunks of an MCAP file, unpacked and checked.
//!
//! Memory is bounded by 20 MiB of a chunk, packed and unpacked, time by the file's length
//! ([`Budget`]), whatever the file claims.
//!
//! Limits: chunks are stored as they are or with LZ4, which is all that this program writes.

use std::borrow::Cow;
use std::io::{self, Read};

use mcap::records::{ChunkHeader, Record, op};

/// The longest record that is taken: a chunk that could not be packed, with its head.
pub(crate) const MAX_RECORD: u64 = MAX_CHUNK + (1 << 16);

/// The largest chunk when unpacked: above the 16 MiB at which a writer of this program
/// closes one, if half a second has not done so.
const MAX_CHUNK: u64 = 20 << 20;

/// What a file may unpack to in all: this much, and so many times the bytes that it has
/// up to there.
const MAX_UNPACKED: u64 = 64 << 20;

/// How many times its length a file may unpack to. Recordings unpack to 2.1 to 2.6 times
/// theirs; in a bag, LZ4 packs pictures without any depth to a 250th, others to a quarter.
const RATIO: u64 = 64;

/// Opcode and length before the body of a record.
const HEAD: usize = 9;

/// How much of the name of an unknown compression is reported.
const SHOWN_NAME: usize = 16;

/// Why a chunk cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum BadChunk {
    /// It is longer than any real one.
    #[error("it claims {0} bytes, more than any real one holds")]
    TooLarge(u64),
    /// A compression that this program does not know.
    #[error("it is packed with {0:?}; expected lz4 or nothing")]
    Compression(String),
    /// Its bytes are not packed as it says.
    #[error("it cannot be unpacked: {0}")]
    Packing(io::Error),
    /// It is shorter or longer than it says.
    #[error("it holds {found} bytes where {expected} were expected")]
    Length {
        /// Bytes of its records.
        found: u64,
        /// Bytes by its head.
        expected: u64,
    },
    /// Its bytes were changed.
    #[error("its checksum is wrong")]
    Checksum,
    /// The chunks before it have unpacked to as much as any real file does.
    #[error("the file unpacks to more than {RATIO} times its length, which no recording does")]
    Budget,
}

/// What the chunks of a file have unpacked to, so that a small file costs little time.
///
/// A file may unpack to 64 MiB, and to a multiple of the bytes that were read of it.
#[derive(Debug, Default)]
pub(crate) struct Budget(u64);

impl Budget {
    /// Takes a chunk, in a file that was read up to `position`.
    pub(crate) fn take(&mut self, header: &ChunkHeader, position: u64) -> Result<(), BadChunk> {
        let most = position.saturating_mul(RATIO).saturating_add(MAX_UNPACKED);
        // One that claims more than any is refused for that.
        let unpacked = header.uncompressed_size.min(MAX_CHUNK);
        let total = self.0.saturating_add(unpacked);
        if total > most {
            return Err(BadChunk::Budget);
        }
        self.0 = total;
        Ok(())
    }
}

/// The records of a chunk whose checksum is right.
#[derive(Debug)]
pub struct Chunk(pub(crate) Vec<u8>);

impl Chunk {
    /// Opcode and body of each record; ends at the first that is cut off
    /// ([`Chunk::cut_off`]).
    pub fn records(&self) -> impl Iterator<Item = (u8, &[u8])> {
        let mut rest = self.0.as_slice();
        std::iter::from_fn(move || {
            let (opcode, body, after) = split_record(rest)?;
            rest = after;
            Some((opcode, body))
        })
    }

    /// Bytes after the last whole record, which claims more than there are.
    #[must_use]
    pub fn cut_off(&self) -> usize {
        let whole = self.records().map(|(_, body)| HEAD + body.len());
        self.0.len() - whole.sum::<usize>()
    }

    /// The memory, for the next chunk: asking the system for it again costs as much as
    /// unpacking.
    #[must_use]
    pub fn into_memory(self) -> Vec<u8> {
        self.0
    }
}

/// A record by its opcode; `None` if it is no such, or one of a kind that nobody has a use
/// for.
#[must_use]
pub fn parse(opcode: u8, body: &[u8]) -> Option<Record<'_>> {
    strings_fit(opcode, body)?;
    mcap::parse_record(opcode, body).ok()
}

/// Whether the strings of a record fit into it: the parser makes room for as much as they
/// claim, up to 4 GB, before it looks whether that is there.
fn strings_fit(opcode: u8, body: &[u8]) -> Option<()> {
    fn length(bytes: &[u8]) -> Option<(usize, &[u8])> {
        let (length, rest) = bytes.split_first_chunk::<4>()?;
        Some((usize::try_from(u32::from_le_bytes(*length)).ok()?, rest))
    }
    let (fixed, strings) = match opcode {
        op::HEADER => (0, 2),
        op::SCHEMA => (2, 2),
        op::CHANNEL => (4, 2),
        op::CHUNK => (28, 1),
        op::ATTACHMENT => (16, 2),
        op::FOOTER | op::MESSAGE | op::STATISTICS | op::DATA_END => return Some(()),
        _ => return None,
    };
    let mut rest = body.get(fixed..)?;
    for _ in 0..strings {
        let (long, after) = length(rest)?;
        rest = after.get(long..)?;
    }
    if opcode == op::ATTACHMENT {
        // The parser takes the length of the data and the checksum for granted.
        rest.get(..12)?;
    }
    if opcode == op::CHANNEL {
        let (long, after) = length(rest)?;
        let mut pairs = after.get(..long)?;
        while !pairs.is_empty() {
            let (long, after) = length(pairs)?;
            pairs = after.get(long..)?;
        }
    }
    Some(())
}

/// Unpacks and checks the records of a chunk.
pub(crate) fn unpack(
    header: &ChunkHeader,
    packed: Cow<'_, [u8]>,
    memory: Vec<u8>,
) -> Result<Chunk, BadChunk> {
    let expected = header.uncompressed_size;
    if expected > MAX_CHUNK {
        return Err(BadChunk::TooLarge(expected));
    }
    let records = match header.compression.as_str() {
        "" => packed.into_owned(),
        "lz4" => {
            let decoder = lz4_flex::frame::FrameDecoder::new(packed.as_ref());
            read_all(decoder, expected, memory).map_err(BadChunk::Packing)?
        }
        other => {
            let name = other.chars().take(SHOWN_NAME).collect();
            return Err(BadChunk::Compression(name));
        }
    };
    let found = records.len() as u64;
    if found != expected {
        return Err(BadChunk::Length { found, expected });
    }
    // 0: its writer made none.
    if header.uncompressed_crc != 0 && header.uncompressed_crc != crc32fast::hash(&records) {
        return Err(BadChunk::Checksum);
    }
    Ok(Chunk(records))
}

/// What a decoder gives, in this memory; at most one byte more than is expected.
fn read_all(decoder: impl Read, expected: u64, mut memory: Vec<u8>) -> io::Result<Vec<u8>> {
    memory.clear();
    decoder.take(expected + 1).read_to_end(&mut memory)?;
    Ok(memory)
}

/// Opcode and body of the first of a chunk's records, and what follows; `None` if it
/// is cut off.
fn split_record(records: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (&opcode, after) = records.split_first()?;
    let (length, after) = after.split_first_chunk::<8>()?;
    let length = usize::try_from(u64::from_le_bytes(*length)).ok()?;
    let (body, after) = after.split_at_checked(length)?;
    Some((opcode, body, after))
}
