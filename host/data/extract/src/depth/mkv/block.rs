//! Blocks with their lacing, and the checksum of a cluster.

use super::ebml::{self, Head};

/// Head of a block, and its payload.
pub(super) struct Block<'a> {
    /// Number of the track.
    pub(super) track: u64,
    /// Time relative to the cluster, in units of the file.
    pub(super) time: i16,
    /// Lacing: 0 none, 1 Xiph, 2 fixed size, 3 EBML.
    pub(super) lacing: u8,
    pub(super) payload: &'a [u8],
}

impl<'a> Block<'a> {
    /// Parses the head; `None` if it is invalid.
    pub(super) fn parse(data: &'a [u8]) -> Option<Self> {
        let (track, rest) = ebml::variable(data)?;
        let (head, payload) = rest.split_at_checked(3)?;
        Some(Self {
            track: track?,
            time: i16::from_be_bytes([head[0], head[1]]),
            lacing: head[2] >> 1 & 3,
            payload,
        })
    }

    /// Splits the payload into frames (RFC 9559, 10.3); `None` if the lacing is invalid.
    pub(super) fn frames(&self) -> Option<Vec<&'a [u8]>> {
        if self.lacing == 0 {
            return Some(vec![self.payload]);
        }
        let (&last, mut rest) = self.payload.split_first()?;
        let count = usize::from(last) + 1;
        let mut sizes = Vec::with_capacity(count);
        match self.lacing {
            1 => {
                for _ in 1..count {
                    let mut size = 0_usize;
                    loop {
                        let (&byte, after) = rest.split_first()?;
                        rest = after;
                        size += usize::from(byte);
                        if byte < 255 {
                            break;
                        }
                    }
                    sizes.push(size);
                }
            }
            2 => {
                if !rest.len().is_multiple_of(count) {
                    return None;
                }
                sizes.resize(count - 1, rest.len() / count);
            }
            _ => {
                let mut size = 0_i64;
                for index in 1..count {
                    let before = rest.len();
                    let (value, after) = ebml::variable(rest)?;
                    let length = before - after.len();
                    rest = after;
                    let value = i64::try_from(value?).ok()?;
                    if index == 1 {
                        size = value;
                    } else {
                        // Differences are stored with half the range added.
                        let bias = (1_i64 << (7 * length - 1)) - 1;
                        size = size.checked_add(value - bias)?;
                    }
                    sizes.push(usize::try_from(size).ok()?);
                }
            }
        }
        let mut frames = Vec::with_capacity(count);
        for size in sizes {
            let (frame, after) = rest.split_at_checked(size)?;
            frames.push(frame);
            rest = after;
        }
        frames.push(rest);
        Some(frames)
    }
}

/// CRC-32 of a cluster, over everything that follows its CRC element.
#[derive(Default)]
pub(super) struct Checksum {
    expected: Option<u32>,
    hasher: crc32fast::Hasher,
    used: bool,
}

impl Checksum {
    /// Returns true before the first element.
    pub(super) fn is_unused(&self) -> bool {
        !self.used
    }

    /// Sets the expected value, from the content of the CRC element.
    pub(super) fn expect(&mut self, data: &[u8]) {
        self.used = true;
        if let Ok(bytes) = data.try_into() {
            // Stored little-endian (RFC 8794, 11.3.1).
            self.expected = Some(u32::from_le_bytes(bytes));
        }
    }

    /// Gives up the check, as an element was not read in full.
    pub(super) fn skip(&mut self) {
        self.used = true;
        self.expected = None;
    }

    /// Adds an element.
    pub(super) fn add(&mut self, head: &Head, data: &[u8]) {
        self.used = true;
        if self.expected.is_some() {
            self.hasher.update(&head.bytes);
            self.hasher.update(data);
        }
    }

    /// Returns true if the checksum is right; `None` if there is nothing to compare.
    pub(super) fn matches(self) -> Option<bool> {
        Some(self.hasher.finalize() == self.expected?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lace(lacing: u8, payload: &[u8]) -> Option<Vec<usize>> {
        let mut data = vec![0x81, 0, 5, lacing << 1];
        data.extend_from_slice(payload);
        let block = Block::parse(&data).unwrap();
        assert_eq!((block.track, block.time), (1, 5));
        Some(block.frames()?.iter().map(|frame| frame.len()).collect())
    }

    #[test]
    fn all_lacings_are_split() {
        assert_eq!(lace(0, &[1, 2, 3]), Some(vec![3]));
        assert_eq!(lace(2, &[1, 9, 9, 9, 9]), Some(vec![2, 2]));
        assert_eq!(lace(2, &[1, 9, 9, 9]), None);
        let mut xiph = vec![2, 255, 1, 2];
        xiph.extend(vec![0; 256 + 2 + 3]);
        assert_eq!(lace(1, &xiph), Some(vec![256, 2, 3]));
        // 3 frames: 4 bytes, then 4 − 2 (0xBF − 2), then the rest.
        let mut ebml = vec![2, 0x84, 0xBD];
        ebml.extend(vec![0; 4 + 2 + 7]);
        assert_eq!(lace(3, &ebml), Some(vec![4, 2, 7]));
        assert_eq!(lace(3, &[2, 0x84, 0x81]), None);
        assert_eq!(lace(1, &[255]), None);
    }
}
