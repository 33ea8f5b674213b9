//! Code that was decoded before it is run.

use super::decode::decode_at;
use super::op::Op;
use crate::chip::memory::{FLASH_BASE, Memory};

/// Predecoded flash, filled as it is executed. Instructions inside IT blocks
/// decode differently and have a cache of their own.
pub(crate) struct Code {
    plain: Decoded,
    in_it: Decoded,
}

/// Operations and their lengths in bytes, of each half-word.
struct Decoded {
    ops: Vec<Op>,
    lens: Vec<u8>,
}

impl Decoded {
    fn new(half_words: usize) -> Self {
        Self {
            ops: vec![Op::Unknown; half_words],
            lens: vec![2; half_words],
        }
    }
}

impl core::fmt::Debug for Code {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "Code({} half-words)", self.plain.ops.len())
    }
}

impl Code {
    /// A cache for `bytes` of code from the start of the flash.
    pub(crate) fn new(bytes: usize) -> Self {
        let half_words = bytes / 2 + 2;
        Self {
            plain: Decoded::new(half_words),
            in_it: Decoded::new(half_words),
        }
    }

    /// Leaves the instruction at `pc` to rsemu from now on, so that the
    /// interpreter stops before it.
    pub(crate) fn plant(&mut self, pc: u32) {
        let index = (pc.wrapping_sub(FLASH_BASE) >> 1) as usize;
        for table in [&mut self.plain, &mut self.in_it] {
            if let Some(op) = table.ops.get_mut(index) {
                *op = Op::Slow;
            }
        }
    }

    /// The operation at `pc`, and its length. By reference: a copy would be stored before
    /// its kind is read.
    #[inline(always)]
    pub(super) fn get(&mut self, pc: u32, in_it: bool, mem: &Memory) -> (&Op, u32) {
        let index = (pc.wrapping_sub(FLASH_BASE) >> 1) as usize;
        let table = if in_it {
            &mut self.in_it
        } else {
            &mut self.plain
        };
        let (Some(op), Some(len)) = (table.ops.get_mut(index), table.lens.get_mut(index)) else {
            return (&Op::Slow, 2);
        };
        if matches!(op, Op::Unknown) {
            (*op, *len) = decode(pc, in_it, mem);
        }
        (op, u32::from(*len))
    }
}

#[cold]
#[inline(never)]
fn decode(pc: u32, in_it: bool, mem: &Memory) -> (Op, u8) {
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
