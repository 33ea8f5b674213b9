//! The transmitter of UART5 (RM0090 chapter 30), bit by bit on its pin.
//!
//! Eight data bits and one stop bit, no parity; the receiver is not modelled.

use crate::clock::{Clock, Rate};
use crate::pin::Pin;
use crate::time::SimTime;

/// Number of its interrupt.
pub(super) const IRQ: usize = 53;

/// Its pin, and that one's alternate function.
pub(super) const TX: (Pin, u8) = (Pin::PC12, 8);

const SR_TC: u32 = 1 << 6;
const SR_TXE: u32 = 1 << 7;
const CR1_TE: u32 = 1 << 3;
const CR1_TCIE: u32 = 1 << 6;
const CR1_TXEIE: u32 = 1 << 7;
const CR1_UE: u32 = 1 << 13;
const CR3_DMAT: u32 = 1 << 7;

#[derive(Debug)]
pub(crate) struct Uart {
    pclk: Rate,
    sr: u32,
    brr: u32,
    cr: [u32; 3],
    dr: u8,
    /// Bits still to send, the next one lowest, and how many.
    shift: u16,
    bits: u8,
    bit_end: SimTime,
}

impl Uart {
    pub(crate) fn new() -> Self {
        Self {
            pclk: Rate::hz(16_000_000),
            sr: SR_TC | SR_TXE,
            brr: 0,
            cr: [0; 3],
            dr: 0,
            shift: 1,
            bits: 0,
            bit_end: SimTime::NEVER,
        }
    }

    pub(crate) fn reset(&mut self) {
        let pclk = self.pclk;
        *self = Self::new();
        self.pclk = pclk;
    }

    pub(crate) fn set_clock(&mut self, pclk: Rate) {
        self.pclk = pclk;
    }

    pub(crate) fn next_event(&self) -> SimTime {
        self.bit_end
    }

    /// Level of the line.
    pub(crate) fn line(&self) -> bool {
        self.bits == 0 || self.shift & 1 != 0
    }

    fn enabled(&self) -> bool {
        self.cr[0] & (CR1_UE | CR1_TE) == CR1_UE | CR1_TE
    }

    pub(crate) fn irq(&self) -> bool {
        (self.sr & SR_TXE != 0 && self.cr[0] & CR1_TXEIE != 0)
            || (self.sr & SR_TC != 0 && self.cr[0] & CR1_TCIE != 0)
    }

    /// Asks the DMA controller for a byte (30.3.13).
    pub(crate) fn wants_tx(&self) -> bool {
        self.enabled() && self.cr[2] & CR3_DMAT != 0 && self.sr & SR_TXE != 0
    }

    fn bit_time(&self, now: SimTime) -> SimTime {
        // Oversampling by 16: BRR is the divider; by 8 the fraction has three bits.
        let divider = if self.cr[0] & (1 << 15) != 0 {
            ((self.brr & 0xfff0) >> 1) | (self.brr & 7)
        } else {
            self.brr & 0xffff
        };
        Clock::new(self.pclk, now, 0).time_of(u64::from(divider.max(1)))
    }

    fn load(&mut self, now: SimTime) {
        self.shift = (u16::from(self.dr) << 1) | 0x200;
        self.bits = 10;
        self.sr |= SR_TXE;
        self.sr &= !SR_TC;
        self.bit_end = self.bit_time(now);
    }

    pub(crate) fn advance(&mut self, now: SimTime) {
        if now < self.bit_end {
            return;
        }
        self.shift >>= 1;
        self.bits = self.bits.saturating_sub(1);
        if self.bits > 0 {
            self.bit_end = self.bit_time(now);
        } else if self.sr & SR_TXE == 0 {
            self.load(now);
        } else {
            self.sr |= SR_TC;
            self.bit_end = SimTime::NEVER;
        }
    }

    pub(crate) fn write_dr(&mut self, value: u32, now: SimTime) {
        if !self.enabled() {
            return;
        }
        self.dr = value as u8;
        self.sr &= !(SR_TXE | SR_TC);
        if self.bits == 0 {
            self.load(now);
        }
    }

    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x00 => self.sr,
            0x08 => self.brr,
            0x0c..=0x14 => self.cr[((offset - 0xc) / 4) as usize],
            _ => return None,
        })
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, now: SimTime) -> bool {
        match offset {
            0x00 => self.sr &= value | !SR_TC,
            0x04 => self.write_dr(value, now),
            0x08 => self.brr = value & 0xffff,
            0x0c..=0x14 => self.cr[((offset - 0xc) / 4) as usize] = value & 0xffff,
            _ => return false,
        }
        true
    }
}
