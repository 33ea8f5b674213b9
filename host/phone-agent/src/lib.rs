//! Messages between host and phone about the phone's clocks. Pure.
//!
//! A question and its answer have fixed lengths, little-endian:
//!
//! | bytes | question | answer |
//! |---|---|---|
//! | 0..4 | [`MAGIC`] | the same |
//! | 4..8 | [`VERSION`] | the agent's |
//! | 8..16 | nonce | that of the question |
//! | 16..24 | | `CLOCK_BOOTTIME`, ns: the clock of the sensors, and of the frames where Android says `REALTIME` |
//! | 24..32 | | `CLOCK_MONOTONIC`, ns: the clock of the frames of other phones |
//! | 32..36 | | temperature of the battery, 0.1 °C; [`NO_TEMPERATURE`] if it cannot be read |
//!
//! A question of another version is answered too, with the agent's version and nothing else
//! that counts: so the host can say which one is there. What is no question at all ends the
//! connection.
#![no_std]
#![forbid(unsafe_code)]

/// The first bytes of question and answer.
pub const MAGIC: [u8; 4] = *b"SDSt";

/// The version of this exchange.
pub const VERSION: u32 = 1;

/// Bytes of a question.
pub const QUESTION: usize = 16;

/// Bytes of an answer.
pub const ANSWER: usize = 36;

/// The battery's temperature cannot be read.
pub const NO_TEMPERATURE: i32 = i32::MIN;

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
    /// Temperature of the battery, 0.1 °C.
    pub temperature: Option<i32>,
}

/// Why bytes are no question or no answer of this version.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wrong {
    /// Something else speaks there.
    Magic,
    /// Another version, with this number.
    Version(u32),
}

/// So many bytes from a place on; zeros if they are not there.
fn part<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    let part = bytes.get(at..).and_then(|rest| rest.first_chunk::<N>());
    part.copied().unwrap_or([0; N])
}

fn check(bytes: &[u8]) -> Result<(), Wrong> {
    let version = u32::from_le_bytes(part(bytes, 4));
    match part::<4>(bytes, 0) == MAGIC {
        false => Err(Wrong::Magic),
        true if version != VERSION => Err(Wrong::Version(version)),
        true => Ok(()),
    }
}

/// A question.
#[must_use]
pub fn question(nonce: u64) -> [u8; QUESTION] {
    let mut bytes = [0; QUESTION];
    bytes[..4].copy_from_slice(&MAGIC);
    bytes[4..8].copy_from_slice(&VERSION.to_le_bytes());
    bytes[8..].copy_from_slice(&nonce.to_le_bytes());
    bytes
}

/// The nonce of a question; of another version's too.
///
/// # Errors
///
/// It is none.
pub fn read_question(bytes: &[u8; QUESTION]) -> Result<u64, Wrong> {
    match check(bytes) {
        Err(Wrong::Magic) => Err(Wrong::Magic),
        Ok(()) | Err(Wrong::Version(_)) => Ok(u64::from_le_bytes(part(bytes, 8))),
    }
}

impl Answer {
    /// As it is sent.
    #[must_use]
    pub fn bytes(&self) -> [u8; ANSWER] {
        let mut bytes = [0; ANSWER];
        bytes[..4].copy_from_slice(&MAGIC);
        bytes[4..8].copy_from_slice(&VERSION.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.nonce.to_le_bytes());
        bytes[16..24].copy_from_slice(&self.boot_ns.to_le_bytes());
        bytes[24..32].copy_from_slice(&self.monotonic_ns.to_le_bytes());
        let temperature = self.temperature.unwrap_or(NO_TEMPERATURE);
        bytes[32..].copy_from_slice(&temperature.to_le_bytes());
        bytes
    }

    /// As it came.
    ///
    /// # Errors
    ///
    /// It is none, or another version's.
    pub fn read(bytes: &[u8; ANSWER]) -> Result<Self, Wrong> {
        check(bytes)?;
        let temperature = i32::from_le_bytes(part(bytes, 32));
        Ok(Self {
            nonce: u64::from_le_bytes(part(bytes, 8)),
            boot_ns: i64::from_le_bytes(part(bytes, 16)),
            monotonic_ns: i64::from_le_bytes(part(bytes, 24)),
            temperature: Some(temperature).filter(|&celsius| celsius != NO_TEMPERATURE),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bytes_are_what_the_table_says() {
        let asked = question(0x0102_0304_0506_0708);
        assert_eq!(asked, *b"SDSt\x01\0\0\0\x08\x07\x06\x05\x04\x03\x02\x01");
        assert_eq!(read_question(&asked), Ok(0x0102_0304_0506_0708));
        let answer = Answer {
            nonce: 7,
            boot_ns: 1_000_000_007,
            monotonic_ns: -1,
            temperature: Some(315),
        };
        let bytes = answer.bytes();
        assert_eq!(bytes[8..16], 7_u64.to_le_bytes());
        assert_eq!(bytes[24..32], [0xFF; 8]);
        assert_eq!(Answer::read(&bytes), Ok(answer));
        let unread = Answer {
            temperature: None,
            ..answer
        };
        assert_eq!(Answer::read(&unread.bytes()), Ok(unread));
    }

    #[test]
    fn others_are_told_from_other_versions() {
        let mut asked = question(3);
        asked[4] = 9;
        assert_eq!(read_question(&asked), Ok(3));
        asked[0] = b'G';
        assert_eq!(read_question(&asked), Err(Wrong::Magic));
        let mut bytes = [0; ANSWER];
        assert_eq!(Answer::read(&bytes), Err(Wrong::Magic));
        bytes[..4].copy_from_slice(&MAGIC);
        bytes[4] = 2;
        assert_eq!(Answer::read(&bytes), Err(Wrong::Version(2)));
    }
}
