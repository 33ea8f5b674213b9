//! Loads and stores of the fast interpreter.

use super::decode::extend_load;
use super::op::Kind;
use super::state::Fast;
use crate::bus::Bus;
use crate::chip::memory::{Memory, is_flash};

/// Cycles of a load or a store that waits for nothing.
pub(super) const ACCESS: u64 = 2;

/// True if an address is a peripheral that the interpreter reaches itself
/// (the bit-band alias is rsemu's).
#[inline(always)]
fn is_io(addr: u32) -> bool {
    addr >> 28 == 5 || addr >> 25 == 0x4000_0000 >> 25
}

/// A peripheral's answer: the value, and the cycles that the bus waited.
type Answered<T> = Option<(T, u64)>;

/// A load at cycle `now`, which it moves on by the waits. After a peripheral the limit is another.
#[inline(always)]
pub(super) fn load<B: Bus>(
    bus: &mut B,
    kind: Kind,
    addr: u32,
    now: &mut u64,
    limit: &mut u64,
) -> Option<u32> {
    let mem = bus.memory();
    if mem.guards(addr, 4) {
        return None;
    }
    let raw = match kind {
        Kind::Word => mem.read32(addr),
        Kind::Half | Kind::SignedHalf => mem.read16(addr),
        Kind::Byte | Kind::SignedByte => mem.read8(addr),
    };
    if let Some(raw) = raw {
        if is_flash(addr) {
            *now += bus.flash_waits();
        }
        return Some(extend_load(kind, raw));
    }
    let (raw, waits) = load_io(bus, kind, addr, *now)?;
    *now += waits;
    *limit = bus.limit();
    Some(raw)
}

// By value, as in `store_io`: a reference would keep the caller's counter out of a register.
#[inline(never)]
fn load_io<B: Bus>(bus: &mut B, kind: Kind, addr: u32, now: u64) -> Answered<u32> {
    let bytes = bytes_of(kind);
    if !is_io(addr) || !addr.is_multiple_of(bytes) {
        return None;
    }
    let waits = bus.io_waits(addr);
    let raw = bus.io_read(addr, bytes, now + ACCESS + waits)?;
    Some((extend_load(kind, raw), waits))
}

/// A store, as [`load`].
#[inline(always)]
pub(super) fn store<B: Bus>(
    bus: &mut B,
    kind: Kind,
    addr: u32,
    value: u32,
    now: &mut u64,
    limit: &mut u64,
) -> bool {
    let mem = bus.memory();
    if mem.guards(addr, 4) {
        return false;
    }
    let done = match kind {
        Kind::Word => mem.write32(addr, value),
        Kind::Half | Kind::SignedHalf => mem.write16(addr, value),
        Kind::Byte | Kind::SignedByte => mem.write8(addr, value),
    };
    if done {
        return true;
    }
    let answered = store_io(bus, kind, addr, value, *now);
    *limit = bus.limit();
    let Some(((), waits)) = answered else {
        return false;
    };
    *now += waits;
    true
}

#[inline(never)]
fn store_io<B: Bus>(bus: &mut B, kind: Kind, addr: u32, value: u32, now: u64) -> Answered<()> {
    let bytes = bytes_of(kind);
    if !is_io(addr) || !addr.is_multiple_of(bytes) {
        return None;
    }
    let value = match bytes {
        1 => value & 0xff,
        2 => value & 0xffff,
        _ => value,
    };
    let waits = bus.io_waits(addr);
    bus.io_write(addr, bytes, value, now + ACCESS + waits)
        .then_some(((), waits))
}

pub(super) fn bytes_of(kind: Kind) -> u32 {
    match kind {
        Kind::Word => 4,
        Kind::Half | Kind::SignedHalf => 2,
        Kind::Byte | Kind::SignedByte => 1,
    }
}

/// The first address of a transfer of several registers, and the base after it.
#[inline]
fn span(base: u32, count: u32, before: bool) -> (u32, u32) {
    if before {
        let start = base.wrapping_sub(count * 4);
        (start, start)
    } else {
        (base, base.wrapping_add(count * 4))
    }
}

/// The first address of a transfer of the registers of `list`.
#[inline]
pub(super) fn multi_start(st: &Fast, rn: u8, list: u16, before: bool) -> u32 {
    span(st.reg(rn), list.count_ones(), before).0
}

/// Number of lines of the flash, of 16 bytes, that a transfer of several registers reads.
#[inline]
pub(super) fn flash_lines(addr: u32, bytes: u32) -> u64 {
    if !is_flash(addr) || bytes == 0 {
        return 0;
    }
    u64::from((addr.wrapping_add(bytes - 1) >> 4).wrapping_sub(addr >> 4)) + 1
}

/// LDM: loads the registers of `list`. Returns the new program counter, if that is
/// among them; nothing if it is not for the interpreter.
#[inline]
pub(super) fn load_multi(
    st: &mut Fast,
    mem: &Memory,
    rn: u8,
    list: u16,
    wback: bool,
    before: bool,
) -> Option<Option<u32>> {
    let count = list.count_ones();
    let (start, end) = span(st.reg(rn), count, before);
    if start & 3 != 0 || !mem.holds(start, count * 4, false) {
        return None;
    }
    let mut target = None;
    if list & (1 << 15) != 0 {
        let at = start.wrapping_add((count - 1) * 4);
        let value = mem.read32(at).unwrap_or(0);
        if value & 1 == 0 || value >= 0xf000_0000 {
            return None;
        }
        target = Some(value & !1);
    }
    if wback {
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
    Some(target)
}

/// STM: stores the registers of `list`; false if it is not for the interpreter.
#[inline]
pub(super) fn store_multi(
    st: &mut Fast,
    mem: &mut Memory,
    rn: u8,
    list: u16,
    wback: bool,
    before: bool,
) -> bool {
    let count = list.count_ones();
    let (start, end) = span(st.reg(rn), count, before);
    if start & 3 != 0 || !mem.holds(start, count * 4, true) {
        return false;
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
        st.set(rn, end);
    }
    true
}
