//! The controller that programs the flash (RM0090 3.6): words alone, and no erasing.

use super::Soc;
use super::memory::FLASH_BASE;
use super::rules::Rule;
use crate::time::SimDuration;

/// Time in which a word is programmed, typically (DS8626 table 40).
const WORD: SimDuration = SimDuration::from_micros(16);

/// Lowest supply at which a word is programmed at once, in V (RM0090 3.6.2, table 8).
const WORD_SUPPLY: f64 = 2.7;

const KEYS: [u32; 2] = [0x4567_0123, 0xcdef_89ab];

const CR_PG: u32 = 1;
/// Erasing: sector, all, start.
const CR_ERASE: u32 = 0x1_0006;
const CR_PSIZE: u32 = 3 << 8;
const CR_PSIZE_WORD: u32 = 2 << 8;
const CR_LOCK: u32 = 1 << 31;

const SR_PGPERR: u32 = 1 << 6;
const SR_PGSERR: u32 = 1 << 7;
/// Flags that are cleared by writing 1.
const SR_FLAGS: u32 = 0xf3;

/// Its registers.
#[derive(Debug)]
pub(super) struct FlashControl {
    keys: usize,
    cr: u32,
    sr: u32,
}

impl Default for FlashControl {
    fn default() -> Self {
        Self {
            keys: 0,
            cr: CR_LOCK,
            sr: 0,
        }
    }
}

impl FlashControl {
    /// Unlocked, to be programmed.
    pub(super) fn leave_unlocked(&mut self) {
        (self.keys, self.cr) = (KEYS.len(), CR_PG | CR_PSIZE_WORD);
    }

    pub(super) fn read(&self, offset: u32) -> Option<u32> {
        match offset {
            0x0c => Some(self.sr),
            0x10 => Some(self.cr),
            _ => None,
        }
    }

    /// True if the register, and what is written to it, is modelled.
    pub(super) fn write(&mut self, offset: u32, value: u32) -> bool {
        match offset {
            // A wrong key locks it until the next reset.
            0x04 => {
                self.keys = match KEYS.get(self.keys) {
                    Some(key) if *key == value => self.keys + 1,
                    _ => usize::MAX,
                };
                if self.keys == KEYS.len() {
                    self.cr &= !CR_LOCK;
                }
            }
            0x0c => self.sr &= !(value & SR_FLAGS),
            0x10 if value & CR_ERASE != 0 => return false,
            0x10 if self.cr & CR_LOCK == 0 => {
                self.cr = value;
                if value & CR_LOCK != 0 {
                    self.keys = 0;
                }
            }
            0x10 => {}
            _ => return false,
        }
        true
    }
}

impl Soc {
    /// The core writes to the flash, and waits until that is done: its next instruction comes
    /// from there. Bits that are 0 stay.
    pub(super) fn program(&mut self, addr: u32, bytes: &[u8]) {
        let supply = self.adc.supply();
        if self.flash.cr & CR_PSIZE == CR_PSIZE_WORD && supply < WORD_SUPPLY {
            self.forbid(Rule::FlashSupply {
                millivolts: (supply * 1e3) as u32,
            });
        }
        let control = &mut self.flash;
        if control.cr & (CR_PG | CR_LOCK) != CR_PG {
            control.sr |= SR_PGSERR;
        } else if bytes.len() != 4 || control.cr & CR_PSIZE != CR_PSIZE_WORD {
            control.sr |= SR_PGPERR;
        } else {
            let at = addr.wrapping_sub(FLASH_BASE) as usize;
            let cells = self.mem.flash.iter_mut().skip(at);
            for (cell, byte) in cells.zip(bytes) {
                *cell &= byte;
            }
            self.waited += self.cycle_at(self.now + WORD).saturating_sub(self.cycle);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::rules::tests::chip;
    use super::*;

    const FLASH: u32 = 0x4002_3c00;
    const AT: u32 = FLASH_BASE + 0xe_0000;

    fn write(soc: &mut Soc, address: u32, word: u32) -> bool {
        soc.bus_write(address, &word.to_le_bytes(), false)
    }

    #[test]
    fn words_are_programmed_once_the_controller_is_unlocked_and_only_to_zeros() {
        let mut soc = chip();
        let flags = |soc: &mut Soc| soc.read_register(FLASH + 0x0c);
        assert!(write(&mut soc, AT, 0x1234_5678));
        assert_eq!(soc.mem.read32(AT), Some(u32::MAX), "locked");
        assert_eq!(flags(&mut soc), Some(SR_PGSERR));
        for (offset, value) in [
            (0x04, KEYS[0]),
            (0x04, KEYS[1]),
            (0x0c, SR_FLAGS),
            (0x10, CR_PG),
        ] {
            write(&mut soc, FLASH + offset, value);
        }
        write(&mut soc, AT, 0x1234_5678);
        assert_eq!(flags(&mut soc), Some(SR_PGPERR), "a word, set up for bytes");
        write(&mut soc, FLASH + 0x0c, SR_FLAGS);
        write(&mut soc, FLASH + 0x10, CR_PG | CR_PSIZE_WORD);
        soc.waited = 0;
        write(&mut soc, AT, 0x1234_5678);
        assert!(soc.waited > 0, "the core waits");
        write(&mut soc, AT, 0xff00_00ff);
        assert_eq!(soc.mem.read32(AT), Some(0x1200_0078));
        assert_eq!(flags(&mut soc), Some(0));
        // Locked again; a wrong key keeps it locked until the next reset.
        write(&mut soc, FLASH + 0x10, CR_LOCK);
        for key in [KEYS[1], KEYS[0], KEYS[1]] {
            write(&mut soc, FLASH + 0x04, key);
        }
        assert_eq!(soc.read_register(FLASH + 0x10).unwrap() & CR_LOCK, CR_LOCK);
    }
}
