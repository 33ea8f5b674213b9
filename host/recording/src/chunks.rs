//! The chunks of an MCAP file, front to back, up to where it breaks off.
//!
//! ```no_run
//! # fn show(path: &std::path::Path) -> Result<(), Box<dyn std::error::Error>> {
//! use recording::chunks::{Chunks, OWN_RATIO};
//! let mut chunks = Chunks::open(path, OWN_RATIO)?;
//! let mut memory = Vec::new();
//! while let Some(packed) = chunks.next_packed()? {
//!     // Here, or in another thread: reading and unpacking are apart.
//!     let chunk = packed.unpack(memory)?;
//!     for (opcode, body) in chunk.records() {
//!         println!("{opcode}: {} bytes", body.len());
//!     }
//!     memory = chunk.into_memory();
//! }
//! # Ok(())
//! # }
//! ```
//!
//! Memory is bounded by the file's length and by 20 MiB of each chunk, packed and
//! unpacked, time by the file's length ([`Budget`]), whatever the file claims. For files
//! that are damaged in the middle there is [`super::scan`].
//!
//! Limits: chunks are stored as they are, with LZ4, which is all that this program writes,
//! or with Zstandard, as other programs do.

use std::borrow::Cow;
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;

use mcap::McapError;
use mcap::records::{ChunkHeader, Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};

/// The longest record that is taken: a chunk that could not be packed, with its head.
pub(crate) const MAX_RECORD: u64 = MAX_CHUNK + (1 << 16);

/// The largest chunk when unpacked: above the 16 MiB at which a writer of this program
/// closes one, if half a second has not done so.
const MAX_CHUNK: u64 = 20 << 20;

/// What a file may unpack to in all: this much, and so many times the bytes that it has
/// up to there.
const MAX_UNPACKED: u64 = 64 << 20;

/// How many times its length a recording of this program may unpack to; they unpack to 2.1
/// to 2.6 times theirs.
pub const OWN_RATIO: u64 = 16;

/// The same of a bag of any program: LZ4 packs pictures without any depth to a 250th,
/// others to some quarter.
pub const FOREIGN_RATIO: u64 = 64;

/// Opcode and length before the body of a record.
const HEAD: usize = 9;

/// How much of the name of an unknown compression is told.
const SHOWN_NAME: usize = 16;

/// Why no further chunk can be read.
#[derive(Debug, thiserror::Error)]
pub enum ChunksError {
    /// The file cannot be read.
    #[error(transparent)]
    Read(io::Error),
    /// The file ends within a record: its writer did not come to its end.
    #[error("the file ends within a record")]
    CutOff,
    /// It is no MCAP file, or none from here on.
    #[error(transparent)]
    Mcap(McapError),
}

/// Why a chunk cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum BadChunk {
    /// Its head is not one.
    #[error("its head cannot be read")]
    Head,
    /// It is longer than any real one.
    #[error("it claims {0} bytes, more than any real one holds")]
    TooLarge(u64),
    /// A compression that this program does not know.
    #[error("it is packed with {0:?}; expected lz4, zstd or nothing")]
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
    #[error("the file unpacks to more than {0} times its length, which no recording does")]
    Budget(u64),
}

/// What the chunks of a file have unpacked to, so that a small file costs little time.
///
/// A file may unpack to 64 MiB, and to a multiple of the bytes that were read of it.
#[derive(Debug)]
pub struct Budget {
    ratio: u64,
    unpacked: u64,
}

impl Budget {
    /// For a file that may unpack to `ratio` times its length.
    #[must_use]
    pub const fn new(ratio: u64) -> Self {
        Self { ratio, unpacked: 0 }
    }

    /// Whether a chunk of so many bytes fits, in a file that was read up to `position`.
    pub const fn takes(&mut self, unpacked: u64, position: u64) -> bool {
        let most = position.saturating_mul(self.ratio);
        let total = self.unpacked.saturating_add(unpacked);
        let fits = total <= most.saturating_add(MAX_UNPACKED);
        if fits {
            self.unpacked = total;
        }
        fits
    }

    /// The same of a chunk of an MCAP file, by its head.
    pub(crate) fn takes_chunk(
        &mut self,
        header: &ChunkHeader,
        position: u64,
    ) -> Result<(), BadChunk> {
        // One that claims more than any is refused for that.
        let unpacked = header.uncompressed_size.min(MAX_CHUNK);
        let fits = self.takes(unpacked, position);
        fits.then_some(()).ok_or(BadChunk::Budget(self.ratio))
    }
}

/// The chunks of a file.
pub struct Chunks {
    reader: LinearReader,
    file: BufReader<File>,
    position: u64,
    budget: Budget,
    data_complete: bool,
    ended: bool,
}

/// A chunk as it stands in the file.
pub struct Packed(Content);

enum Content {
    Chunk(ChunkHeader, Vec<u8>),
    /// A record outside of chunks, as the only one of a chunk.
    Record(Vec<u8>),
    Bad(BadChunk),
}

/// The records of a chunk whose checksum is right.
#[derive(Debug)]
pub struct Chunk(pub(crate) Vec<u8>);

impl Chunks {
    /// Begins at the front of a file that may unpack to `ratio` times its length.
    ///
    /// # Errors
    ///
    /// It cannot be opened.
    pub fn open(path: &Path, ratio: u64) -> io::Result<Self> {
        let file = files::open(path)?;
        // A record longer than the file is none.
        let limit = file.metadata()?.len().min(MAX_RECORD);
        let options = LinearReaderOptions::default()
            .with_skip_end_magic(true)
            .with_emit_chunks(true)
            .with_record_length_limit(usize::try_from(limit).unwrap_or(usize::MAX));
        Ok(Self {
            reader: LinearReader::new_with_options(options),
            file: BufReader::with_capacity(1 << 20, file),
            position: 0,
            budget: Budget::new(ratio),
            data_complete: false,
            ended: false,
        })
    }

    /// Bytes of the file that were read so far.
    #[must_use]
    pub const fn position(&self) -> u64 {
        self.position
    }

    /// Whether the record that closes the data was met: only index and statistics
    /// follow, and if the file breaks off there, no message is missing.
    #[must_use]
    pub const fn data_complete(&self) -> bool {
        self.data_complete
    }

    /// The next chunk; `None` behind the last. A type, topic or message outside of chunks
    /// comes as a chunk of its own.
    ///
    /// # Errors
    ///
    /// The file breaks off here, or cannot be read; nothing more comes then.
    pub fn next_packed(&mut self) -> Result<Option<Packed>, ChunksError> {
        while !self.ended {
            let event = match self.reader.next_event() {
                None => break,
                Some(Ok(event)) => event,
                Some(Err(error)) => {
                    self.ended = true;
                    return Err(if is_end(&error) {
                        ChunksError::CutOff
                    } else {
                        ChunksError::Mcap(error)
                    });
                }
            };
            match event {
                LinearReadEvent::ReadRequest(need) => {
                    let space = self.reader.insert(need);
                    let count = self.file.read(space).map_err(|error| {
                        self.ended = true;
                        ChunksError::Read(error)
                    })?;
                    self.position += count as u64;
                    self.reader.notify_read(count);
                }
                LinearReadEvent::Record { data, opcode } => match opcode {
                    op::CHUNK => {
                        let content = content_of(data, &mut self.budget, self.position);
                        return Ok(Some(Packed(content)));
                    }
                    op::SCHEMA | op::CHANNEL | op::MESSAGE => {
                        let record = Content::Record(whole_record(opcode, data));
                        return Ok(Some(Packed(record)));
                    }
                    op::DATA_END => self.data_complete = true,
                    _ => {}
                },
            }
        }
        self.ended = true;
        Ok(None)
    }
}

impl Packed {
    /// Bytes that it holds in memory once it is unpacked.
    #[must_use]
    pub fn size(&self) -> u64 {
        match &self.0 {
            // A chunk that claims more is refused.
            Content::Chunk(header, data) => {
                let unpacked = header.uncompressed_size.min(MAX_CHUNK);
                unpacked.max(data.len() as u64)
            }
            Content::Record(data) => data.len() as u64,
            Content::Bad(_) => 0,
        }
    }

    /// Board time in nanoseconds of its first message, as its head says.
    #[must_use]
    pub fn starts_at(&self) -> Option<u64> {
        match &self.0 {
            Content::Chunk(header, _) => Some(header.message_start_time),
            Content::Record(_) | Content::Bad(_) => None,
        }
    }

    /// Unpacks and checks it, in `memory` if it is packed.
    ///
    /// # Errors
    ///
    /// It cannot be unpacked, or is not what its writer made.
    pub fn unpack(self, memory: Vec<u8>) -> Result<Chunk, BadChunk> {
        match self.0 {
            Content::Chunk(header, data) => unpack(&header, data.into(), memory),
            Content::Record(record) => Ok(Chunk(record)),
            Content::Bad(why) => Err(why),
        }
    }
}

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

    /// Bytes behind the last whole record, which claims more than there are.
    #[must_use]
    pub fn cut_off(&self) -> usize {
        let whole = self.records().map(|(_, body)| HEAD + body.len());
        self.0.len() - whole.sum::<usize>()
    }

    /// The memory, for the next chunk: asking the system for it anew costs as much as
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

/// Head and packed records from the body of a chunk's record.
fn content_of(body: &[u8], budget: &mut Budget, position: u64) -> Content {
    let Some(Record::Chunk { header, data }) = parse(op::CHUNK, body) else {
        return Content::Bad(BadChunk::Head);
    };
    match budget.takes_chunk(&header, position) {
        Ok(()) => Content::Chunk(header, data.into_owned()),
        Err(why) => Content::Bad(why),
    }
}

fn whole_record(opcode: u8, body: &[u8]) -> Vec<u8> {
    let mut record = Vec::with_capacity(HEAD + body.len());
    record.push(opcode);
    record.extend_from_slice(&(body.len() as u64).to_le_bytes());
    record.extend_from_slice(body);
    record
}

/// Whether an error of the reader means that the file ends within a record.
fn is_end(error: &McapError) -> bool {
    match error {
        McapError::UnexpectedEof => true,
        // Longer than the file, then.
        McapError::RecordTooLarge { len, .. } => *len <= MAX_RECORD,
        McapError::Io(error) => error.kind() == io::ErrorKind::UnexpectedEof,
        _ => false,
    }
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
        "zstd" => ruzstd::decoding::StreamingDecoder::new(packed.as_ref())
            .map_err(io::Error::other)
            .and_then(|decoder| read_all(decoder, expected, memory))
            .map_err(BadChunk::Packing)?,
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
pub(crate) fn split_record(records: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (&opcode, after) = records.split_first()?;
    let (length, after) = after.split_first_chunk::<8>()?;
    let length = usize::try_from(u64::from_le_bytes(*length)).ok()?;
    let (body, after) = after.split_at_checked(length)?;
    Some((opcode, body, after))
}
