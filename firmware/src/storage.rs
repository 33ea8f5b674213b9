//! Settings and panics in the flash, which outlast power-off.
//!
//! Entries stand one after the other in slots of their own, each written once, so nothing is
//! ever erased; the newest of its kind is valid. An entry is a frame of the protocol, whose CRC
//! reveals one that a loss of power cut short.

use heapless::String;
use protocol::{BoardSettings, MAX_PANIC, decode_frame, encode};

use crate::config;

/// Bytes of a slot: the longest entry, a panic's.
pub const SLOT: usize = 144;

/// Value of erased flash.
const BLANK: u8 = 0xFF;

/// Kinds of entries, the first byte of each.
const SETTINGS: u8 = 1;
const PANIC: u8 = 2;

/// Settings of a board that has not been measured.
pub const DEFAULTS: BoardSettings = BoardSettings {
    output_start_delay: config::OUTPUT_START_DELAY,
    input_delay: config::INPUT_FILTER as u8,
    crystal_ppb: None,
};

/// Content of the slots.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stored {
    /// The newest settings.
    pub settings: BoardSettings,
    /// The newest panic.
    pub panic: Option<String<MAX_PANIC>>,
    /// Number of panics.
    pub panics: u32,
    /// Number of slots in use: the next one is free, if there is one.
    pub used: usize,
}

impl Stored {
    /// Reads the slots up to the first free one.
    #[must_use]
    pub fn read(flash: &[u8]) -> Self {
        let mut stored = Self {
            settings: DEFAULTS,
            panic: None,
            panics: 0,
            used: 0,
        };
        for slot in flash.chunks_exact(SLOT) {
            let mut parts = slot.splitn(2, |&byte| byte == 0);
            let frame = parts.next().unwrap_or_default();
            if slot.iter().all(|&byte| byte == BLANK) {
                break;
            }
            stored.used += 1;
            if let Ok((SETTINGS, settings)) = decode_frame(frame) {
                stored.settings = settings;
            } else if let Ok((PANIC, text)) = decode_frame(frame) {
                stored.panic = Some(text);
                stored.panics += 1;
            }
        }
        stored
    }
}

/// The slot of settings.
#[must_use]
pub fn settings_slot(settings: BoardSettings) -> Option<[u8; SLOT]> {
    slot(|to| Some(encode(&(SETTINGS, settings), to).ok()?.len()))
}

/// The slot of a panic.
#[must_use]
pub fn panic_slot(text: &str) -> Option<[u8; SLOT]> {
    slot(|to| Some(encode(&(PANIC, text), to).ok()?.len()))
}

fn slot(encode: impl FnOnce(&mut [u8]) -> Option<usize>) -> Option<[u8; SLOT]> {
    let mut slot = [BLANK; SLOT];
    let len = encode(&mut slot)?;
    slot.get_mut(len..)?.fill(BLANK);
    Some(slot)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flash(slots: &[[u8; SLOT]]) -> std::vec::Vec<u8> {
        let mut flash = slots.concat();
        flash.resize(20 * SLOT, BLANK);
        flash
    }

    #[test]
    fn the_newest_of_each_kind_holds_and_torn_entries_count_as_used() {
        let of = |input_delay| BoardSettings {
            input_delay,
            crystal_ppb: Some(-70_000),
            ..DEFAULTS
        };
        let longest = "x".repeat(MAX_PANIC);
        let mut torn = settings_slot(of(30)).unwrap();
        torn[6..].fill(BLANK);
        let mut stored = Stored::read(&flash(&[
            settings_slot(of(9)).unwrap(),
            panic_slot("first").unwrap(),
            settings_slot(of(11)).unwrap(),
            panic_slot(&longest).unwrap(),
            torn,
        ]));
        assert_eq!(stored.settings, of(11));
        assert_eq!(stored.panic.take().unwrap().as_str(), longest);
        assert_eq!((stored.panics, stored.used), (2, 5));
        let empty = Stored::read(&flash(&[]));
        assert_eq!((empty.settings, empty.used), (DEFAULTS, 0));
    }

    #[test]
    fn any_flipped_bit_and_any_noise_is_no_entry() {
        let good = settings_slot(DEFAULTS).unwrap();
        let used = good.iter().position(|&byte| byte == 0).unwrap();
        for bit in 0..used * 8 {
            let mut bad = good;
            bad[bit / 8] ^= 1 << (bit % 8);
            let mut other = DEFAULTS;
            other.input_delay = 1;
            let stored = Stored::read(&flash(&[settings_slot(other).unwrap(), bad]));
            assert_eq!(stored.settings, other, "bit {bit}");
        }
    }
}
