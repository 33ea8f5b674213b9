//! The independent watchdog (RM0090 chapter 21), on the low-speed oscillator.

use crate::clock::{Clock, Rate};
use crate::time::SimTime;

/// The low-speed oscillator's typical rate (DS8626 table 42: 17 to 47 kHz).
const LSI_HZ: u64 = 32_000;

#[derive(Debug)]
pub(crate) struct Iwdg {
    unlocked: bool,
    running: bool,
    pr: u32,
    rlr: u32,
    /// When it bites.
    deadline: SimTime,
}

impl Iwdg {
    /// A stopped watchdog.
    pub(crate) fn new() -> Self {
        Self {
            unlocked: false,
            running: false,
            pr: 0,
            rlr: 0xfff,
            deadline: SimTime::NEVER,
        }
    }

    pub(crate) fn reset(&mut self) {
        *self = Self::new();
    }

    pub(crate) fn next_event(&self) -> SimTime {
        self.deadline
    }

    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        Some(match offset {
            // The key reads as zero; what was written counts at once (SR).
            0x00 | 0x0c => 0,
            0x04 => self.pr,
            0x08 => self.rlr,
            _ => return None,
        })
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, now: SimTime) -> bool {
        match offset {
            0x00 => match value & 0xffff {
                0x5555 => self.unlocked = true,
                0xaaaa => {
                    self.unlocked = false;
                    self.reload(now);
                }
                0xcccc => {
                    self.unlocked = false;
                    self.running = true;
                    self.reload(now);
                }
                _ => self.unlocked = false,
            },
            0x04 if self.unlocked => self.pr = value & 7,
            0x08 if self.unlocked => self.rlr = value & 0xfff,
            0x04 | 0x08 => {}
            _ => return false,
        }
        true
    }

    fn reload(&mut self, now: SimTime) {
        if self.running {
            let divider = 4u64 << self.pr.min(6);
            let clock = Clock::new(Rate::hz(LSI_HZ), now, 0);
            self.deadline = clock.time_of((u64::from(self.rlr) + 1) * divider);
        }
    }
}
