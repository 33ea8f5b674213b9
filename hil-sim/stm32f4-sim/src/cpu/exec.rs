//! The fast interpreter: integer code in flash, on RAM and peripherals.
//!
//! It runs predecoded operations until its cycle limit, or until it meets
//! something that it leaves to rsemu: then nothing of that instruction has
//! happened yet. Exceptions, the system block, floating point, the DSP
//! extension, faults and sleep are all rsemu's. The cycle counts are those of
//! rsemu's timing model (one a instruction, one a data access, two for a taken
//! branch, two for a division), so both count the same.

use rsemu::cpu::arm::v7m::isa::{BitfieldOp, DpOp, ExtendOp, MiscOp, ShiftType};
use rsemu::cpu::arm::v7m::xpsr;

use crate::chip::memory::{FLASH_BASE, Memory};

use super::op::{Kind, Op, Slot, decode_at, extend_load};

/// What the core is connected to.
pub(crate) trait Bus {
    /// Flash and RAM.
    fn memory(&mut self) -> &mut Memory;
    /// Reads a peripheral at the given core cycle; nothing if there is none.
    fn io_read(&mut self, addr: u32, bytes: u32, cycle: u64) -> Option<u32>;
    /// Writes a peripheral at the given core cycle; false if there is none.
    fn io_write(&mut self, addr: u32, bytes: u32, value: u32, cycle: u64) -> bool;
    /// Core cycle at which the interpreter has to stop; it may move with every access.
    fn limit(&self) -> u64;
}

/// Why the interpreter stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stop {
    /// The cycle limit.
    Limit,
    /// The next instruction is for rsemu.
    Slow,
    /// Interrupts were unmasked while one was waiting.
    Unmasked,
}

/// The architectural state that the interpreter works on.
#[derive(Clone, Debug)]
pub(crate) struct Fast {
    /// R0 to R14, and the address of the next instruction.
    pub(crate) r: [u32; 16],
    /// N is bit 31 of this.
    n: u32,
    /// Z is set if this is zero.
    z: u32,
    c: bool,
    v: bool,
    /// ITSTATE.
    it: u8,
    /// The bits of xPSR that the interpreter never changes.
    xpsr_rest: u32,
    /// PRIMASK.
    pub(crate) primask: bool,
    /// BASEPRI.
    pub(crate) basepri: u8,
    /// Address tagged by the last load-exclusive.
    exclusive: Option<u32>,
    /// An enabled interrupt waits for PRIMASK or BASEPRI.
    pub(crate) pending_masked: bool,
}

/// NZCV of xPSR.
const NZCV: u32 = xpsr::N | xpsr::Z | xpsr::C | xpsr::V;

impl Fast {
    pub(crate) fn new() -> Self {
        Self {
            r: [0; 16],
            n: 0,
            z: 1,
            c: false,
            v: false,
            it: 0,
            xpsr_rest: xpsr::T,
            primask: false,
            basepri: 0,
            exclusive: None,
            pending_masked: false,
        }
    }

    /// Takes the program status register over.
    pub(crate) fn set_xpsr(&mut self, value: u32) {
        self.n = value & xpsr::N;
        self.z = u32::from(value & xpsr::Z == 0);
        self.c = value & xpsr::C != 0;
        self.v = value & xpsr::V != 0;
        self.it = ((((value >> 10) & 0x3f) << 2) | ((value >> 25) & 3)) as u8;
        self.xpsr_rest = value & !(NZCV | xpsr::IT_MASK);
    }

    /// The program status register.
    pub(crate) fn xpsr(&self) -> u32 {
        let it = u32::from(self.it);
        let mut value = self.xpsr_rest | ((it >> 2) << 10) | ((it & 3) << 25);
        value |= self.n & xpsr::N;
        if self.z == 0 {
            value |= xpsr::Z;
        }
        if self.c {
            value |= xpsr::C;
        }
        if self.v {
            value |= xpsr::V;
        }
        value
    }

    /// Whether the next instruction stands in an IT block.
    pub(crate) fn in_it(&self) -> bool {
        self.it != 0
    }

    /// Forgets the tag of a load-exclusive, as exception entry and return do.
    pub(crate) fn clear_exclusive(&mut self) {
        self.exclusive = None;
    }

    #[inline(always)]
    fn reg(&self, n: u8) -> u32 {
        self.r[(n & 15) as usize]
    }

    #[inline(always)]
    fn set(&mut self, n: u8, value: u32) {
        self.r[(n & 15) as usize] = value;
    }

    #[inline(always)]
    fn set_nz(&mut self, value: u32) {
        self.n = value;
        self.z = value;
    }

    /// `a + b + carry` with all flags.
    #[inline(always)]
    fn add_flags(&mut self, a: u32, b: u32, carry: bool) -> u32 {
        let wide = u64::from(a) + u64::from(b) + u64::from(carry);
        let result = wide as u32;
        self.c = wide >> 32 != 0;
        self.v = (a ^ result) & (b ^ result) & 0x8000_0000 != 0;
        self.set_nz(result);
        result
    }

    /// Condition codes of DDI 0403 A7.3.
    #[inline(always)]
    fn passes(&self, cond: u8) -> bool {
        let n = self.n & xpsr::N != 0;
        let z = self.z == 0;
        let base = match (cond >> 1) & 7 {
            0 => z,
            1 => self.c,
            2 => n,
            3 => self.v,
            4 => self.c && !z,
            5 => n == self.v,
            6 => n == self.v && !z,
            _ => return true,
        };
        base != (cond & 1 != 0)
    }

    /// ITAdvance() (DDI 0403 A7.3.2).
    #[inline(always)]
    fn it_next(it: u8) -> u8 {
        if it & 7 == 0 {
            0
        } else {
            (it & 0xe0) | ((it << 1) & 0x1f)
        }
    }
}

/// A variable or constant shift and its carry (DDI 0403 A7.4.2).
#[inline]
fn shift(ty: ShiftType, value: u32, amount: u32, carry: bool) -> (u32, bool) {
    if let ShiftType::Rrx = ty {
        return ((u32::from(carry) << 31) | (value >> 1), value & 1 != 0);
    }
    if amount == 0 {
        return (value, carry);
    }
    match ty {
        ShiftType::Lsl => match amount {
            1..=31 => (value << amount, (value >> (32 - amount)) & 1 != 0),
            32 => (0, value & 1 != 0),
            _ => (0, false),
        },
        ShiftType::Lsr => match amount {
            1..=31 => (value >> amount, (value >> (amount - 1)) & 1 != 0),
            32 => (0, value >> 31 != 0),
            _ => (0, false),
        },
        ShiftType::Asr => {
            let amount = amount.min(32);
            if amount == 32 {
                let sign = value >> 31 != 0;
                (if sign { u32::MAX } else { 0 }, sign)
            } else {
                (
                    ((value as i32) >> amount) as u32,
                    (value >> (amount - 1)) & 1 != 0,
                )
            }
        }
        _ => {
            let rotated = value.rotate_right(amount & 31);
            (rotated, rotated >> 31 != 0)
        }
    }
}

/// Whether an address is a peripheral that the interpreter reaches itself
/// (the bit-band alias is rsemu's).
#[inline(always)]
fn is_io(addr: u32) -> bool {
    addr >> 28 == 5 || addr >> 25 == 0x4000_0000 >> 25
}

#[inline(always)]
fn load<B: Bus>(bus: &mut B, kind: Kind, addr: u32, cycle: u64, limit: &mut u64) -> Option<u32> {
    let mem = bus.memory();
    let raw = match kind {
        Kind::Word => mem.read32(addr),
        Kind::Half | Kind::SignedHalf => mem.read16(addr),
        Kind::Byte | Kind::SignedByte => mem.read8(addr),
    };
    match raw {
        Some(raw) => Some(extend_load(kind, raw)),
        None => load_io(bus, kind, addr, cycle, limit),
    }
}

#[inline(never)]
fn load_io<B: Bus>(bus: &mut B, kind: Kind, addr: u32, cycle: u64, limit: &mut u64) -> Option<u32> {
    let bytes = bytes_of(kind);
    if !is_io(addr) || !addr.is_multiple_of(bytes) {
        return None;
    }
    let raw = bus.io_read(addr, bytes, cycle)?;
    *limit = bus.limit();
    Some(extend_load(kind, raw))
}

#[inline(always)]
fn store<B: Bus>(
    bus: &mut B,
    kind: Kind,
    addr: u32,
    value: u32,
    cycle: u64,
    limit: &mut u64,
) -> bool {
    let mem = bus.memory();
    let done = match kind {
        Kind::Word => mem.write32(addr, value),
        Kind::Half | Kind::SignedHalf => mem.write16(addr, value),
        Kind::Byte | Kind::SignedByte => mem.write8(addr, value),
    };
    done || store_io(bus, kind, addr, value, cycle, limit)
}

#[inline(never)]
fn store_io<B: Bus>(
    bus: &mut B,
    kind: Kind,
    addr: u32,
    value: u32,
    cycle: u64,
    limit: &mut u64,
) -> bool {
    let bytes = bytes_of(kind);
    if !is_io(addr) || !addr.is_multiple_of(bytes) {
        return false;
    }
    let value = match bytes {
        1 => value & 0xff,
        2 => value & 0xffff,
        _ => value,
    };
    let done = bus.io_write(addr, bytes, value, cycle);
    *limit = bus.limit();
    done
}

fn bytes_of(kind: Kind) -> u32 {
    match kind {
        Kind::Word => 4,
        Kind::Half | Kind::SignedHalf => 2,
        Kind::Byte | Kind::SignedByte => 1,
    }
}

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
                *slot = Slot {
                    op: Op::Slow,
                    len: 2,
                };
            }
        }
    }

    #[inline(always)]
    fn get(&mut self, pc: u32, in_it: bool, mem: &Memory) -> Slot {
        let index = (pc.wrapping_sub(FLASH_BASE) >> 1) as usize;
        let table = if in_it { &self.in_it } else { &self.plain };
        match table.get(index) {
            Some(slot) if !matches!(slot.op, Op::Unknown) => *slot,
            Some(_) => self.fill(index, pc, in_it, mem),
            None => Slot {
                op: Op::Slow,
                len: 2,
            },
        }
    }

    #[cold]
    #[inline(never)]
    fn fill(&mut self, index: usize, pc: u32, in_it: bool, mem: &Memory) -> Slot {
        let slot = decode_at(
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
        );
        let table = if in_it {
            &mut self.in_it
        } else {
            &mut self.plain
        };
        if let Some(to) = table.get_mut(index) {
            *to = slot;
        }
        slot
    }
}

/// Runs until the limit, or until something for rsemu comes. `cycle` is the
/// core's cycle count and is moved on.
#[allow(clippy::too_many_lines)] // One arm per operation.
pub(crate) fn run<B: Bus>(st: &mut Fast, code: &mut Code, bus: &mut B, cycle: &mut u64) -> Stop {
    let mut limit = bus.limit();
    let mut now = *cycle;
    let mut pc = st.r[15];
    // Leaves the loop with the instruction at `pc` not begun.
    macro_rules! stop {
        ($why:expr, $it:expr) => {{
            st.it = $it;
            st.r[15] = pc;
            *cycle = now;
            return $why;
        }};
    }
    loop {
        let it = st.it;
        // Never between the instructions of an IT block: see `Cpu::slow_step`.
        if now >= limit && it == 0 {
            stop!(Stop::Limit, it);
        }
        let slot = code.get(pc, it != 0, bus.memory());
        if it != 0 {
            st.it = Fast::it_next(it);
            if !st.passes(it >> 4) {
                now += 1;
                pc = pc.wrapping_add(u32::from(slot.len));
                continue;
            }
        }
        macro_rules! slow {
            () => {
                stop!(Stop::Slow, it)
            };
        }
        macro_rules! load {
            ($kind:expr, $addr:expr) => {
                match load(bus, $kind, $addr, now + 2, &mut limit) {
                    Some(value) => value,
                    None => slow!(),
                }
            };
        }
        macro_rules! store {
            ($kind:expr, $addr:expr, $value:expr) => {
                if !store(bus, $kind, $addr, $value, now + 2, &mut limit) {
                    slow!()
                }
            };
        }
        let mut next = pc.wrapping_add(u32::from(slot.len));
        match slot.op {
            Op::Unknown | Op::Slow => slow!(),
            Op::Nop => now += 1,
            Op::MovImm { rd, imm } => {
                st.set(rd, imm);
                now += 1;
            }
            Op::MovReg { rd, rm } => {
                st.set(rd, st.reg(rm));
                now += 1;
            }
            Op::MovTop { rd, imm } => {
                st.set(rd, (st.reg(rd) & 0xffff) | (u32::from(imm) << 16));
                now += 1;
            }
            Op::MovsImm { rd, imm } => {
                st.set(rd, imm);
                st.set_nz(imm);
                now += 1;
            }
            Op::AddImm { rd, rn, imm } => {
                st.set(rd, st.reg(rn).wrapping_add(imm));
                now += 1;
            }
            Op::AddReg { rd, rn, rm } => {
                st.set(rd, st.reg(rn).wrapping_add(st.reg(rm)));
                now += 1;
            }
            Op::AddsImm { rd, rn, imm } => {
                let value = st.add_flags(st.reg(rn), imm, false);
                st.set(rd, value);
                now += 1;
            }
            Op::AddsReg { rd, rn, rm } => {
                let value = st.add_flags(st.reg(rn), st.reg(rm), false);
                st.set(rd, value);
                now += 1;
            }
            Op::SubReg { rd, rn, rm } => {
                st.set(rd, st.reg(rn).wrapping_sub(st.reg(rm)));
                now += 1;
            }
            Op::SubsImm { rd, rn, imm } => {
                let value = st.add_flags(st.reg(rn), !imm, true);
                st.set(rd, value);
                now += 1;
            }
            Op::SubsReg { rd, rn, rm } => {
                let value = st.add_flags(st.reg(rn), !st.reg(rm), true);
                st.set(rd, value);
                now += 1;
            }
            Op::CmpImm { rn, imm } => {
                st.add_flags(st.reg(rn), !imm, true);
                now += 1;
            }
            Op::CmpReg { rn, rm } => {
                st.add_flags(st.reg(rn), !st.reg(rm), true);
                now += 1;
            }
            Op::DpImm {
                op,
                s,
                rd,
                rn,
                carry,
                imm,
            } => {
                let carry = if carry == 2 { st.c } else { carry != 0 };
                data_proc(st, op, s, rd, rn, imm, carry);
                now += 1;
            }
            Op::DpReg {
                op,
                s,
                rd,
                rn,
                rm,
                ty,
                amount,
            } => {
                let (b, carry) = shift(ty, st.reg(rm), u32::from(amount), st.c);
                data_proc(st, op, s, rd, rn, b, carry);
                now += 1;
            }
            Op::ShiftReg { ty, s, rd, rn, rm } => {
                let (value, carry) = shift(ty, st.reg(rn), st.reg(rm) & 0xff, st.c);
                st.set(rd, value);
                if s {
                    st.set_nz(value);
                    st.c = carry;
                }
                now += 1;
            }
            Op::Branch { target } => {
                next = target;
                now += 3;
            }
            Op::BranchCond { cond, target } => {
                if st.passes(cond) {
                    next = target;
                    now += 3;
                } else {
                    now += 1;
                }
            }
            Op::BranchLink { target } => {
                st.r[14] = pc.wrapping_add(4) | 1;
                next = target;
                now += 3;
            }
            Op::Bx { rm } => {
                let target = st.reg(rm);
                if target & 1 == 0 || target >= 0xf000_0000 {
                    slow!();
                }
                next = target & !1;
                now += 3;
            }
            Op::Blx { rm } => {
                let target = st.reg(rm);
                if target & 1 == 0 || target >= 0xf000_0000 {
                    slow!();
                }
                st.r[14] = pc.wrapping_add(2) | 1;
                next = target & !1;
                now += 3;
            }
            Op::Cbz {
                nonzero,
                rn,
                target,
            } => {
                if (st.reg(rn) != 0) == nonzero {
                    next = target;
                    now += 3;
                } else {
                    now += 1;
                }
            }
            Op::Table { rn, rm, half, base } => {
                let base = if base != 0 { base } else { st.reg(rn) };
                let mem = bus.memory();
                let entry = if half {
                    let at = base.wrapping_add(st.reg(rm).wrapping_mul(2));
                    if at & 1 != 0 {
                        slow!();
                    }
                    mem.read16(at)
                } else {
                    mem.read8(base.wrapping_add(st.reg(rm)))
                };
                let Some(entry) = entry else { slow!() };
                next = pc.wrapping_add(4).wrapping_add(entry * 2);
                now += 4;
            }
            Op::It { state } => {
                st.it = state;
                now += 1;
            }
            Op::LoadImm { kind, rt, rn, imm } => {
                let addr = st.reg(rn).wrapping_add(imm as u32);
                let value = load!(kind, addr);
                st.set(rt, value);
                now += 2;
            }
            Op::StoreImm { kind, rt, rn, imm } => {
                let addr = st.reg(rn).wrapping_add(imm as u32);
                store!(kind, addr, st.reg(rt));
                now += 2;
            }
            Op::LoadReg {
                kind,
                rt,
                rn,
                rm,
                lsl,
            } => {
                let addr = st.reg(rn).wrapping_add(st.reg(rm) << lsl);
                let value = load!(kind, addr);
                st.set(rt, value);
                now += 2;
            }
            Op::StoreReg {
                kind,
                rt,
                rn,
                rm,
                lsl,
            } => {
                let addr = st.reg(rn).wrapping_add(st.reg(rm) << lsl);
                store!(kind, addr, st.reg(rt));
                now += 2;
            }
            Op::LoadWb {
                kind,
                rt,
                rn,
                pre,
                imm,
            } => {
                let base = st.reg(rn);
                let moved = base.wrapping_add(imm as u32);
                let value = load!(kind, if pre { moved } else { base });
                st.set(rn, moved);
                st.set(rt, value);
                now += 2;
            }
            Op::StoreWb {
                kind,
                rt,
                rn,
                pre,
                imm,
            } => {
                let base = st.reg(rn);
                let moved = base.wrapping_add(imm as u32);
                store!(kind, if pre { moved } else { base }, st.reg(rt));
                st.set(rn, moved);
                now += 2;
            }
            Op::LoadConst { rt, value } => {
                st.set(rt, value);
                now += 2;
            }
            Op::LoadDual {
                rt,
                rt2,
                rn,
                imm,
                pre,
                wback,
            } => {
                let base = st.reg(rn);
                let moved = base.wrapping_add(imm as u32);
                let addr = if pre { moved } else { base };
                let mem = bus.memory();
                if addr & 3 != 0 || !mem.holds(addr, 8, false) {
                    slow!();
                }
                let (a, b) = (mem.read32(addr), mem.read32(addr.wrapping_add(4)));
                let (Some(a), Some(b)) = (a, b) else { slow!() };
                st.set(rt, a);
                st.set(rt2, b);
                if wback {
                    st.set(rn, moved);
                }
                now += 3;
            }
            Op::StoreDual {
                rt,
                rt2,
                rn,
                imm,
                pre,
                wback,
            } => {
                let base = st.reg(rn);
                let moved = base.wrapping_add(imm as u32);
                let addr = if pre { moved } else { base };
                let mem = bus.memory();
                if addr & 3 != 0 || !mem.holds(addr, 8, true) {
                    slow!();
                }
                mem.write32(addr, st.reg(rt));
                mem.write32(addr.wrapping_add(4), st.reg(rt2));
                if wback {
                    st.set(rn, moved);
                }
                now += 3;
            }
            Op::LoadEx { kind, rt, rn, imm } => {
                let addr = st.reg(rn).wrapping_add(u32::from(imm));
                let bytes = bytes_of(kind);
                if !addr.is_multiple_of(bytes) || !bus.memory().holds(addr, bytes, false) {
                    slow!();
                }
                let value = load!(kind, addr);
                st.exclusive = Some(addr);
                st.set(rt, value);
                now += 2;
            }
            Op::StoreEx {
                kind,
                rd,
                rt,
                rn,
                imm,
            } => {
                let addr = st.reg(rn).wrapping_add(u32::from(imm));
                let bytes = bytes_of(kind);
                if !addr.is_multiple_of(bytes) || !bus.memory().holds(addr, bytes, true) {
                    slow!();
                }
                let ok = st.exclusive == Some(addr);
                if ok {
                    store!(kind, addr, st.reg(rt));
                }
                st.exclusive = None;
                st.set(rd, u32::from(!ok));
                now += if ok { 2 } else { 1 };
            }
            Op::ClearEx => {
                st.exclusive = None;
                now += 1;
            }
            Op::LoadMulti {
                rn,
                list,
                wback,
                before,
            } => {
                let base = st.reg(rn);
                let count = list.count_ones();
                let start = if before {
                    base.wrapping_sub(count * 4)
                } else {
                    base
                };
                let mem = bus.memory();
                if start & 3 != 0 || !mem.holds(start, count * 4, false) {
                    slow!();
                }
                let mut pc_value = 0;
                if list & (1 << 15) != 0 {
                    let at = start.wrapping_add((count - 1) * 4);
                    pc_value = mem.read32(at).unwrap_or(0);
                    if pc_value & 1 == 0 || pc_value >= 0xf000_0000 {
                        slow!();
                    }
                }
                if wback {
                    let end = if before {
                        start
                    } else {
                        base.wrapping_add(count * 4)
                    };
                    st.set(rn, end);
                }
                let mut addr = start;
                let mut rest = list & 0x7fff;
                while rest != 0 {
                    let index = rest.trailing_zeros();
                    rest &= rest - 1;
                    st.r[(index & 15) as usize] = mem.read32(addr).unwrap_or(0);
                    addr = addr.wrapping_add(4);
                }
                now += 1 + u64::from(count);
                if list & (1 << 15) != 0 {
                    next = pc_value & !1;
                    now += 2;
                }
            }
            Op::StoreMulti {
                rn,
                list,
                wback,
                before,
            } => {
                let base = st.reg(rn);
                let count = list.count_ones();
                let start = if before {
                    base.wrapping_sub(count * 4)
                } else {
                    base
                };
                let mem = bus.memory();
                if start & 3 != 0 || !mem.holds(start, count * 4, true) {
                    slow!();
                }
                let mut addr = start;
                let mut rest = list;
                while rest != 0 {
                    let index = rest.trailing_zeros();
                    rest &= rest - 1;
                    mem.write32(addr, st.r[(index & 15) as usize]);
                    addr = addr.wrapping_add(4);
                }
                if wback {
                    let end = if before {
                        start
                    } else {
                        base.wrapping_add(count * 4)
                    };
                    st.set(rn, end);
                }
                now += 1 + u64::from(count);
            }
            Op::Mul { rd, rn, rm, s } => {
                let value = st.reg(rn).wrapping_mul(st.reg(rm));
                st.set(rd, value);
                if s {
                    st.set_nz(value);
                }
                now += 1;
            }
            Op::MulAdd {
                rd,
                rn,
                rm,
                ra,
                sub,
            } => {
                let product = st.reg(rn).wrapping_mul(st.reg(rm));
                let value = if sub {
                    st.reg(ra).wrapping_sub(product)
                } else {
                    st.reg(ra).wrapping_add(product)
                };
                st.set(rd, value);
                now += 1;
            }
            Op::MulLong {
                signed,
                accumulate,
                rdlo,
                rdhi,
                rn,
                rm,
            } => {
                let (a, b) = (st.reg(rn), st.reg(rm));
                let acc = if accumulate {
                    (u64::from(st.reg(rdhi)) << 32) | u64::from(st.reg(rdlo))
                } else {
                    0
                };
                let product = if signed {
                    (i64::from(a as i32).wrapping_mul(i64::from(b as i32))) as u64
                } else {
                    u64::from(a) * u64::from(b)
                };
                let value = product.wrapping_add(acc);
                st.set(rdlo, value as u32);
                st.set(rdhi, (value >> 32) as u32);
                now += 2;
            }
            Op::Umaal { rdlo, rdhi, rn, rm } => {
                let value = u64::from(st.reg(rn)) * u64::from(st.reg(rm))
                    + u64::from(st.reg(rdlo))
                    + u64::from(st.reg(rdhi));
                st.set(rdlo, value as u32);
                st.set(rdhi, (value >> 32) as u32);
                now += 2;
            }
            Op::Div { signed, rd, rn, rm } => {
                let (a, b) = (st.reg(rn), st.reg(rm));
                if b == 0 {
                    // DIV_0_TRP is rsemu's to know.
                    slow!();
                }
                let value = if signed {
                    (a as i32).wrapping_div(b as i32) as u32
                } else {
                    a / b
                };
                st.set(rd, value);
                now += 3;
            }
            Op::Extend {
                op,
                rd,
                rn,
                rm,
                rotate,
            } => {
                let value = st.reg(rm).rotate_right(u32::from(rotate));
                let value = match op {
                    ExtendOp::Sxtb => i32::from(value as u8 as i8) as u32,
                    ExtendOp::Sxth => i32::from(value as u16 as i16) as u32,
                    ExtendOp::Uxtb => value & 0xff,
                    ExtendOp::Uxth => value & 0xffff,
                    ExtendOp::Sxtb16 | ExtendOp::Uxtb16 => slow!(),
                };
                let value = if rn == 15 {
                    value
                } else {
                    value.wrapping_add(st.reg(rn))
                };
                st.set(rd, value);
                now += 1;
            }
            Op::Misc { op, rd, rm } => {
                let v = st.reg(rm);
                let value = match op {
                    MiscOp::Clz => v.leading_zeros(),
                    MiscOp::Rbit => v.reverse_bits(),
                    MiscOp::Rev => v.swap_bytes(),
                    MiscOp::Rev16 => ((v >> 8) & 0x00ff_00ff) | ((v << 8) & 0xff00_ff00),
                    MiscOp::Revsh => i32::from((v as u16).swap_bytes() as i16) as u32,
                };
                st.set(rd, value);
                now += 1;
            }
            Op::Bitfield {
                op,
                rd,
                rn,
                lsb,
                width,
            } => {
                let (lsb, width) = (u32::from(lsb), u32::from(width));
                let mask = if width >= 32 {
                    u32::MAX
                } else {
                    (1 << width) - 1
                };
                let value = match op {
                    BitfieldOp::Ubfx => (st.reg(rn) >> lsb) & mask,
                    BitfieldOp::Sbfx => {
                        let up = 32 - width;
                        ((((st.reg(rn) >> lsb) & mask) << up) as i32 >> up) as u32
                    }
                    BitfieldOp::Bfi => (st.reg(rd) & !(mask << lsb)) | ((st.reg(rn) & mask) << lsb),
                    BitfieldOp::Bfc => st.reg(rd) & !(mask << lsb),
                };
                st.set(rd, value);
                now += 1;
            }
            Op::Cps { enable } => {
                st.primask = !enable;
                now += 1;
                if enable && st.pending_masked && st.it == 0 {
                    pc = next;
                    stop!(Stop::Unmasked, st.it);
                }
            }
            Op::MrsBasepri { rd } => {
                st.set(rd, u32::from(st.basepri));
                now += 1;
            }
            Op::MsrBasepri { rn, raise_only } => {
                let new = st.reg(rn) as u8;
                let old = st.basepri;
                if !raise_only || (new != 0 && (old == 0 || new < old)) {
                    st.basepri = new;
                }
                now += 1;
                if st.pending_masked && st.basepri != old && st.it == 0 {
                    pc = next;
                    stop!(Stop::Unmasked, st.it);
                }
            }
            Op::MrsPrimask { rd } => {
                st.set(rd, u32::from(st.primask));
                now += 1;
            }
        }
        pc = next;
    }
}

/// A data-processing operation with its second operand and shifter carry.
#[inline]
fn data_proc(st: &mut Fast, op: DpOp, s: bool, rd: u8, rn: u8, b: u32, carry: bool) {
    let a = st.reg(rn);
    let logical = match op {
        DpOp::And | DpOp::Tst => a & b,
        DpOp::Bic => a & !b,
        DpOp::Orr => a | b,
        DpOp::Orn => a | !b,
        DpOp::Eor | DpOp::Teq => a ^ b,
        DpOp::Mov => b,
        DpOp::Mvn => !b,
        _ => {
            let (x, y, cin) = match op {
                DpOp::Add | DpOp::Cmn => (a, b, false),
                DpOp::Adc => (a, b, st.c),
                DpOp::Sbc => (a, !b, st.c),
                DpOp::Rsb => (!a, b, true),
                _ => (a, !b, true),
            };
            let value = if s {
                st.add_flags(x, y, cin)
            } else {
                x.wrapping_add(y).wrapping_add(u32::from(cin))
            };
            if !op.is_test() {
                st.set(rd, value);
            }
            return;
        }
    };
    if !op.is_test() {
        st.set(rd, logical);
    }
    if s {
        st.set_nz(logical);
        st.c = carry;
    }
}
