//! Unpacks and checks the chunks of an MCAP file.
//!
//! Memory is bounded by 20 MiB of a chunk, packed and unpacked, and time by the length of the
//! file ([`Budget`]), whatever the file claims.
//!
//! Limits: chunks are uncompressed or LZ4, as this program writes them.

use std::borrow::Cow;
use std::io::{self, Read};

use mcap::records::{ChunkHeader, Record, op};

/// Longest record that is read: a chunk that could not be compressed, with its head.
pub(crate) const MAX_RECORD: u64 = MAX_CHUNK + (1 << 16);

/// Largest chunk when unpacked: above the 16 MiB at which a writer of this program closes one,
/// unless half a second of recording does so first.
const MAX_CHUNK: u64 = 20 << 20;

/// Most bytes that a file may unpack to, besides [`RATIO`] times the bytes read so far.
const MAX_UNPACKED: u64 = 64 << 20;

/// Most bytes that a file may unpack to per byte of its length. Recordings unpack to 2.1 to 2.6
/// times their length; in a bag, LZ4 packs pictures without any depth to a 250th, others to a
/// quarter.
const RATIO: u64 = 64;

/// Bytes of opcode and length before the body of a record.
const HEAD: usize = 9;

/// Most characters of the name of an unknown compression that are reported.
const SHOWN_NAME: usize = 16;

/// Reason why a chunk cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum BadChunk {
    /// The chunk claims more bytes than any real one holds.
    #[error("it claims {0} bytes, more than any real one holds")]
    TooLarge(u64),
    /// The chunk has a compression that this program does not know, by its name.
    #[error("it is packed with {0:?}; expected lz4 or nothing")]
    Compression(String),
    /// The bytes cannot be decompressed.
    #[error("it cannot be unpacked: {0}")]
    Packing(io::Error),
    /// The records are shorter or longer than the head says.
    #[error("it holds {found} bytes where {expected} were expected")]
    Length {
        /// Bytes of its records.
        found: u64,
        /// Bytes stated by its head.
        expected: u64,
    },
    /// The checksum does not match the bytes.
    #[error("its checksum is wrong")]
    Checksum,
    /// The chunks before it have unpacked to as much as any real file does.
    #[error("the file unpacks to more than {RATIO} times its length, which no recording does")]
    Budget,
}

/// Bytes that the chunks of a file have unpacked to, so that a small file costs little time.
///
/// A file may unpack to 64 MiB plus a multiple of the bytes read so far.
#[derive(Debug, Default)]
pub(crate) struct Budget(u64);

impl Budget {
    /// Adds a chunk of a file that was read up to byte `position`, or refuses it.
    pub(crate) fn spend(&mut self, header: &ChunkHeader, position: u64) -> Result<(), BadChunk> {
        let most = position.saturating_mul(RATIO).saturating_add(MAX_UNPACKED);
        // A chunk that claims more is refused for that reason later.
        let unpacked = header.uncompressed_size.min(MAX_CHUNK);
        let total = self.0.saturating_add(unpacked);
        if total > most {
            return Err(BadChunk::Budget);
        }
        self.0 = total;
        Ok(())
    }
}

/// Records of a chunk whose checksum is right.
#[derive(Debug)]
pub(crate) struct Chunk(pub(crate) Vec<u8>);

impl Chunk {
    /// Iterates over opcode and body of each record, up to the first that is cut off
    /// ([`Chunk::cut_off`]).
    pub(crate) fn records(&self) -> impl Iterator<Item = (u8, &[u8])> {
        let mut rest = self.0.as_slice();
        std::iter::from_fn(move || {
            let (opcode, body, after) = split_record(rest)?;
            rest = after;
            Some((opcode, body))
        })
    }

    /// Returns the number of bytes after the last whole record.
    pub(crate) fn cut_off(&self) -> usize {
        let whole = self.records().map(|(_, body)| HEAD + body.len());
        self.0.len() - whole.sum::<usize>()
    }

    /// Returns the memory for the next chunk: a new allocation costs as much as unpacking.
    pub(crate) fn into_memory(self) -> Vec<u8> {
        self.0
    }
}

/// Parses a record by its opcode; returns `None` if it is malformed or of a kind that is not
/// used.
pub(crate) fn parse(opcode: u8, body: &[u8]) -> Option<Record<'_>> {
    strings_fit(opcode, body)?;
    mcap::parse_record(opcode, body).ok()
}

/// Returns `Some` if the strings of a record fit into it: the parser allocates what they claim,
/// up to 4 GB, before it checks their length.
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
        op::CHUNK_INDEX => return chunk_index_fits(body),
        op::FOOTER | op::MESSAGE | op::STATISTICS | op::DATA_END => return Some(()),
        _ => return None,
    };
    let mut rest = body.get(fixed..)?;
    for _ in 0..strings {
        let (long, after) = length(rest)?;
        rest = after.get(long..)?;
    }
    if opcode == op::ATTACHMENT {
        // The parser does not check that length of the data and checksum are there.
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

/// Returns `Some` if the map and the string of an entry of the index fit into it.
fn chunk_index_fits(body: &[u8]) -> Option<()> {
    let skip = |bytes: &'_ [u8]| -> Option<usize> {
        let long = u32::from_le_bytes(*bytes.first_chunk()?);
        usize::try_from(long).ok()?.checked_add(4)
    };
    // Times, place and length of the chunk; places of its messages; their length.
    let places = body.get(32..)?;
    let rest = places.get(skip(places)?..)?.get(8..)?;
    // The compression, and two lengths.
    rest.get(skip(rest)?..)?.get(..16).map(drop)
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
    // 0: the writer computed none.
    if header.uncompressed_crc != 0 && header.uncompressed_crc != crc32fast::hash(&records) {
        return Err(BadChunk::Checksum);
    }
    Ok(Chunk(records))
}

/// Reads the output of a decoder into `memory`, at most one byte more than expected.
fn read_all(decoder: impl Read, expected: u64, mut memory: Vec<u8>) -> io::Result<Vec<u8>> {
    memory.clear();
    decoder.take(expected + 1).read_to_end(&mut memory)?;
    Ok(memory)
}

/// Returns opcode and body of the first record, and the bytes after it; `None` if the record
/// is cut off.
fn split_record(records: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (&opcode, after) = records.split_first()?;
    let (length, after) = after.split_first_chunk::<8>()?;
    let length = usize::try_from(u64::from_le_bytes(*length)).ok()?;
    let (body, after) = after.split_at_checked(length)?;
    Some((opcode, body, after))
}
