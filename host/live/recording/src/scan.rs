//! Scans the records of an MCAP file over any damage, with bounded memory.
//!
//! The recovery of the `mcap` library stops at the first damage, because the library has no
//! function that finds the next record, and it does not report positions in bytes. This scan
//! continues: where bytes are not records, it searches for the next chunk, which is recognised by
//! a head that fits its length (and later by its checksum). So a flipped length costs one chunk
//! and not the rest of the file.
//!
//! Limits: chunks are uncompressed or LZ4, as this program writes them. If damage turns a record
//! outside of a chunk into another valid one, only the checksum over the whole file shows it.

use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use mcap::records::{ChunkHeader, Record, op};
use system::{Input, ReadMonitor, Sparse as _};

use super::chunks::{self, Budget, Chunk, MAX_RECORD};
use super::damage::{Damage, FileReport};
use super::index::ChunkPlace;
use super::ticks_of_nanos;

/// Bytes of opcode and length before each record.
const HEAD: u64 = 9;

/// Length of the footer, the last record of a file, bytes.
const FOOTER: u64 = 20;

/// Bytes that are searched at a time.
const WINDOW: usize = 1 << 16;

/// Longest head of a chunk with opcode, length and name of the compression, bytes.
const CHUNK_HEAD: usize = 9 + 8 + 8 + 8 + 4 + 4 + MAX_NAME + 8;

/// Longest name of a compression that is accepted, bytes.
const MAX_NAME: usize = 8;

/// Part of the file.
#[derive(Debug)]
pub(crate) enum Piece {
    /// Records of a chunk whose checksum is right.
    Chunk(Chunk, ChunkPlace),
    /// A record outside of chunks: its opcode and body.
    Record(u8, Vec<u8>),
    /// A part that cannot be read, or whose checksum is wrong.
    Damage(Damage),
    /// The end of a file that its writer closed.
    End,
}

/// Position of the scan.
pub(crate) struct Scan {
    file: BufReader<Input>,
    /// State of the file so far; the messages are counted by the caller.
    pub(crate) report: FileReport,
    position: u64,
    budget: Budget,
    /// Memory for the next chunk.
    memory: Vec<u8>,
    /// End of the bytes that were searched for heads of chunks, and found to have none but `head`.
    searched: u64,
    head: Option<u64>,
    /// Checksum over everything since the beginning, later since the record that closes the data;
    /// `None` once a part was skipped.
    hasher: Option<crc32fast::Hasher>,
    has_footer: bool,
    /// False if the file does not begin as MCAP files do, and its first bytes are skipped.
    has_magic: bool,
    ended: bool,
}

impl Scan {
    /// Opens a file.
    ///
    /// # Errors
    ///
    /// Returns an error if it cannot be opened.
    pub(crate) fn open(path: &Path, monitor: &ReadMonitor) -> io::Result<Self> {
        let file = system::open(path, monitor)?;
        let length = file.length();
        Ok(Self {
            file: BufReader::with_capacity(1 << 20, file),
            report: FileReport {
                bytes: length,
                ..FileReport::default()
            },
            position: 0,
            budget: Budget::default(),
            memory: Vec::new(),
            searched: 0,
            head: None,
            hasher: Some(crc32fast::Hasher::new()),
            has_footer: false,
            has_magic: true,
            ended: false,
        })
    }

    /// Returns true if the file begins as MCAP files do.
    pub(crate) const fn has_magic(&self) -> bool {
        self.has_magic
    }

    /// Keeps the memory of a chunk for the next one: a new allocation costs as much as unpacking.
    pub(crate) fn reuse(&mut self, chunk: Chunk) {
        self.memory = chunk.into_memory();
    }

    /// Returns the next piece; `None` after the last.
    ///
    /// # Errors
    ///
    /// Returns an error if the file cannot be read.
    pub(crate) fn next_piece(&mut self) -> io::Result<Option<Piece>> {
        let piece = self.read_piece()?;
        let report = &mut self.report;
        match &piece {
            Some(Piece::Chunk(..)) => report.chunks += 1,
            Some(Piece::End) => report.closed = true,
            Some(Piece::Damage(Damage::Chunk { .. })) => report.bad_chunks += 1,
            Some(Piece::Damage(Damage::CutOff { at, .. })) => report.cut_off_at = Some(*at),
            Some(Piece::Damage(Damage::Bytes { from, to })) => {
                self.has_magic &= *from > 0;
                report.skipped_bytes += to - from;
            }
            _ => {}
        }
        Ok(piece)
    }

    fn read_piece(&mut self) -> io::Result<Option<Piece>> {
        if self.ended {
            return Ok(None);
        }
        // Once the magic was missed, a chunk may begin at byte 0.
        if self.position == 0 && self.hasher.is_some() {
            let magic = self.read_bytes(mcap::MAGIC.len() as u64)?;
            if let Some(hasher) = &mut self.hasher {
                hasher.update(&magic);
            }
            if magic != *mcap::MAGIC {
                // A chunk may begin here.
                return self.search(0, 0).map(Some);
            }
        }
        if self.has_footer {
            return self.after_footer().map(Some);
        }
        let at = self.position;
        let rest = self.report.bytes.saturating_sub(at);
        if rest < HEAD {
            self.ended = true;
            return Ok(Some(self.cut_off(at)));
        }
        let (opcode, length) = self.peek_head()?;
        let fits = length <= MAX_RECORD
            && length <= rest - HEAD
            && match opcode {
                // A record that ends the scan must have the right length.
                op::FOOTER => length == FOOTER && rest <= HEAD + FOOTER + 8,
                op::DATA_END => length == 4,
                _ => true,
            };
        // A chunk begins with a head that fits, and no other record has such a head
        // inside. So the scan never goes back, and its time grows with the length of the file.
        let fits = fits
            && match self.next_head(at, at + HEAD + length)? {
                Some(head) => opcode == op::CHUNK && head == at,
                None => opcode != op::CHUNK,
            };
        if !(op::HEADER..=op::DATA_END).contains(&opcode) || !fits {
            // A record whose writer was killed looks like this too, if nothing comes after it.
            let plausible = (op::HEADER..=op::DATA_END).contains(&opcode) && length <= MAX_RECORD;
            return match self.search(at, at + 1)? {
                Piece::Damage(Damage::Bytes { to, .. }) if to == self.report.bytes && plausible => {
                    Ok(Some(self.cut_off(at)))
                }
                piece => Ok(Some(piece)),
            };
        }
        let data_crc = match opcode {
            op::DATA_END => self.hasher.take().map(crc32fast::Hasher::finalize),
            _ => None,
        };
        let record = self.read_bytes(HEAD + length)?;
        let body = record.get(HEAD as usize..).unwrap_or_default();
        if let Some(hasher) = &mut self.hasher {
            // The footer's own checksum is its last four bytes.
            let covered = record.len()
                - if opcode == op::FOOTER {
                    4.min(record.len())
                } else {
                    0
                };
            hasher.update(record.get(..covered).unwrap_or_default());
        }
        match opcode {
            op::CHUNK => {
                let Some((header, packed)) = chunk_of(body) else {
                    return self.search(at, at + 1).map(Some);
                };
                let fits = self.budget.spend(&header, self.position);
                let memory = std::mem::take(&mut self.memory);
                let chunk = fits.and_then(|()| chunks::unpack(&header, packed.into(), memory));
                return Ok(Some(match chunk {
                    Ok(chunk) => Piece::Chunk(chunk, ChunkPlace::new(at, HEAD + length, &header)),
                    Err(why) => Piece::Damage(Damage::Chunk {
                        at,
                        why,
                        from: ticks_of_nanos(header.message_start_time),
                    }),
                }));
            }
            op::DATA_END => {
                self.report.data_complete = true;
                self.hasher = data_crc.map(|_| crc32fast::Hasher::new());
                if let (Some(Record::DataEnd(end)), Some(crc)) =
                    (chunks::parse(opcode, body), data_crc)
                    && ![0, crc].contains(&end.data_section_crc)
                {
                    return Ok(Some(Piece::Damage(Damage::DataChecksum)));
                }
            }
            op::FOOTER => {
                self.has_footer = true;
                let crc = self.hasher.take().map(crc32fast::Hasher::finalize);
                if let (Some(Record::Footer(footer)), Some(crc)) =
                    (chunks::parse(opcode, body), crc)
                    && ![0, crc].contains(&footer.summary_crc)
                {
                    return Ok(Some(Piece::Damage(Damage::IndexChecksum)));
                }
            }
            _ => {}
        }
        Ok(Some(Piece::Record(opcode, body.to_vec())))
    }

    /// Checks that the magic follows the footer, and nothing else.
    fn after_footer(&mut self) -> io::Result<Piece> {
        self.ended = true;
        let at = self.position;
        let rest = self.report.bytes.saturating_sub(at);
        if rest == mcap::MAGIC.len() as u64 && self.read_bytes(rest)? == *mcap::MAGIC {
            return Ok(Piece::End);
        }
        if rest < mcap::MAGIC.len() as u64 {
            return Ok(self.cut_off(at));
        }
        let to = self.report.bytes;
        Ok(Piece::Damage(Damage::Bytes { from: at, to }))
    }

    /// Returns the damage of a file whose whole records end at byte `at`.
    const fn cut_off(&self, at: u64) -> Piece {
        Piece::Damage(Damage::CutOff {
            at,
            length: self.report.bytes,
            complete: self.report.data_complete,
        })
    }

    /// Returns opcode and length of the next record, without moving on.
    fn peek_head(&mut self) -> io::Result<(u8, u64)> {
        let mut head = [0; HEAD as usize];
        self.file.read_exact(&mut head)?;
        self.file.seek_relative(-(HEAD as i64))?;
        let [opcode, length @ ..] = head;
        Ok((opcode, u64::from_le_bytes(length)))
    }

    fn read_bytes(&mut self, length: u64) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        (&mut self.file).take(length).read_to_end(&mut bytes)?;
        self.position += bytes.len() as u64;
        Ok(bytes)
    }

    /// Skips from byte `from` to the first chunk at or after byte `first`, or to the end.
    fn search(&mut self, from: u64, first: u64) -> io::Result<Piece> {
        let found = self.next_head(first, self.report.bytes)?;
        // The checksum over everything is meaningless from here on.
        self.hasher = None;
        self.ended = found.is_none();
        let to = found.unwrap_or(self.report.bytes);
        self.position = to;
        self.file.seek(SeekFrom::Start(to))?;
        let from = from.min(to);
        Ok(Piece::Damage(Damage::Bytes { from, to }))
    }

    /// Returns the byte in `from..until` at which the first chunk begins, without moving on.
    /// `from` must not decrease from call to call.
    fn next_head(&mut self, from: u64, until: u64) -> io::Result<Option<u64>> {
        self.head.take_if(|head| *head < from);
        self.searched = self.searched.max(from);
        let mut window = Vec::new();
        while self.head.is_none() && self.searched < until {
            // A head begins with a byte other than zero, so not in a hole of the file.
            let start = self.file.next_data(self.searched)?;
            if start >= until {
                self.searched = until;
                break;
            }
            window.clear();
            let ahead = start as i64 - self.position as i64;
            // The buffer keeps the bytes that were read ahead.
            self.file.seek_relative(ahead)?;
            (&mut self.file)
                .take((WINDOW + CHUNK_HEAD) as u64)
                .read_to_end(&mut window)?;
            self.file.seek_relative(-ahead - window.len() as i64)?;
            let hit = (0..window.len().min(WINDOW)).find(|&index| {
                let rest = self.report.bytes - start - index as u64;
                let bytes = window.get(index..);
                bytes.is_some_and(|bytes| is_chunk_head(bytes, rest))
            });
            self.head = hit.map(|index| start + index as u64);
            self.searched = start + hit.map_or(WINDOW as u64, |index| index as u64 + 1);
        }
        Ok(self.head.filter(|head| *head < until))
    }
}

/// Returns true if a chunk begins here: its head must fit the length of its record.
fn is_chunk_head(bytes: &[u8], rest: u64) -> bool {
    let inner = || -> Option<bool> {
        let (&opcode, bytes) = bytes.split_first()?;
        if opcode != op::CHUNK {
            return Some(false);
        }
        let (length, bytes) = bytes.split_first_chunk::<8>()?;
        let length = u64::from_le_bytes(*length);
        let (_, bytes) = bytes.split_first_chunk::<28>()?;
        let (name, bytes) = bytes.split_first_chunk::<4>()?;
        let name = usize::try_from(u32::from_le_bytes(*name)).ok()?;
        if name > MAX_NAME || std::str::from_utf8(bytes.get(..name)?).is_err() {
            return Some(false);
        }
        let size = bytes.get(name..)?.first_chunk::<8>()?;
        let size = u64::from_le_bytes(*size);
        Some(
            length <= MAX_RECORD
                && length + HEAD <= rest
                && size.checked_add(40 + name as u64) == Some(length),
        )
    };
    inner().unwrap_or(false)
}

/// Returns head and packed bytes of a chunk, if they fit each other.
fn chunk_of(body: &[u8]) -> Option<(ChunkHeader, &[u8])> {
    let Some(Record::Chunk { header, .. }) = chunks::parse(op::CHUNK, body) else {
        return None;
    };
    let name = header.compression.len();
    let packed = body.get(40 + name..)?;
    (name <= MAX_NAME && packed.len() as u64 == header.compressed_size).then_some((header, packed))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_begins_with_a_chunk_has_an_end() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("headless.mcap");
        let mut bytes = vec![op::CHUNK];
        bytes.extend(40_u64.to_le_bytes());
        bytes.resize(69, 0);
        std::fs::write(&path, bytes).unwrap();
        let mut scan = Scan::open(&path, &ReadMonitor::default()).unwrap();
        let pieces = std::iter::from_fn(|| scan.next_piece().unwrap());
        assert!(pieces.take(9).count() < 9);
    }
}
