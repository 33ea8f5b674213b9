//! A DMA controller (RM0090 chapter 10).
//!
//! A request of a peripheral is served with one item; the bus cycles that this costs
//! the core are not modelled, nor are bursts, the FIFO's thresholds or
//! memory-to-memory transfers. On its way to a peripheral an item is read before it is
//! asked for: the first when the stream is enabled, each other one when the last was
//! written (10.3.12).

use super::Soc;
use super::rules::{EnabledWrongly, Rule};

/// One transfer that a request asks for: read from, write to, and width.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Transfer {
    /// Address of the peripheral's register.
    pub(crate) peripheral: u32,
    pub(crate) memory: u32,
    /// Width in bytes of an item on the memory's side.
    pub(crate) width: u32,
    /// From the memory to the peripheral.
    pub(crate) to_peripheral: bool,
}

#[derive(Clone, Copy, Debug, Default)]
struct Stream {
    cr: u32,
    ndtr: u32,
    reload: u32,
    par: u32,
    mar: [u32; 2],
    fcr: u32,
    /// Items done since the stream was enabled or wrapped.
    done: u32,
    /// TCIF, HTIF, TEIF, DMEIF, -, FEIF in the order of LISR.
    flags: u32,
    /// The item that waits to be asked for.
    fetched: Option<u32>,
}

const CR_EN: u32 = 1;
const CR_MINC: u32 = 1 << 10;
const CR_CIRC: u32 = 1 << 8;
const FLAG_HALF: u32 = 1 << 4;
const FLAG_COMPLETE: u32 = 1 << 5;

/// Position of a stream's flags in LISR/HISR.
const FLAG_SHIFT: [u32; 4] = [0, 6, 16, 22];

#[derive(Debug, Default)]
pub(crate) struct Dma {
    streams: [Stream; 8],
}

impl Dma {
    /// Address of the peripheral register that stream `s` serves on `channel`,
    /// if the stream is enabled, set to that channel and has items left.
    pub(crate) fn armed(&self, s: usize, channel: u32) -> bool {
        let st = &self.streams[s];
        st.cr & CR_EN != 0 && (st.cr >> 25) & 7 == channel && st.ndtr > 0
    }

    /// Items left.
    pub(crate) fn remaining(&self, s: usize) -> u32 {
        self.streams[s].ndtr
    }

    /// Item that the next request of stream `s` moves.
    pub(crate) fn transfer(&self, s: usize) -> Transfer {
        let st = &self.streams[s];
        let width = 1 << ((st.cr >> 13) & 3).min(2);
        let step = if st.cr & CR_MINC != 0 {
            st.done.wrapping_mul(width)
        } else {
            0
        };
        Transfer {
            peripheral: st.par,
            memory: st.mar[((st.cr >> 19) & 1) as usize].wrapping_add(step),
            width,
            to_peripheral: (st.cr >> 6) & 3 == 1,
        }
    }

    /// An enabled stream that has not read its next item from the memory yet.
    fn unfetched(&self) -> Option<usize> {
        self.streams.iter().position(|st| {
            let to_peripheral = (st.cr >> 6) & 3 == 1;
            st.cr & CR_EN != 0 && st.ndtr > 0 && to_peripheral && st.fetched.is_none()
        })
    }

    /// Returns the stream that a write enables against the rules, and the rule it breaks.
    pub(crate) fn enables_wrongly(
        &self,
        offset: u32,
        value: u32,
    ) -> Option<(usize, EnabledWrongly)> {
        let s = (offset.checked_sub(0x10)? / 0x18) as usize;
        let st = self.streams.get(s)?;
        if !(offset - 0x10).is_multiple_of(0x18) || value & !st.cr & CR_EN == 0 {
            return None;
        }
        if st.flags != 0 {
            return Some((s, EnabledWrongly::WithFlags));
        }
        (value & !CR_EN != st.cr).then_some((s, EnabledWrongly::WhileSetUp))
    }

    /// One item of stream `s` was moved.
    pub(crate) fn item_done(&mut self, s: usize) {
        let st = &mut self.streams[s];
        st.ndtr = st.ndtr.saturating_sub(1);
        st.done = st.done.wrapping_add(1);
        if st.done == st.reload / 2 {
            st.flags |= FLAG_HALF;
        }
        if st.ndtr == 0 {
            st.flags |= FLAG_COMPLETE;
            if st.cr & CR_CIRC != 0 {
                st.ndtr = st.reload;
                st.done = 0;
            } else {
                st.cr &= !CR_EN;
            }
        }
    }

    /// Interrupt request of stream `s`.
    pub(crate) fn irq(&self, s: usize) -> bool {
        let st = &self.streams[s];
        // Enable bits: DMEIE, TEIE, HTIE, TCIE are 1 to 4; their flags 2 to 5.
        let enabled = ((st.cr & 0x1e) << 1) | if st.fcr & 0x80 != 0 { 1 } else { 0 };
        st.flags & enabled != 0
    }

    fn flags(&self, high: bool) -> u32 {
        let first = if high { 4 } else { 0 };
        (0..4)
            .map(|n| self.streams[first + n].flags << FLAG_SHIFT[n])
            .fold(0, |a, b| a | b)
    }

    fn clear(&mut self, high: bool, value: u32) {
        let first = if high { 4 } else { 0 };
        for (n, shift) in FLAG_SHIFT.iter().enumerate() {
            self.streams[first + n].flags &= !((value >> shift) & 0x3d);
        }
    }

    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x00 => self.flags(false),
            0x04 => self.flags(true),
            0x08 | 0x0c => 0,
            0x10..=0xcc => {
                let st = &self.streams[((offset - 0x10) / 0x18) as usize];
                match (offset - 0x10) % 0x18 {
                    0x00 => st.cr,
                    0x04 => st.ndtr,
                    0x08 => st.par,
                    0x0c => st.mar[0],
                    0x10 => st.mar[1],
                    // The FIFO is always empty here.
                    _ => (st.fcr & !0x38) | (4 << 3),
                }
            }
            _ => return None,
        })
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32) -> bool {
        match offset {
            0x08 => self.clear(false, value),
            0x0c => self.clear(true, value),
            0x10..=0xcc => {
                let st = &mut self.streams[((offset - 0x10) / 0x18) as usize];
                let enabled = st.cr & CR_EN != 0;
                match (offset - 0x10) % 0x18 {
                    0x00 => {
                        if !enabled && value & CR_EN != 0 {
                            st.reload = st.ndtr;
                            st.done = 0;
                            st.fetched = None;
                        }
                        if enabled && value & CR_EN == 0 {
                            // The end of the transfer, be it complete or not (10.3.14).
                            st.flags |= FLAG_COMPLETE;
                        }
                        st.cr = value & 0x0fef_ffff;
                    }
                    0x04 if !enabled => st.ndtr = value & 0xffff,
                    0x08 if !enabled => st.par = value,
                    0x0c => st.mar[0] = value,
                    0x10 => st.mar[1] = value,
                    0x14 => st.fcr = value & 0x87,
                    // The manual forbids the others while the stream is enabled.
                    _ => {}
                }
            }
            _ => return false,
        }
        true
    }
}

impl Soc {
    /// Takes the item that stream `s` has for its peripheral; the next one is read.
    pub(super) fn next_item(&mut self, d: usize, s: usize) -> u32 {
        let item = self.dma[d].streams[s].fetched.take();
        self.dma[d].item_done(s);
        self.fetch_items(d);
        item.unwrap_or(0)
    }

    /// Reads what the streams of a controller are going to be asked for.
    pub(super) fn fetch_items(&mut self, d: usize) {
        while let Some(s) = self.dma[d].unfetched() {
            let Transfer { memory, width, .. } = self.dma[d].transfer(s);
            self.require_reachable(memory);
            let item = match width {
                1 => self.mem.read8(memory),
                2 => self.mem.read16(memory),
                _ => self.mem.read32(memory),
            };
            self.dma[d].streams[s].fetched = Some(item.unwrap_or(0));
        }
    }

    /// Writes an item into the memory.
    pub(super) fn store(&mut self, transfer: &Transfer, item: u32) {
        let Transfer { memory, width, .. } = *transfer;
        self.require_reachable(memory);
        match width {
            1 => self.mem.write8(memory, item),
            2 => self.mem.write16(memory, item),
            _ => self.mem.write32(memory, item),
        };
    }

    /// The core-coupled memory is on no bus but the core's (RM0090 2.3.1).
    fn require_reachable(&mut self, memory: u32) {
        if !matches!(memory >> 24, 0x08 | 0x20) {
            self.forbid(Rule::DmaMemory { address: memory });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_down_flags_and_stops() {
        let mut d = Dma::default();
        let s6 = 0x10 + 6 * 0x18;
        d.write(s6 + 4, 2);
        d.write(s6 + 0xc, 0x2000_0100);
        d.write(s6, (1 << 25) | CR_MINC | (1 << 6) | (1 << 4) | CR_EN);
        assert!(d.armed(6, 1));
        assert!(!d.armed(6, 2));
        assert_eq!(d.transfer(6).memory, 0x2000_0100);
        assert!(d.transfer(6).to_peripheral);
        d.item_done(6);
        assert_eq!(d.transfer(6).memory, 0x2000_0101);
        assert!(!d.irq(6));
        d.item_done(6);
        assert!(d.irq(6));
        assert!(!d.armed(6, 1));
        assert_eq!(d.read(4).unwrap() >> 16 & 0x3f, FLAG_COMPLETE | FLAG_HALF);
        d.write(0xc, 0x3d << 16);
        assert!(!d.irq(6));
    }
}
