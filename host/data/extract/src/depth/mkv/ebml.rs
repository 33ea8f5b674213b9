//! EBML primitives (RFC 8794): element IDs, sizes, and values.
//!
//! Everything works on a [`Source`] with a known end, so that a size claimed by a
//! file is checked against its length before memory is allocated.

use std::io::{self, Read as _, SeekFrom};

use system::Sparse;

/// Reason why an element cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum EbmlError {
    /// Reading failed.
    #[error("reading the file: {0}")]
    Io(#[from] io::Error),
    /// The file ends within an element.
    #[error("the file ends within an element that begins at byte {at}")]
    Truncated {
        /// Position of the element.
        at: u64,
    },
    /// The bytes are not element ID or size.
    #[error("no EBML element at byte {at}: {what}")]
    Invalid {
        /// Position of the bytes.
        at: u64,
        /// Description of the fault.
        what: &'static str,
    },
    /// An element to be read into memory is larger than allowed.
    #[error(
        "the element at byte {at} has {size} bytes, more than the {limit} allowed for its kind"
    )]
    TooLarge {
        /// Position of the element.
        at: u64,
        /// Claimed size, bytes.
        size: u64,
        /// Largest allowed size, bytes.
        limit: u64,
    },
}

/// Length of the longest head, bytes.
const LONGEST_HEAD: u64 = 12;

/// Head of an element.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Head {
    /// ID with its marker bits, as in the Matroska specification.
    pub(crate) id: u32,
    /// Size of the data, bytes; `None` if it extends to an element of a higher level or the end
    /// of the file.
    pub(crate) size: Option<u64>,
    /// Position of the first byte of the head.
    pub(crate) at: u64,
    /// Position of the first byte of the data.
    pub(crate) data: u64,
    /// Bytes of the head.
    pub(crate) bytes: Vec<u8>,
}

impl Head {
    /// Returns the first position after the element; `None` for an unknown size, or one
    /// that no file can have.
    pub(crate) fn end(&self) -> Option<u64> {
        self.data.checked_add(self.size?)
    }
}

/// Returns the length of an ID from its first byte; `None` if the byte begins none.
fn id_length(first: u8) -> Option<usize> {
    let length = first.leading_zeros() as usize + 1;
    (length <= 4).then_some(length)
}

/// Reader that keeps track of its position and length.
pub(crate) struct Source<R> {
    reader: R,
    position: u64,
    length: u64,
}

impl<R: Sparse> Source<R> {
    /// Creates a source over the whole of a reader, up to its present end.
    ///
    /// # Errors
    ///
    /// Fails if the reader cannot seek.
    pub(crate) fn new(mut reader: R) -> io::Result<Self> {
        let length = reader.seek(SeekFrom::End(0))?;
        reader.seek(SeekFrom::Start(0))?;
        Ok(Self {
            reader,
            position: 0,
            length,
        })
    }

    /// Returns the position of the next byte.
    pub(crate) fn position(&self) -> u64 {
        self.position
    }

    /// Returns the length in bytes.
    pub(crate) fn length(&self) -> u64 {
        self.length
    }

    /// Returns the number of bytes from the position to the end.
    pub(crate) fn remaining(&self) -> u64 {
        self.length.saturating_sub(self.position)
    }

    /// Moves to a position, at most to the end.
    ///
    /// # Errors
    ///
    /// Fails if the reader cannot seek.
    pub(crate) fn seek(&mut self, position: u64) -> io::Result<()> {
        let position = position.min(self.length);
        // No file is longer than an i64 can express.
        let distance = position.wrapping_sub(self.position) as i64;
        self.reader.seek_relative(distance)?;
        self.position = position;
        Ok(())
    }

    /// Reads `size` bytes into `out`, replacing its content.
    ///
    /// Memory grows with the bytes that are read, not with the claimed size.
    ///
    /// # Errors
    ///
    /// Fails if `size` is more than `limit`, or if the file ends before.
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

    /// Reads the head of an element; `None` at the end of the file.
    ///
    /// # Errors
    ///
    /// Fails if the bytes are not head, or if the file ends within it. The position is then after
    /// the first byte.
    pub(crate) fn head(&mut self) -> Result<Option<Head>, EbmlError> {
        let at = self.position;
        let length = self.remaining().min(LONGEST_HEAD);
        let mut bytes = Vec::new();
        self.read_into(length, LONGEST_HEAD, &mut bytes)?;
        let Some(&first) = bytes.first() else {
            return Ok(None);
        };
        let parts = read_id(&bytes).and_then(|(id, rest)| Some((id, variable(rest)?)));
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

    /// Moves to the first occurrence of the bytes of `id` at or after
    /// `from`. Returns false, at the end of the file, if there is none.
    ///
    /// # Errors
    ///
    /// Fails if the file cannot be read.
    pub(crate) fn find(&mut self, id: u32, from: u64) -> io::Result<bool> {
        self.seek(from)?;
        let pattern = id.to_be_bytes();
        let mut block = vec![0_u8; 64 * 1024];
        // The last three bytes of the previous block, so that no occurrence is missed.
        let mut kept = 0;
        loop {
            // An ID begins with a byte other than zero, so it does not begin in a hole.
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

/// Reads a big-endian unsigned integer; `None` if it has more than eight bytes.
pub(crate) fn unsigned(data: &[u8]) -> Option<u64> {
    let next = |value, &byte: &u8| value << 8 | u64::from(byte);
    (data.len() <= 8).then(|| data.iter().fold(0, next))
}

/// Reads UTF-8 text up to the first zero; invalid bytes are replaced.
pub(crate) fn text(data: &[u8]) -> String {
    let text = data.split(|&byte| byte == 0).next();
    String::from_utf8_lossy(text.unwrap_or_default()).into_owned()
}

/// Returns the content of the first element with an ID, in the content of a master element.
pub(crate) fn child(data: &[u8], id: u32) -> Option<&[u8]> {
    all(data, id).next()
}

/// Returns the contents of all elements with an ID, in the content of a master element.
pub(crate) fn all(data: &[u8], id: u32) -> impl Iterator<Item = &[u8]> {
    let matching = children(data).filter(move |(child, _)| *child == id);
    matching.map(|(_, data)| data)
}

/// Returns IDs and contents of the elements in the content of a master element, up to the first
/// that is invalid or extends beyond the end.
fn children(data: &[u8]) -> impl Iterator<Item = (u32, &[u8])> {
    let mut rest = data;
    std::iter::from_fn(move || {
        let (id, after) = read_id(rest)?;
        let (size, after) = variable(after)?;
        let size = usize::try_from(size?).ok()?;
        let data = after.get(..size)?;
        rest = &after[size..];
        Some((id, data))
    })
}

/// Reads an ID; returns it and the bytes after it.
fn read_id(data: &[u8]) -> Option<(u32, &[u8])> {
    let length = id_length(*data.first()?)?;
    let id = unsigned(data.get(..length)?)? as u32;
    Some((id, &data[length..]))
}

/// Reads a variable-length integer; returns it and the bytes after it. The inner `None` is the
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
    fn invalid_and_truncated_heads_are_errors() {
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
    fn a_claimed_size_is_checked_before_memory_is_allocated() {
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
    fn a_pattern_across_two_blocks_is_found() {
        let mut bytes = vec![0_u8; 64 * 1024 - 2];
        bytes.extend_from_slice(&[0x1F, 0x43, 0xB6, 0x75, 1]);
        let mut source = Source::new(Cursor::new(&bytes)).unwrap();
        assert!(source.find(0x1F43_B675, 7).unwrap());
        assert_eq!(source.position(), 64 * 1024 - 2);
        assert!(!source.find(0x1F43_B675, 64 * 1024 - 1).unwrap());
    }
}
