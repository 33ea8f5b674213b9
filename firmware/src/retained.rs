//! The record that survives a reset: the message of the last panic and the number of the run.
//!
//! RAM keeps its content over every reset but that of power. The record lies
//! in memory that the start-up code does not touch; it is a frame of the protocol, whose CRC
//! tells it from what the cells happen to hold after power-on.

use core::fmt;

use heapless::String;
use protocol::{MAX_PANIC, ResetCause, decode_frame, encode};

/// Memory that holds the longest record.
pub type Memory = [u8; MAX_PANIC + 32];

/// The record.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Kept {
    /// The number of this run.
    pub run: u32,
    /// Resets since power came on, by cause.
    pub resets: [u8; ResetCause::COUNT],
    /// Message of the panic that ended this run, if one did.
    pub panic: Option<String<MAX_PANIC>>,
}

impl Kept {
    /// Reads the record of a run, or `None` if the memory holds noise, as after power-on.
    #[must_use]
    pub fn read(memory: &Memory) -> Option<Self> {
        let frame = memory.split(|&byte| byte == 0).next()?;
        let (run, resets, panic) = decode_frame(frame).ok()?;
        Some(Self { run, resets, panic })
    }

    /// As it lies in memory.
    #[must_use]
    pub fn to_memory(&self) -> Memory {
        let mut memory = [0; _];
        // The longest fits: a test.
        let _ = encode(&(self.run, self.resets, &self.panic), &mut memory);
        memory
    }

    /// Returns the message of the panic that ended the last run, and the record of this run, which
    /// a reset with this cause began. The record must be stored at once: a panic is reported once.
    ///
    /// After power-on the number of the run comes from the previous content of the memory, for want
    /// of a better random number: memory powers up much alike.
    #[must_use]
    pub fn next(memory: &Memory, cause: ResetCause) -> (Option<String<MAX_PANIC>>, Self) {
        let mut kept = Self::read(memory).unwrap_or_else(|| Self {
            run: memory.iter().fold(0, |hash: u32, &byte| {
                hash.wrapping_mul(0x0100_0193) ^ u32::from(byte)
            }),
            ..Self::default()
        });
        kept.run = kept.run.wrapping_add(1);
        if let Some(count) = kept.resets.get_mut(cause as usize) {
            *count = count.saturating_add(1);
        }
        (kept.panic.take(), kept)
    }

    /// The same run, ended by a panic with this message; longer ones are cut.
    #[must_use]
    pub fn panicked(self, message: fmt::Arguments<'_>) -> Self {
        let mut text = Cut(String::new());
        // `Cut` takes everything; a message that fails to format is cut there.
        let _ = fmt::Write::write_fmt(&mut text, message);
        let panic = Some(text.0);
        Self { panic, ..self }
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
        let run = Kept {
            run: 41,
            ..Kept::default()
        };
        let left = run.panicked(format_args!("x = {}", 7)).to_memory();
        let (panic, next) = Kept::next(&left, ResetCause::Software);
        assert_eq!(panic.as_deref(), Some("x = 7"));
        assert_eq!(next.run, 42);
        let (panic, next) = Kept::next(&next.to_memory(), ResetCause::Software);
        assert_eq!(panic, None);
        assert_eq!(next.run, 43);
        assert_eq!(next.resets, [0, 0, 0, 2, 0, 0]);
    }

    #[test]
    fn what_memory_holds_after_power_on_is_no_panic() {
        let start = |byte| Kept::next(&[byte; _], ResetCause::PowerOn);
        for byte in [0, 1, 0x80, 0xFF] {
            let (panic, next) = start(byte);
            assert_eq!(panic, None);
            assert_eq!(next.resets, [1, 0, 0, 0, 0, 0]);
            assert_eq!(Kept::read(&next.to_memory()), Some(next));
        }
        assert_ne!(start(0).1.run, start(1).1.run);
    }

    #[test]
    fn any_flipped_bit_makes_it_invalid() {
        let good = Kept::default().panicked(format_args!("abc")).to_memory();
        let len = good.iter().position(|&byte| byte == 0).unwrap();
        for bit in 0..8 * len {
            let mut bad = good;
            bad[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(Kept::read(&bad), None, "bit {bit}");
        }
    }

    #[test]
    fn noise_is_no_record_and_flips_leave_no_other() {
        let mut state = 1_u64;
        let mut byte = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 56) as u8
        };
        let good = Kept::default().panicked(format_args!("abc")).to_memory();
        for _ in 0..100_000 {
            let noise: Memory = core::array::from_fn(|_| byte());
            assert_eq!(Kept::read(&noise), None, "{noise:?}");
            // One bit in sixteen.
            let worn = good.map(|kept| kept ^ (byte() & byte() & byte() & byte()));
            let read = Kept::read(&worn);
            assert!(read.is_none() || read == Kept::read(&good), "{worn:?}");
        }
    }

    #[test]
    fn long_messages_are_cut_between_characters() {
        let long = "ä".repeat(100);
        let longest = Kept {
            run: u32::MAX,
            resets: [u8::MAX; ResetCause::COUNT],
            panic: None,
        };
        let left = longest.panicked(format_args!("{long}")).to_memory();
        let (panic, _) = Kept::next(&left, ResetCause::Software);
        assert_eq!(panic.unwrap().as_str(), "ä".repeat(MAX_PANIC / 2));
    }
}
