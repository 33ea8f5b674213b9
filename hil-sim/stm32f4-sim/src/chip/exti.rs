//! External interrupts and the pin multiplexer of SYSCFG (RM0090 chapters 9 and 12).

use crate::pin::Pin;

#[derive(Debug, Default)]
pub(crate) struct Exti {
    imr: u32,
    rtsr: u32,
    ftsr: u32,
    pr: u32,
    exticr: [u32; 4],
    cmpcr: u32,
}

impl Exti {
    /// An edge on a pin.
    pub(crate) fn pin_edge(&mut self, pin: Pin, rising: bool) {
        let n = pin.number();
        let port = (self.exticr[n / 4] >> ((n % 4) * 4)) & 0xf;
        if port as usize != pin.port() {
            return;
        }
        let trigger = if rising { self.rtsr } else { self.ftsr };
        self.pr |= trigger & (1 << n);
    }

    /// Lines that request an interrupt.
    pub(crate) fn active(&self) -> u32 {
        self.pr & self.imr
    }

    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x00 => self.imr,
            0x08 => self.rtsr,
            0x0c => self.ftsr,
            0x14 => self.pr,
            _ => return None,
        })
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32) -> bool {
        let value = value & 0x7f_ffff;
        match offset {
            0x00 => self.imr = value,
            0x08 => self.rtsr = value,
            0x0c => self.ftsr = value,
            0x10 => self.pr |= value,
            0x14 => self.pr &= !value,
            _ => return false,
        }
        true
    }

    pub(crate) fn read_syscfg(&self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x08..=0x14 => self.exticr[((offset - 8) / 4) as usize],
            0x20 => self.cmpcr | ((self.cmpcr & 1) << 8),
            _ => return None,
        })
    }

    pub(crate) fn write_syscfg(&mut self, offset: u32, value: u32) -> bool {
        match offset {
            0x08..=0x14 => self.exticr[((offset - 8) / 4) as usize] = value & 0xffff,
            0x20 => self.cmpcr = value & 1,
            _ => return false,
        }
        true
    }
}
