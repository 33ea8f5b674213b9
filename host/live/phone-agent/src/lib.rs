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
//! The host copies the agent to the phone itself, so both are of one version. What is no
//! question ends the connection.
#![no_std]
#![forbid(unsafe_code)]

/// The first bytes of question and answer.
pub const MAGIC: [u8; 8] = *b"SDStime3";

/// Bytes of a question.
pub const QUESTION: usize = 16;

/// Bytes of an answer.
pub const ANSWER: usize = 32;

/// Time without a question after which the agent of a recording ends, s: its second argument.
pub const PATIENCE_S: u32 = 10;

/// What the clocks read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Answer {
    /// That of the question.
    pub nonce: u64,
    /// `CLOCK_BOOTTIME`, ns.
    pub boot_ns: i64,
    /// `CLOCK_MONOTONIC`, ns.
    pub monotonic_ns: i64,
}

/// So many bytes from a place on; zeros if they are not there.
fn part<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    let part = bytes.get(at..).and_then(|rest| rest.first_chunk::<N>());
    part.copied().unwrap_or([0; N])
}

/// A question.
#[must_use]
pub fn question(nonce: u64) -> [u8; QUESTION] {
    let mut bytes = [0; QUESTION];
    bytes[..8].copy_from_slice(&MAGIC);
    bytes[8..].copy_from_slice(&nonce.to_le_bytes());
    bytes
}

/// The nonce of a question; `None` if it is none.
#[must_use]
pub fn read_question(bytes: &[u8; QUESTION]) -> Option<u64> {
    (part(bytes, 0) == MAGIC).then(|| u64::from_le_bytes(part(bytes, 8)))
}

impl Answer {
    /// As it is sent.
    #[must_use]
    pub fn bytes(&self) -> [u8; ANSWER] {
        let mut bytes = [0; ANSWER];
        bytes[..8].copy_from_slice(&MAGIC);
        bytes[8..16].copy_from_slice(&self.nonce.to_le_bytes());
        bytes[16..24].copy_from_slice(&self.boot_ns.to_le_bytes());
        bytes[24..].copy_from_slice(&self.monotonic_ns.to_le_bytes());
        bytes
    }

    /// As it came; `None` if it is no answer.
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
