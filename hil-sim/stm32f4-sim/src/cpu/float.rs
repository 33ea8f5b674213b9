//! Where rsemu 0.0.7 differs from the ARMv7-M manual (DDI 0403E) in floating point, put
//! right around its step. The test against QEMU found these:
//!
//! | rsemu | the manual |
//! |---|---|
//! | exception entry loads FPSCR from FPDSCR, so that a lazy frame holds the wrong FPSCR, and none comes back from a handler that uses no floating point | the handler's first floating-point instruction does, after the lazy frame was written (ExecuteFPCheck, B1.5.7) |
//! | VMOV between a core register and half of a D register is undefined | A6.6: defined; it is VMOV with the S register there |
//! | VCVT to a fixed-point number of 16 bits leaves the upper half zero | A7.7 VCVT: sign-extended |
//! | the same raises overflow with what saturates | FPToFixed: invalid alone |
//! | VCVT from a fixed-point number rounds as FPSCR says | A7.7 VCVT: to nearest |
//! | a result flushed to zero is inexact | FPRound: underflow alone |
//! | VSUB negates a NaN that it subtracts | FPProcessNaNs: as it was, quiet |
//! | VFMA, VFMS, VFNMA, VFNMS with a NaN do not tell of a subnormal operand that is flushed | FPMulAdd unpacks all three: input denormal |
//! | the same with a quiet NaN to add to infinity times such a one give that NaN | FPMulAdd: infinity times zero, so the default NaN, and invalid |
//! | VCVTB, VCVTT to half precision do not flush a subnormal operand | FPUnpack: flushed, as of a single |
//!
//! Not put right: the alternative half-precision format, whose bit in FPSCR (AHP) rsemu
//! keeps at zero.

use rsemu::cpu::arm::v7m::{ArmV7m, sys};

use crate::chip::memory::{FLASH_BASE, Memory};

const RMODE: u32 = 3 << 22;
const DN: u32 = 1 << 25;
const FZ: u32 = 1 << 24;
const IOC: u32 = 1;
const UFC: u32 = 1 << 3;
const IXC: u32 = 1 << 4;
const IDC: u32 = 1 << 7;
/// The cumulative flags.
const CUMULATIVE: u32 = 0x9f;
/// Tells a quiet NaN from a signalling one.
const QUIET: u32 = 1 << 22;
const DEFAULT_NAN: u32 = 0x7fc0_0000;
/// Where FPSCR lies in the floating-point part of an exception frame (B1.5.6).
const FRAME_FPSCR: u32 = 0x40;

/// The state of floating point before a step.
pub(super) struct Float {
    word: u32,
    fpscr: u32,
    /// FPSCR as the instruction shall see it.
    seen: u32,
    /// A lazy frame at this address was reserved.
    lazy_frame: Option<u32>,
    /// S[d], S[n], S[m] of the encoding.
    operands: [u32; 3],
    /// The half-words in flash that another instruction stands in for.
    replaced: Option<usize>,
}

/// True if a 32-bit instruction is one of the floating-point extension (A5.3.18).
fn is_float(word: u32) -> bool {
    word & 0xfc00_0e00 == 0xec00_0a00 && word >> 24 & 3 != 3
}

impl Float {
    /// Prepares the step that runs the instruction `word`; `executed` is false if its
    /// condition fails or another instruction stands there.
    pub(super) fn before(
        arm: &ArmV7m,
        memory: &mut Memory,
        (pc, word, executed): (u32, u32, bool),
        control: u32,
    ) -> Self {
        let fpscr = arm.fpscr();
        let mut float = Self {
            word: if executed && is_float(word) { word } else { 0 },
            fpscr,
            seen: fpscr,
            lazy_frame: None,
            operands: [0; 3],
            replaced: None,
        };
        if float.word == 0 {
            return float;
        }
        let (fpccr, fpcar, fpdscr) = arm.with_sys(|s| (s.fpccr, s.fpcar, s.fpdscr));
        if fpccr & sys::fpccr::ASPEN != 0 && control & sys::control::FPCA == 0 {
            float.seen = fpdscr;
            float.lazy_frame = (fpccr & sys::fpccr::LSPACT != 0).then_some(fpcar);
        }
        let mut set = float.seen;
        if float.computes() {
            float.operands = registers(word).map(|n| arm.s(n));
            set &= !CUMULATIVE;
            if float.is_fixed() && word & 1 << 18 == 0 {
                set &= !RMODE;
            }
        }
        arm.set_fpscr(set);
        if let Some(single) = scalar_as_single(word) {
            let at = pc.wrapping_sub(FLASH_BASE) as usize;
            if let Some(code) = memory.flash.get_mut(at..at + 4) {
                put(code, single);
                float.replaced = Some(at);
            }
        }
        float
    }

    /// Puts the state right after the step. `entered`: an exception was entered
    /// instead of, or by, the instruction.
    pub(super) fn after(self, arm: &ArmV7m, memory: &mut Memory, entered: bool) {
        if let Some(at) = self.replaced
            && let Some(code) = memory.flash.get_mut(at..at + 4)
        {
            put(code, self.word);
        }
        if entered {
            arm.set_fpscr(self.fpscr);
            return;
        }
        if self.word == 0 {
            return;
        }
        if let Some(frame) = self.lazy_frame {
            memory.write32(frame.wrapping_add(FRAME_FPSCR), self.fpscr);
        }
        if !self.computes() {
            return;
        }
        let now = arm.fpscr();
        let mut raised = now & CUMULATIVE;
        if self.is_fixed() && self.word & 1 << 18 != 0 {
            raised &= if raised & IOC != 0 { IOC } else { IXC | IDC };
            // Signed, of 16 bits.
            if self.word & (1 << 16 | 1 << 7) == 0 {
                let [d, ..] = registers(self.word);
                arm.set_s(d, i32::from(arm.s(d) as u16 as i16) as u32);
            }
        } else if self.is_half() {
            self.flush_half(arm, &mut raised);
        } else if self.seen & FZ != 0 && raised & UFC != 0 && self.is_exact() {
            raised &= !IXC;
        }
        if let Some(nan) = self.subtracted_nan() {
            let [d, ..] = registers(self.word);
            arm.set_s(d, nan);
        }
        if self.is_fused() && self.seen & FZ != 0 {
            let subnormal = |bits: u32| f32::from_bits(bits).is_subnormal();
            let infinite = |bits: u32| f32::from_bits(bits).is_infinite();
            let [added, n, m] = self.operands;
            if [added, n, m].into_iter().any(subnormal) {
                raised |= IDC;
            }
            let product = (infinite(n) && subnormal(m)) || (subnormal(n) && infinite(m));
            if product && f32::from_bits(added).is_nan() && added & QUIET != 0 {
                let [d, ..] = registers(self.word);
                arm.set_s(d, DEFAULT_NAN);
                raised |= IOC;
            }
        }
        let kept = now & !(CUMULATIVE | RMODE);
        arm.set_fpscr(kept | self.seen & (CUMULATIVE | RMODE) | raised);
    }

    /// True if it is a data-processing instruction (A6.4).
    fn computes(&self) -> bool {
        self.word & 0xff00_0e10 == 0xee00_0a00
    }

    /// VCVT between a single and a fixed-point number.
    fn is_fixed(&self) -> bool {
        self.word & 0xffba_0e50 == 0xeeba_0a40
    }

    /// VCVTB, VCVTT.
    fn is_half(&self) -> bool {
        self.word & 0xffbe_0e50 == 0xeeb2_0a40
    }

    /// Result of VSUB if its second operand is the NaN that counts: a signalling one
    /// before a quiet one, then the first before the second.
    fn subtracted_nan(&self) -> Option<u32> {
        let [_, n, m] = self.operands;
        let nan = |bits| f32::from_bits(bits).is_nan();
        let signalling = |bits| nan(bits) && bits & QUIET == 0;
        let counts = (signalling(m) && !signalling(n)) || (nan(m) && !nan(n));
        let subtracts = self.word & 0xffb0_0e50 == 0xee30_0a40;
        (subtracts && counts && self.seen & DN == 0).then_some(m | QUIET)
    }

    /// VFMA, VFMS, VFNMA, VFNMS.
    fn is_fused(&self) -> bool {
        matches!(self.word & 0xffb0_0e10, 0xee90_0a00 | 0xeea0_0a00)
    }

    /// Flushes the subnormal operand of a conversion to half precision to zero.
    fn flush_half(&self, arm: &ArmV7m, raised: &mut u32) {
        let [.., m] = self.operands;
        let to_half = self.word & 1 << 16 != 0;
        if to_half && self.seen & FZ != 0 && f32::from_bits(m).is_subnormal() {
            let [d, ..] = registers(self.word);
            let shift = if self.word & 1 << 7 == 0 { 0 } else { 16 };
            let zero = m >> 31 << 15;
            arm.set_s(d, arm.s(d) & !(0xffff << shift) | zero << shift);
            *raised = IDC;
        }
    }

    /// True if nothing but the flush to zero was inexact. VMLA, VMLS, VNMLA and VNMLS
    /// round twice, and a product that is not flushed may be inexact by itself.
    fn is_exact(&self) -> bool {
        if self.word & 0xffa0_0e10 != 0xee00_0a00 {
            return true;
        }
        let [_, n, m] = self.operands;
        // Exact: 24 bits each, and the exponents fit.
        let product = f64::from(f32::from_bits(n)) * f64::from(f32::from_bits(m));
        product.abs() < f64::from(f32::MIN_POSITIVE) || f64::from(product as f32) == product
    }
}

/// Numbers of S[d], S[n], S[m] (A6.4).
fn registers(word: u32) -> [u8; 3] {
    let number = |four: u32, one: u32| ((word >> four & 15) << 1 | word >> one & 1) as u8;
    [number(12, 22), number(16, 7), number(0, 5)]
}

/// VMOV between a core register and half of a D register, as the one with the S register
/// that is this half.
fn scalar_as_single(word: u32) -> Option<u32> {
    (word & 0xffc0_0fff == 0xee00_0b10).then(|| {
        let half = word >> 21 & 1;
        word & 0xffdf_feff | half << 7
    })
}

/// Writes a 32-bit instruction.
fn put(code: &mut [u8], word: u32) {
    for (to, half) in code.chunks_exact_mut(2).zip([word >> 16, word]) {
        to.copy_from_slice(&(half as u16).to_le_bytes());
    }
}
