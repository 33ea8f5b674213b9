//! What survives a reset: the message of the last panic and the number of the run.
//!
//! RAM keeps its content over every reset but that of power. The record lies
//! in memory that the start-up code does not touch; a magic number and a CRC
//! tell it from what the cells happen to hold after power-on.

use core::fmt;

use crc::{CRC_32_ISO_HDLC, Crc};
use heapless::String;
use protocol::{MAX_PANIC, ResetCause};

const MAGIC: u32 = 0x5D_5EED;
const CRC32: Crc<u32, crc::NoTable> = Crc::<u32, crc::NoTable>::new(&CRC_32_ISO_HDLC);

/// The record, as it lies in memory. Any bit pattern is a value of it.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Kept {
    magic: u32,
    run: u32,
    /// Resets since power came on, by cause.
    resets: [u8; ResetCause::COUNT],
    /// Bytes of `text` in use; 0: no panic.
    len: u32,
    text: [u8; MAX_PANIC],
    crc: u32,
}

impl Kept {
    fn checksum(&self) -> u32 {
        let mut digest = CRC32.digest();
        digest.update(&self.magic.to_le_bytes());
        digest.update(&self.run.to_le_bytes());
        digest.update(&self.resets);
        digest.update(&self.len.to_le_bytes());
        digest.update(&self.text);
        digest.finalize()
    }

    /// Whether a former run left it; after power-on it holds noise.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        self.magic == MAGIC && self.crc == self.checksum()
    }

    /// What the last run left, and the record for this one, which a reset with this cause began
    /// and which is to be stored at once: a panic is reported once.
    ///
    /// After power-on the number of the run comes from the CRC of whatever the
    /// memory held, for want of a better random number: memory powers up much alike.
    #[must_use]
    pub fn next(self, cause: ResetCause) -> (Option<String<MAX_PANIC>>, Self) {
        let (panic, run, mut resets) = if self.is_valid() {
            (self.panic_text(), self.run.wrapping_add(1), self.resets)
        } else {
            (None, self.checksum() ^ self.crc, Default::default())
        };
        if let Some(count) = resets.get_mut(cause as usize) {
            *count = count.saturating_add(1);
        }
        (panic, Self::new(run, resets))
    }

    /// The record of a run without a panic.
    #[must_use]
    pub fn new(run: u32, resets: [u8; ResetCause::COUNT]) -> Self {
        let mut record = Self {
            magic: MAGIC,
            run,
            resets,
            len: 0,
            text: [0; MAX_PANIC],
            crc: 0,
        };
        record.crc = record.checksum();
        record
    }

    /// Resets since power came on, by cause.
    #[must_use]
    pub const fn resets(&self) -> [u8; ResetCause::COUNT] {
        self.resets
    }

    /// The number of this run.
    #[must_use]
    pub const fn run(&self) -> u32 {
        self.run
    }

    /// The same run, ended by a panic with this message; longer ones are cut.
    #[must_use]
    pub fn panicked(mut self, message: fmt::Arguments<'_>) -> Self {
        let mut text = Cut(String::new());
        // `Cut` takes everything; a message that fails to format is cut there.
        let _ = fmt::Write::write_fmt(&mut text, message);
        let bytes = text.0.as_bytes();
        self.text = [0; MAX_PANIC];
        if let Some(space) = self.text.get_mut(..bytes.len()) {
            space.copy_from_slice(bytes);
        }
        self.len = bytes.len() as u32;
        self.crc = self.checksum();
        self
    }

    /// What ended this run, if a panic did.
    #[must_use]
    pub fn panic_text(&self) -> Option<String<MAX_PANIC>> {
        let bytes = self
            .text
            .get(..self.len as usize)
            .filter(|b| !b.is_empty())?;
        let text = core::str::from_utf8(bytes).ok()?;
        String::try_from(text).ok()
    }
}

/// A string that takes as much as fits and drops the rest.
struct Cut(String<MAX_PANIC>);

impl fmt::Write for Cut {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for c in text.chars() {
            if self.0.push(c).is_err() {
                break;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_reported_once_and_runs_are_counted() {
        let run = Kept::new(41, [0; ResetCause::COUNT]);
        let (panic, next) = run
            .panicked(format_args!("x = {}", 7))
            .next(ResetCause::Software);
        assert_eq!(panic.as_deref(), Some("x = 7"));
        assert_eq!(next.run(), 42);
        let (panic, next) = next.next(ResetCause::Software);
        assert_eq!(panic, None);
        assert_eq!(next.run(), 43);
        assert_eq!(next.resets(), [0, 0, 0, 2, 0, 0, 0, 0]);
    }

    #[test]
    fn what_memory_holds_after_power_on_is_no_panic() {
        let garbage = Kept {
            magic: MAGIC,
            run: 9,
            resets: [3; ResetCause::COUNT],
            len: u32::MAX,
            text: [0x80; MAX_PANIC],
            crc: 1,
        };
        let (panic, next) = garbage.next(ResetCause::Software);
        assert_eq!(panic, None);
        assert!(next.is_valid());
        assert_eq!(next.resets().iter().sum::<u8>(), 1);
        let zero = Kept {
            magic: 0,
            run: 0,
            resets: [0; ResetCause::COUNT],
            len: 0,
            text: [0; MAX_PANIC],
            crc: 0,
        };
        assert_ne!(zero.next(ResetCause::PowerOn).1.run(), next.run());
    }

    #[test]
    fn any_flipped_bit_makes_it_invalid() {
        let good = Kept::new(5, [0; ResetCause::COUNT]).panicked(format_args!("abc"));
        assert!(good.is_valid());
        for i in 0..MAX_PANIC {
            let mut bad = good;
            bad.text[i] ^= 1;
            assert!(!bad.is_valid());
        }
        assert!(!Kept { run: 6, ..good }.is_valid());
        assert!(!Kept { len: 2, ..good }.is_valid());
    }

    #[test]
    fn long_messages_are_cut_between_characters() {
        let long = "ä".repeat(100);
        let (panic, _) = Kept::new(0, [0; ResetCause::COUNT])
            .panicked(format_args!("{long}"))
            .next(ResetCause::Software);
        assert_eq!(panic.unwrap().as_str(), "ä".repeat(MAX_PANIC / 2));
    }
}
