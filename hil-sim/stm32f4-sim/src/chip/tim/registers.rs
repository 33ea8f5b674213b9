//! The registers (RM0090 17.4 and 18.4).

use super::{CHANNELS, CR1_ARPE, CR1_CEN, Channel, Tim, input};
use crate::time::SimTime;

impl Tim {
    /// Reads the register at `offset`.
    pub(crate) fn read(&mut self, offset: u32, now: SimTime) -> Option<u32> {
        self.sync(now);
        Some(match offset {
            0x00 => self.cr1,
            0x04 => self.cr2,
            0x08 => self.smcr,
            0x0c => self.dier,
            0x10 => self.sr,
            0x14 => 0,
            0x18 => self.ccmr[0],
            0x1c => self.ccmr[1],
            0x20 => self.ccer,
            0x24 => self.base_count,
            0x28 => self.psc_next,
            0x2c => self.arr_next,
            0x30 if self.advanced => 0,
            0x34..=0x40 => {
                let ch = ((offset - 0x34) / 4) as usize;
                if self.channel(ch) == Channel::Output {
                    self.ccr_next[ch]
                } else {
                    // Reading a capture clears its flag (RM0090 18.4.5).
                    self.sr &= !(2 << ch);
                    self.ccr[ch]
                }
            }
            0x44 if self.advanced => self.bdtr,
            _ => return None,
        })
    }

    /// Writes the register at `offset`.
    pub(crate) fn write(&mut self, offset: u32, value: u32, now: SimTime) -> bool {
        self.sync(now);
        match offset {
            0x00 => {
                if value & CR1_CEN != 0 && !self.running() {
                    self.base_edge = self.clock.edge_at(now);
                }
                self.cr1 = value & 0x3ff;
                // Without preload the shadow register is the same (RM0090 18.3.1).
                if self.cr1 & CR1_ARPE == 0 {
                    self.arr = self.arr_next;
                }
            }
            0x04 => self.cr2 = value,
            0x08 => self.smcr = value,
            0x0c => self.dier = value & 0x7f5f,
            // Flags are cleared by writing zero.
            0x10 => self.sr &= value,
            0x14 => self.generate(value, now),
            0x18 | 0x1c => {
                self.ccmr[((offset - 0x18) / 4) as usize] = value & 0xffff;
                if (0..CHANNELS).any(|ti| self.filter(ti) > input::MAX_FILTER) {
                    return false;
                }
                for ch in 0..CHANNELS {
                    if self.channel(ch) == Channel::Output && !self.preloaded(ch) {
                        self.ccr[ch] = self.ccr_next[ch];
                    }
                    self.pwm_level(ch);
                }
            }
            0x20 => self.ccer = value & 0xffff,
            // The prescaler goes on: only an update event begins it again.
            0x24 => {
                self.base_count = value & self.mask;
                for ch in 0..CHANNELS {
                    self.pwm_level(ch);
                }
            }
            0x28 => self.psc_next = value & 0xffff,
            0x2c => {
                self.arr_next = value & self.mask;
                if self.cr1 & CR1_ARPE == 0 {
                    self.arr = self.arr_next;
                }
            }
            // The repetition counter is always zero: every wrap is an update.
            0x30 if self.advanced && value == 0 => {}
            0x34..=0x40 => {
                let ch = ((offset - 0x34) / 4) as usize;
                if self.channel(ch) == Channel::Output {
                    self.ccr_next[ch] = value & self.mask;
                    if !self.preloaded(ch) {
                        self.ccr[ch] = value & self.mask;
                        self.pwm_level(ch);
                    }
                }
            }
            0x44 if self.advanced => self.bdtr = value & 0xffff,
            _ => return false,
        }
        true
    }

    /// EGR: events made by software.
    fn generate(&mut self, value: u32, now: SimTime) {
        for ch in 0..CHANNELS {
            if value & (2 << ch) != 0 {
                if self.channel(ch) == Channel::Output {
                    self.flag(ch);
                } else {
                    self.latch(ch);
                }
            }
        }
        if value & 1 != 0 {
            self.base_count = 0;
            self.base_edge = self.clock.edge_at(now);
            self.update_event(false);
        }
    }
}
