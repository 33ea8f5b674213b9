//! Arithmetic of the fast interpreter: values and flags, no memory.

use rsemu::cpu::arm::v7m::isa::{BitfieldOp, DpOp, ExtendOp, MiscOp, ShiftType};

use super::state::Fast;

/// A variable or constant shift and its carry (DDI 0403 A7.4.2).
#[inline]
pub(super) fn shift(ty: ShiftType, value: u32, amount: u32, carry: bool) -> (u32, bool) {
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

/// A data-processing operation with its second operand and shifter carry.
#[inline]
pub(super) fn data_proc(st: &mut Fast, op: DpOp, s: bool, rd: u8, rn: u8, b: u32, carry: bool) {
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

/// MULL and MLAL, signed or not: the 64-bit result.
#[inline]
pub(super) fn mul_long(signed: bool, a: u32, b: u32, accumulator: u64) -> u64 {
    let product = if signed {
        (i64::from(a as i32).wrapping_mul(i64::from(b as i32))) as u64
    } else {
        u64::from(a) * u64::from(b)
    };
    product.wrapping_add(accumulator)
}

/// The upper word of `accumulator:0 ± a · b`, modulo 2^64 (DDI 0403 A7.7, SMMLA), where
/// rsemu 0.0.7 overflows.
#[inline]
pub(super) fn mul_top(a: u32, b: u32, accumulator: u32, sub: bool, round: bool) -> u32 {
    let product = i64::from(a as i32) * i64::from(b as i32);
    let signed = if sub { -product } else { product };
    let sum = (i64::from(accumulator as i32) << 32).wrapping_add(signed);
    (sum.wrapping_add(i64::from(round) << 31) >> 32) as u32
}

/// Sign and zero extension; nothing for those of the DSP extension.
#[inline]
pub(super) fn extend(op: ExtendOp, value: u32) -> Option<u32> {
    Some(match op {
        ExtendOp::Sxtb => i32::from(value as u8 as i8) as u32,
        ExtendOp::Sxth => i32::from(value as u16 as i16) as u32,
        ExtendOp::Uxtb => value & 0xff,
        ExtendOp::Uxth => value & 0xffff,
        ExtendOp::Sxtb16 | ExtendOp::Uxtb16 => return None,
    })
}

/// Counting and reversing of bits and bytes.
#[inline]
pub(super) fn misc(op: MiscOp, v: u32) -> u32 {
    match op {
        MiscOp::Clz => v.leading_zeros(),
        MiscOp::Rbit => v.reverse_bits(),
        MiscOp::Rev => v.swap_bytes(),
        MiscOp::Rev16 => ((v >> 8) & 0x00ff_00ff) | ((v << 8) & 0xff00_ff00),
        MiscOp::Revsh => i32::from((v as u16).swap_bytes() as i16) as u32,
    }
}

/// Extraction of a field from `value`, or its insertion into `old`.
#[inline]
pub(super) fn bitfield(op: BitfieldOp, old: u32, value: u32, lsb: u8, width: u8) -> u32 {
    let (lsb, width) = (u32::from(lsb), u32::from(width));
    let mask = if width >= 32 {
        u32::MAX
    } else {
        (1 << width) - 1
    };
    match op {
        BitfieldOp::Ubfx => (value >> lsb) & mask,
        BitfieldOp::Sbfx => {
            let up = 32 - width;
            ((((value >> lsb) & mask) << up) as i32 >> up) as u32
        }
        BitfieldOp::Bfi => (old & !(mask << lsb)) | ((value & mask) << lsb),
        BitfieldOp::Bfc => old & !(mask << lsb),
    }
}
