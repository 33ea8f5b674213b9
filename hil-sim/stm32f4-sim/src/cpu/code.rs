//! Code that was decoded before it is run.

use std::collections::HashMap;

use super::decode::decode_at;
use super::op::Op;
use super::state::Fast;
use crate::chip::memory::{FLASH_BASE, Memory};

/// Predecoded flash, filled as it is executed: runs of instructions that follow each other, so
/// that the next one of most is the next in the computer's cache.
pub(crate) struct Code {
    /// Where in `steps` the instruction at each half-word is; 0 if it is not decoded yet.
    places: Vec<u32>,
    /// The same of instructions where an IT block is gone on with, by address and ITSTATE.
    in_block: HashMap<(u32, u8), u32>,
    steps: Vec<Step>,
    /// Addresses whose instructions are left to rsemu.
    planted: Vec<u32>,
}

/// An instruction of a run.
#[derive(Clone, Copy)]
pub(super) struct Step {
    pub(super) op: Op,
    /// Length in bytes.
    pub(super) len: u8,
    /// ITSTATE at the instruction, and after it.
    pub(super) it: u8,
    pub(super) it_after: u8,
}

/// Placeholder for code that is not in the flash.
const SLOW: Step = Step {
    op: Op::Slow,
    len: 2,
    it: 0,
    it_after: 0,
};

impl core::fmt::Debug for Code {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "Code({} half-words)", self.places.len())
    }
}

impl Code {
    /// A cache for `bytes` of code from the start of the flash.
    pub(crate) fn new(bytes: usize) -> Self {
        Self {
            places: vec![0; bytes / 2 + 2],
            in_block: HashMap::new(),
            steps: vec![SLOW],
            planted: Vec::new(),
        }
    }

    /// Leaves the instruction at `pc` to rsemu from now on, so that the
    /// interpreter stops before it.
    pub(crate) fn plant(&mut self, pc: u32) {
        self.planted.push(pc);
        self.places.fill(0);
        self.in_block.clear();
        self.steps.truncate(1);
    }

    fn index(pc: u32) -> usize {
        (pc.wrapping_sub(FLASH_BASE) >> 1) as usize
    }

    /// The instruction at `pc`, where ITSTATE is `it`, and those that follow it up to a jump.
    /// By reference: a copy would be stored before its kind is read.
    #[inline(always)]
    pub(super) fn from(&mut self, pc: u32, it: u8, mem: &Memory) -> (&Step, &[Step]) {
        let place = match self.places.get(Self::index(pc)) {
            Some(&place) if it == 0 && place != 0 => place as usize,
            Some(_) => self.decoded(pc, it, mem),
            None => 0,
        };
        let steps = self.steps.get(place..).and_then(<[Step]>::split_first);
        steps.unwrap_or((&SLOW, &[]))
    }

    #[cold]
    #[inline(never)]
    fn decoded(&mut self, start: u32, mut it: u8, mem: &Memory) -> usize {
        if let Some(&place) = self.in_block.get(&(start, it)) {
            return place as usize;
        }
        let begin = self.steps.len();
        if it != 0 {
            self.in_block.insert((start, it), begin as u32);
        }
        let (mut pc, mut ends) = (start, false);
        loop {
            let place = self.places.get_mut(Self::index(pc));
            ends |= place.as_ref().is_none_or(|place| it == 0 && **place != 0);
            if ends {
                // Under any condition.
                self.steps.push(Step {
                    op: Op::Next,
                    len: 0,
                    it: 0,
                    it_after: it,
                });
                return begin;
            }
            if let Some(place) = place.filter(|_| it == 0) {
                *place = self.steps.len() as u32;
            }
            let (op, len) = if self.planted.contains(&pc) {
                (Op::Slow, 2)
            } else {
                decode(pc, it != 0, mem)
            };
            let it_after = match op {
                Op::It { state } => state,
                _ => Fast::it_next(it),
            };
            self.steps.push(Step {
                op,
                len,
                it,
                it_after,
            });
            ends = op.is_jump();
            it = it_after;
            pc = pc.wrapping_add(u32::from(len));
        }
    }
}

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
