//! Code that was decoded before it is run.

use super::decode::decode_at;
use super::op::{Op, Slot};
use crate::chip::memory::{FLASH_BASE, Memory};

/// Left to rsemu.
const LEFT: Slot = Slot {
    op: Op::Slow,
    len: 2,
};

/// Predecoded flash, filled as it is executed. Instructions inside IT blocks
/// decode differently and have a cache of their own.
pub(crate) struct Code {
    plain: Vec<Slot>,
    in_it: Vec<Slot>,
}

impl core::fmt::Debug for Code {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "Code({} half-words)", self.plain.len())
    }
}

impl Code {
    /// A cache for `bytes` of code from the start of the flash.
    pub(crate) fn new(bytes: usize) -> Self {
        Self {
            plain: vec![Slot::UNKNOWN; bytes / 2 + 2],
            in_it: vec![Slot::UNKNOWN; bytes / 2 + 2],
        }
    }

    /// Leaves the instruction at `pc` to rsemu from now on, so that the
    /// interpreter stops before it.
    pub(crate) fn plant(&mut self, pc: u32) {
        let index = (pc.wrapping_sub(FLASH_BASE) >> 1) as usize;
        for table in [&mut self.plain, &mut self.in_it] {
            if let Some(slot) = table.get_mut(index) {
                *slot = LEFT;
            }
        }
    }

    /// The operation at `pc`. By reference: a copy would be stored before its kind is read.
    #[inline(always)]
    pub(super) fn get(&mut self, pc: u32, in_it: bool, mem: &Memory) -> &Slot {
        let index = (pc.wrapping_sub(FLASH_BASE) >> 1) as usize;
        let table = if in_it {
            &mut self.in_it
        } else {
            &mut self.plain
        };
        let Some(slot) = table.get_mut(index) else {
            return &LEFT;
        };
        if matches!(slot.op, Op::Unknown) {
            *slot = decode(pc, in_it, mem);
        }
        slot
    }
}

#[cold]
#[inline(never)]
fn decode(pc: u32, in_it: bool, mem: &Memory) -> Slot {
    decode_at(
        pc,
        in_it,
        |at| mem.read16(at).map(|h| h as u16),
        |at, bytes| {
            // Only flash is constant.
            if at >> 24 != FLASH_BASE >> 24 {
                return None;
            }
            match bytes {
                4 => mem.read32(at),
                2 => mem.read16(at),
                _ => mem.read8(at),
            }
        },
    )
}
