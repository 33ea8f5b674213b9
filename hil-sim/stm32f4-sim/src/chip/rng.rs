//! The random number generator (RM0090 chapter 24): polling, without its interrupt.

use crate::clock::Rate;
use crate::random::Random;
use crate::time::{SimDuration, SimTime};

const CR_RNGEN: u32 = 1 << 2;
const SR_DRDY: u32 = 1 << 0;
const SR_CECS: u32 = 1 << 1;
const SR_SECS: u32 = 1 << 2;
const SR_CEIS: u32 = 1 << 5;
const SR_SEIS: u32 = 1 << 6;

/// From one number to the next: 40 periods of its 48 MHz (24.3.1), rounded up.
const INTERVAL: SimDuration = SimDuration::from_nanos(834);

/// The slowest clock beside HCLK that it takes: HCLK / 16 (24.3.2).
const SLOWEST: u64 = 16;

#[derive(Debug)]
pub(crate) struct Rng {
    random: Random,
    cr: u32,
    ready: SimTime,
    /// The analogue part is broken: it reports a seed error.
    pub(crate) broken: bool,
    /// The number that was read last.
    pub(crate) last: Option<u32>,
}

impl Rng {
    pub(crate) fn new(random: Random) -> Self {
        Self {
            random,
            cr: 0,
            ready: SimTime::NEVER,
            broken: false,
            last: None,
        }
    }

    pub(crate) fn reset(&mut self) {
        self.cr = 0;
        self.ready = SimTime::NEVER;
    }

    /// Reads a register while its own clock has the rate `clock`, the core's `hclk`.
    pub(crate) fn read(
        &mut self,
        offset: u32,
        now: SimTime,
        clock: Rate,
        hclk: Rate,
    ) -> Option<u32> {
        let slow = clock.hz_rounded() * SLOWEST < hclk.hz_rounded();
        let faults = if slow {
            SR_CECS | SR_CEIS
        } else if self.broken {
            SR_SECS | SR_SEIS
        } else {
            0
        };
        let enabled = self.cr & CR_RNGEN != 0;
        let ready = enabled && faults == 0 && now >= self.ready;
        Some(match offset {
            0x00 => self.cr,
            0x04 if ready => SR_DRDY,
            0x04 if enabled => faults,
            0x04 => 0,
            0x08 if ready => {
                let number = self.random.bits() as u32;
                self.ready = now + INTERVAL;
                self.last = Some(number);
                number
            }
            0x08 => 0,
            _ => return None,
        })
    }

    /// Writes a register; the interrupt is not modelled.
    pub(crate) fn write(&mut self, offset: u32, value: u32, now: SimTime) -> bool {
        match offset {
            0x00 if value & !CR_RNGEN == 0 => {
                if value & !self.cr & CR_RNGEN != 0 {
                    self.ready = now + INTERVAL;
                }
                self.cr = value;
                true
            }
            0x04 => true,
            _ => false,
        }
    }
}
