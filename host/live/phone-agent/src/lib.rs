//! Messages between host and phone about the phone's clocks. Pure.
//!
//! A question and its answer have fixed lengths, little-endian:
//!
//! | bytes | question | answer |
//! |---|---|---|
//! | 0..8 | [`MAGIC`], of which the last byte is the version | the same |
//! | 8..16 | nonce | that of the question |
//! | 16..24 | | `CLOCK_BOOTTIME`, ns: the clock of the sensors, and of the frames where Android says `REALTIME` |
//! | 24..32 | | `CLOCK_MONOTONIC`, ns: the clock of the frames of other phones |
//!
//! The host copies the agent to the phone itself, so both have the same version. The agent closes
//! the connection after bytes that are not question.
#![no_std]
#![forbid(unsafe_code)]

/// First bytes of a question and of an answer.
pub const MAGIC: [u8; 8] = *b"SDStime3";

/// Length of a question in bytes.
pub const QUESTION: usize = 16;

/// Length of an answer in bytes.
pub const ANSWER: usize = 32;

/// Seconds without a question after which the agent of a recording ends: its second argument.
pub const PATIENCE_S: u32 = 10;

/// Readings of the phone's clocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Answer {
    /// Nonce of the question.
    pub nonce: u64,
    /// `CLOCK_BOOTTIME` in nanoseconds.
    pub boot_ns: i64,
    /// `CLOCK_MONOTONIC` in nanoseconds.
    pub monotonic_ns: i64,
}

/// Returns the `N` bytes at an index, or zeros if there are fewer.
fn part<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    let part = bytes.get(at..).and_then(|rest| rest.first_chunk::<N>());
    part.copied().unwrap_or([0; N])
}

/// Returns the bytes of a question.
#[must_use]
pub fn question(nonce: u64) -> [u8; QUESTION] {
    let mut bytes = [0; QUESTION];
    bytes[..8].copy_from_slice(&MAGIC);
    bytes[8..].copy_from_slice(&nonce.to_le_bytes());
    bytes
}

/// Parses the nonce of a question. Returns `None` if the bytes are not question.
#[must_use]
pub fn read_question(bytes: &[u8; QUESTION]) -> Option<u64> {
    (part(bytes, 0) == MAGIC).then(|| u64::from_le_bytes(part(bytes, 8)))
}

impl Answer {
    /// Returns the bytes of the answer.
    #[must_use]
    pub fn bytes(&self) -> [u8; ANSWER] {
        let mut bytes = [0; ANSWER];
        bytes[..8].copy_from_slice(&MAGIC);
        bytes[8..16].copy_from_slice(&self.nonce.to_le_bytes());
        bytes[16..24].copy_from_slice(&self.boot_ns.to_le_bytes());
        bytes[24..].copy_from_slice(&self.monotonic_ns.to_le_bytes());
        bytes
    }

    /// Parses an answer. Returns `None` if the bytes are not answer.
    #[must_use]
    pub fn read(bytes: &[u8; ANSWER]) -> Option<Self> {
        (part(bytes, 0) == MAGIC).then(|| Self {
            nonce: u64::from_le_bytes(part(bytes, 8)),
            boot_ns: i64::from_le_bytes(part(bytes, 16)),
            monotonic_ns: i64::from_le_bytes(part(bytes, 24)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bytes_are_what_the_table_says() {
        let asked = question(0x0102_0304_0506_0708);
        assert_eq!(asked, *b"SDStime3\x08\x07\x06\x05\x04\x03\x02\x01");
        assert_eq!(read_question(&asked), Some(0x0102_0304_0506_0708));
        let answer = Answer {
            nonce: 7,
            boot_ns: 1_000_000_007,
            monotonic_ns: -1,
        };
        let bytes = answer.bytes();
        assert_eq!(bytes[8..16], 7_u64.to_le_bytes());
        assert_eq!(bytes[24..32], [0xFF; 8]);
        assert_eq!(Answer::read(&bytes), Some(answer));
    }

    #[test]
    fn others_are_refused() {
        let mut asked = question(3);
        asked[7] = b'1';
        assert_eq!(read_question(&asked), None);
        assert_eq!(Answer::read(&[0; ANSWER]), None);
    }
}
