//! EBML primitives (RFC 8794): element IDs, sizes, and values.
//!
//! Everything works on a [`Source`] with a known end, so that a size that a
//! file claims is checked against what is there before memory is asked for.

use std::io::{self, Read as _, SeekFrom};

use system::Sparse;

/// Why an element could not be read.
#[derive(Debug, thiserror::Error)]
pub enum EbmlError {
    /// Reading failed.
    #[error("reading the file: {0}")]
    Io(#[from] io::Error),
    /// The file ends within an element.
    #[error("the file ends within an element that begins at byte {at}")]
    Truncated {
        /// Where the element begins.
        at: u64,
    },
    /// These bytes are no element ID or size.
    #[error("no EBML element at byte {at}: {what}")]
    Invalid {
        /// Where.
        at: u64,
        /// What was wrong.
        what: &'static str,
    },
    /// An element that is held in memory is larger than it may be.
    #[error(
        "the element at byte {at} has {size} bytes, more than the {limit} allowed for its kind"
    )]
    TooLarge {
        /// Where.
        at: u64,
        /// What it claims.
        size: u64,
        /// The limit.
        limit: u64,
    },
}

/// Bytes of the longest head.
const LONGEST_HEAD: u64 = 12;

/// The head of an element.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Head {
    /// The ID with its marker bits, as the Matroska specification writes it.
    pub(crate) id: u32,
    /// Size of the data; `None`: until an element of a higher level, or the end of the
    /// file.
    pub(crate) size: Option<u64>,
    /// Position of the first byte of the head.
    pub(crate) at: u64,
    /// Position of the first byte of the data.
    pub(crate) data: u64,
    /// As it stands in the file.
    pub(crate) bytes: Vec<u8>,
}

impl Head {
    /// The first position after the element; `None` for an unknown size or one
    /// that no file can have.
    pub(crate) fn end(&self) -> Option<u64> {
        self.data.checked_add(self.size?)
    }
}

/// Length of the ID, or `None` for a first byte that begins none.
fn id_length(first: u8) -> Option<usize> {
    let length = first.leading_zeros() as usize + 1;
    (length <= 4).then_some(length)
}

/// A reader that knows its position and length.
pub(crate) struct Source<R> {
    reader: R,
    position: u64,
    length: u64,
}

impl<R: Sparse> Source<R> {
    /// Takes the reader from its beginning to its present end.
    ///
    /// # Errors
    ///
    /// Seeking fails.
    pub(crate) fn new(mut reader: R) -> io::Result<Self> {
        let length = reader.seek(SeekFrom::End(0))?;
        reader.seek(SeekFrom::Start(0))?;
        Ok(Self {
            reader,
            position: 0,
            length,
        })
    }

    /// The position of the next byte.
    pub(crate) fn position(&self) -> u64 {
        self.position
    }

    /// Bytes in all.
    pub(crate) fn length(&self) -> u64 {
        self.length
    }

    /// Bytes from here to the end.
    pub(crate) fn remaining(&self) -> u64 {
        self.length.saturating_sub(self.position)
    }

    /// Moves to a position, at most to the end.
    ///
    /// # Errors
    ///
    /// Seeking fails.
    pub(crate) fn seek(&mut self, position: u64) -> io::Result<()> {
        let position = position.min(self.length);
        // No file is longer than an i64 can say.
        let distance = position.wrapping_sub(self.position) as i64;
        self.reader.seek_relative(distance)?;
        self.position = position;
        Ok(())
    }

    /// Reads `size` bytes into `out` (its old content is lost).
    ///
    /// Memory grows with what is read, not with what is claimed.
    ///
    /// # Errors
    ///
    /// More than `limit`, or the file ends before.
    pub(crate) fn read_into(
        &mut self,
        size: u64,
        limit: u64,
        out: &mut Vec<u8>,
    ) -> Result<(), EbmlError> {
        let at = self.position;
        if size > limit {
            return Err(EbmlError::TooLarge { at, size, limit });
        }
        if size > self.remaining() {
            return Err(EbmlError::Truncated { at });
        }
        out.clear();
        let read = (&mut self.reader).take(size).read_to_end(out)? as u64;
        self.position += read;
        if read < size {
            return Err(EbmlError::Truncated { at });
        }
        Ok(())
    }

    /// Reads an element's head. `None` at the end of the file.
    ///
    /// # Errors
    ///
    /// The bytes are no head, or the file ends within it. The position is then after
    /// the first byte.
    pub(crate) fn head(&mut self) -> Result<Option<Head>, EbmlError> {
        let at = self.position;
        let length = self.remaining().min(LONGEST_HEAD);
        let mut bytes = Vec::new();
        self.read_into(length, LONGEST_HEAD, &mut bytes)?;
        let Some(&first) = bytes.first() else {
            return Ok(None);
        };
        let parts = memory_id(&bytes).and_then(|(id, rest)| Some((id, variable(rest)?)));
        let Some((id, (size, rest))) = parts else {
            self.seek(at + 1)?;
            let size = id_length(first).map(|length| bytes.get(length));
            return Err(match size {
                None => EbmlError::Invalid {
                    at,
                    what: "the first byte begins no element ID",
                },
                Some(Some(0)) => EbmlError::Invalid {
                    at,
                    what: "the size is longer than eight bytes",
                },
                Some(_) => EbmlError::Truncated { at },
            });
        };
        bytes.truncate(bytes.len() - rest.len());
        let data = at + bytes.len() as u64;
        self.seek(data)?;
        Ok(Some(Head {
            id,
            size,
            at,
            data,
            bytes,
        }))
    }

    /// Moves on to the next place where the bytes of `id` stand, at or after
    /// `from`. False (and at the end of the file) if there is none.
    ///
    /// # Errors
    ///
    /// Reading fails.
    pub(crate) fn find(&mut self, id: u32, from: u64) -> io::Result<bool> {
        self.seek(from)?;
        let pattern = id.to_be_bytes();
        let mut block = vec![0_u8; 64 * 1024];
        // The last three bytes of the block before, so that no place is missed.
        let mut kept = 0;
        loop {
            // It begins with a byte that is not zero: in no hole.
            let data = self.reader.next_data(self.position)?;
            if data > self.position {
                self.seek(data)?;
                kept = 0;
            }
            let read = self.reader.read(&mut block[kept..])?;
            self.position += read as u64;
            let filled = kept + read;
            if let Some(index) = block[..filled].windows(4).position(|four| four == pattern) {
                let found = self.position - (filled - index) as u64;
                self.seek(found)?;
                return Ok(true);
            }
            if read == 0 {
                return Ok(false);
            }
            let keep = filled.min(3);
            block.copy_within(filled - keep..filled, 0);
            kept = keep;
        }
    }
}

/// An unsigned integer of at most eight bytes.
pub(crate) fn unsigned(data: &[u8]) -> Option<u64> {
    let next = |value, &byte: &u8| value << 8 | u64::from(byte);
    (data.len() <= 8).then(|| data.iter().fold(0, next))
}

/// UTF-8 text without the zeros that may follow it; wrong bytes are replaced.
pub(crate) fn text(data: &[u8]) -> String {
    let text = data.split(|&byte| byte == 0).next();
    String::from_utf8_lossy(text.unwrap_or_default()).into_owned()
}

/// The content of the first element of an ID in a master element that is in memory.
pub(crate) fn child(data: &[u8], id: u32) -> Option<&[u8]> {
    all(data, id).next()
}

/// The content of all elements of an ID in a master element that is in memory.
pub(crate) fn all(data: &[u8], id: u32) -> impl Iterator<Item = &[u8]> {
    let of_id = children(data).filter(move |(child, _)| *child == id);
    of_id.map(|(_, data)| data)
}

/// The elements of a master element that is in memory; stops at the first that
/// is broken or goes beyond the end.
fn children(data: &[u8]) -> impl Iterator<Item = (u32, &[u8])> {
    let mut rest = data;
    std::iter::from_fn(move || {
        let (id, after) = memory_id(rest)?;
        let (size, after) = variable(after)?;
        let size = usize::try_from(size?).ok()?;
        let data = after.get(..size)?;
        rest = &after[size..];
        Some((id, data))
    })
}

fn memory_id(data: &[u8]) -> Option<(u32, &[u8])> {
    let length = id_length(*data.first()?)?;
    let id = unsigned(data.get(..length)?)? as u32;
    Some((id, &data[length..]))
}

/// A variable-length integer and what follows it; the inner `None` is the
/// reserved value of all ones (unknown).
pub(crate) fn variable(data: &[u8]) -> Option<(Option<u64>, &[u8])> {
    let first = *data.first()?;
    let length = first.leading_zeros() as usize + 1;
    if length > 8 {
        return None;
    }
    let ones = (1_u64 << (7 * length)) - 1;
    let value = unsigned(data.get(..length)?)? & ones;
    Some(((value != ones).then_some(value), &data[length..]))
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    fn head_of(bytes: &[u8]) -> Head {
        Source::new(Cursor::new(bytes))
            .unwrap()
            .head()
            .unwrap()
            .unwrap()
    }

    #[test]
    fn heads_have_sizes_of_every_length() {
        let head = head_of(&[0x1A, 0x45, 0xDF, 0xA3, 0x9F]);
        assert_eq!((head.id, head.size, head.data), (0x1A45_DFA3, Some(31), 5));
        assert_eq!(head_of(&[0xEC, 0x40, 0x02]).size, Some(2));
        assert_eq!(head_of(&[0xEC, 0xFF]).size, None);
        let eight = head_of(&[0xEC, 0x01, 0, 0, 0, 0, 0, 1, 0]);
        assert_eq!(eight.size, Some(256));
        let unknown = head_of(&[0xEC, 0x01, 255, 255, 255, 255, 255, 255, 255]);
        assert_eq!(unknown.size, None);
    }

    #[test]
    fn what_is_no_head_is_said() {
        let read = |bytes: &'static [u8]| Source::new(Cursor::new(bytes)).unwrap().head();
        assert!(matches!(read(&[]), Ok(None)));
        assert!(matches!(
            read(&[0x00]),
            Err(EbmlError::Invalid { at: 0, .. })
        ));
        assert!(matches!(
            read(&[0xEC, 0x00]),
            Err(EbmlError::Invalid { .. })
        ));
        assert!(matches!(
            read(&[0x1A, 0x45]),
            Err(EbmlError::Truncated { at: 0 })
        ));
    }

    #[test]
    fn a_claimed_size_is_checked_before_memory_is_used() {
        let mut source = Source::new(Cursor::new(vec![0_u8; 10])).unwrap();
        let mut out = Vec::new();
        assert!(matches!(
            source.read_into(u64::MAX, u64::MAX, &mut out),
            Err(EbmlError::Truncated { at: 0 })
        ));
        assert!(matches!(
            source.read_into(9, 8, &mut out),
            Err(EbmlError::TooLarge {
                size: 9,
                limit: 8,
                ..
            })
        ));
        assert_eq!(out.capacity(), 0);
    }

    #[test]
    fn a_pattern_over_a_block_border_is_found() {
        let mut bytes = vec![0_u8; 64 * 1024 - 2];
        bytes.extend_from_slice(&[0x1F, 0x43, 0xB6, 0x75, 1]);
        let mut source = Source::new(Cursor::new(&bytes)).unwrap();
        assert!(source.find(0x1F43_B675, 7).unwrap());
        assert_eq!(source.position(), 64 * 1024 - 2);
        assert!(!source.find(0x1F43_B675, 64 * 1024 - 1).unwrap());
    }
}
