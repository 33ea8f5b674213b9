//! The fast interpreter: integer code in flash, on RAM and peripherals.
//!
//! It runs predecoded operations, as they follow each other in [`Code`], until its cycle
//! limit, or until it meets something that it leaves to rsemu: then nothing of that
//! instruction has happened yet. Exceptions, the system block but for the cycle counter, floating
//! point, the DSP extension, faults and sleep are all rsemu's. The cycle counts are those of
//! rsemu's timing model (one a instruction, one a data access, two for a taken
//! branch, two for a division), so both count the same; and the wait states of the
//! flash and of the buses ([`Bus`]).

use super::access::{
    ACCESS, bytes_of, flash_lines, load, load_multi, multi_start, store, store_multi,
};
use super::alu::{bitfield, data_proc, extend, misc, mul_long, mul_top, shift};
use super::code::Code;
use super::op::{Kind, Op};
use super::state::Fast;
use crate::bus::Bus;

/// The cycle counter (DDI 0403 C1.8.8), which the firmware's meters read on each wake-up.
pub(super) const DWT_CYCCNT: u32 = 0xe000_1004;

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

/// Runs until the limit, or until something for rsemu comes. `cycle` is the
/// core's cycle count and is moved on.
// One arm for each operation, in one loop: a call for each would halve its speed.
#[allow(clippy::too_many_lines, reason = "one arm for each operation")]
pub(crate) fn run<B: Bus>(st: &mut Fast, code: &mut Code, bus: &mut B, cycle: &mut u64) -> Stop {
    let mut limit = bus.limit();
    let flash_waits = bus.flash_waits();
    let mut now = *cycle;
    let mut pc = st.r[15];
    // Never between the instructions of an IT block: see `Cpu::slow_step`.
    if now >= limit && st.it == 0 {
        return Stop::Limit;
    }
    if pc >> 4 != st.line {
        now += flash_waits;
    }
    let (mut step, mut steps) = code.from(pc, st.it, bus.memory());
    // Leaves the loop before the instruction at `$next`.
    macro_rules! stop {
        ($why:expr, $next:expr, $it:expr) => {{
            st.line = pc >> 4;
            st.it = $it;
            st.r[15] = $next;
            *cycle = now;
            return $why;
        }};
    }
    loop {
        macro_rules! slow {
            () => {
                stop!(Stop::Slow, pc, step.it)
            };
        }
        macro_rules! load {
            ($kind:expr, $addr:expr) => {
                match load(bus, $kind, $addr, &mut now, &mut limit) {
                    Some(value) => value,
                    None => match st.cycle_counter {
                        Some(ahead) if $addr == DWT_CYCCNT && $kind == Kind::Word => {
                            ahead.wrapping_add(now as u32)
                        }
                        _ => slow!(),
                    },
                }
            };
        }
        macro_rules! store {
            ($kind:expr, $addr:expr, $value:expr) => {
                if !store(bus, $kind, $addr, $value, &mut now, &mut limit) {
                    slow!()
                }
            };
        }
        let following = pc.wrapping_add(u32::from(step.len));
        let mut next = following;
        macro_rules! unmask {
            ($enable:expr) => {{
                let enable = $enable;
                st.primask = !enable;
                now += 1;
                if enable && st.pending_masked && step.it_after == 0 {
                    stop!(Stop::Unmasked, next, 0);
                }
            }};
        }
        let is_skipped = step.it != 0 && !st.passes(step.it >> 4);
        match *(if is_skipped { &Op::Nop } else { &step.op }) {
            Op::Slow => slow!(),
            Op::Next => {
                let it = step.it_after;
                (step, steps) = code.from(pc, it, bus.memory());
                continue;
            }
            Op::Nop | Op::It { .. } => now += 1,
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
                carry,
                rd_rn,
                imm,
            } => {
                let (s, carry) = (carry != 3, if carry == 2 { st.c } else { carry == 1 });
                data_proc(st, op, s, rd_rn & 15, rd_rn >> 4, imm, carry);
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
                let at = base.wrapping_add(st.reg(rm) << u32::from(half));
                if half && at & 1 != 0 {
                    slow!();
                }
                let entry = if half { mem.read16(at) } else { mem.read8(at) };
                let Some(entry) = entry else { slow!() };
                now += flash_waits * flash_lines(at, 1);
                next = pc.wrapping_add(4).wrapping_add(entry * 2);
                now += 4;
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
                let moved = base.wrapping_add_signed(i32::from(imm));
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
                let moved = base.wrapping_add_signed(i32::from(imm));
                store!(kind, if pre { moved } else { base }, st.reg(rt));
                st.set(rn, moved);
                now += 2;
            }
            Op::LoadConst { rt, value } => {
                st.set(rt, value);
                now += ACCESS + flash_waits;
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
                let moved = base.wrapping_add_signed(i32::from(imm));
                let addr = if pre { moved } else { base };
                let mem = bus.memory();
                if addr & 3 != 0 || !mem.holds(addr, 8, false) {
                    slow!();
                }
                let (a, b) = (mem.read32(addr), mem.read32(addr.wrapping_add(4)));
                let (Some(a), Some(b)) = (a, b) else { slow!() };
                now += flash_waits * flash_lines(addr, 8);
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
                let moved = base.wrapping_add_signed(i32::from(imm));
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
                let start = multi_start(st, rn, list, before);
                let Some(target) = load_multi(st, bus.memory(), rn, list, wback, before) else {
                    slow!()
                };
                now += flash_waits * flash_lines(start, list.count_ones() * 4);
                now += 1 + u64::from(list.count_ones());
                if let Some(target) = target {
                    next = target;
                    now += 2;
                }
            }
            Op::StoreMulti {
                rn,
                list,
                wback,
                before,
            } => {
                if !store_multi(st, bus.memory(), rn, list, wback, before) {
                    slow!();
                }
                now += 1 + u64::from(list.count_ones());
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
                let value = mul_long(signed, a, b, acc);
                st.set(rdlo, value as u32);
                st.set(rdhi, (value >> 32) as u32);
                now += 2;
            }
            Op::MulTop {
                rd,
                rn,
                rm,
                ra,
                sub,
                round,
            } => {
                let accumulator = if ra == 15 { 0 } else { st.reg(ra) };
                let value = mul_top(st.reg(rn), st.reg(rm), accumulator, sub, round);
                st.set(rd, value);
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
                let Some(value) = extend(op, value) else {
                    slow!()
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
                st.set(rd, misc(op, st.reg(rm)));
                now += 1;
            }
            Op::Bitfield {
                op,
                rd,
                rn,
                lsb,
                width,
            } => {
                st.set(rd, bitfield(op, st.reg(rd), st.reg(rn), lsb, width));
                now += 1;
            }
            Op::Cps { enable } => unmask!(enable),
            Op::MsrPrimask { rn } => unmask!(st.reg(rn) & 1 == 0),
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
                if st.pending_masked && st.basepri != old && step.it_after == 0 {
                    stop!(Stop::Unmasked, next, 0);
                }
            }
            Op::MrsPrimask { rd } => {
                st.set(rd, u32::from(st.primask));
                now += 1;
            }
        }
        if now >= limit && step.it_after == 0 {
            stop!(Stop::Limit, next, 0);
        }
        let (line, it) = (pc >> 4, step.it_after);
        pc = next;
        (step, steps) = match steps.split_first() {
            Some(after) if next == following => after,
            _ => code.from(pc, it, bus.memory()),
        };
        if pc >> 4 != line {
            now += flash_waits;
        }
    }
}
