//! The registers that the fast interpreter works on.

use rsemu::cpu::arm::v7m::xpsr;

/// The architectural state that the interpreter works on.
#[derive(Clone, Debug)]
pub(crate) struct Fast {
    /// R0 to R14, and the address of the next instruction.
    pub(crate) r: [u32; 16],
    /// N is bit 31 of this.
    pub(super) n: u32,
    /// Z is set if this is zero.
    pub(super) z: u32,
    pub(super) c: bool,
    pub(super) v: bool,
    /// ITSTATE.
    pub(super) it: u8,
    /// The bits of xPSR that the interpreter never changes.
    pub(super) xpsr_rest: u32,
    /// PRIMASK.
    pub(crate) primask: bool,
    /// BASEPRI.
    pub(crate) basepri: u8,
    /// Address tagged by the last load-exclusive.
    pub(super) exclusive: Option<u32>,
    /// An enabled interrupt waits for PRIMASK or BASEPRI.
    pub(crate) pending_masked: bool,
    /// DWT_CYCCNT minus the core's cycle count, while the counter runs.
    pub(crate) cycle_counter: Option<u32>,
    /// The line of the flash that the last instruction came from: its address over 16.
    pub(crate) line: u32,
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
            cycle_counter: None,
            line: u32::MAX,
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
        let mut value = self.xpsr_rest | Self::it_bits(self.it);
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

    /// True if the next instruction stands in an IT block.
    pub(crate) fn in_it(&self) -> bool {
        self.it != 0
    }

    /// True if the next instruction's condition holds.
    pub(crate) fn executes(&self) -> bool {
        self.it == 0 || self.passes(self.it >> 4)
    }

    /// Forgets the tag of a load-exclusive, as exception entry and return do.
    pub(crate) fn clear_exclusive(&mut self) {
        self.exclusive = None;
    }

    #[inline(always)]
    pub(super) fn reg(&self, n: u8) -> u32 {
        self.r[(n & 15) as usize]
    }

    #[inline(always)]
    pub(super) fn set(&mut self, n: u8, value: u32) {
        self.r[(n & 15) as usize] = value;
    }

    #[inline(always)]
    pub(super) fn set_nz(&mut self, value: u32) {
        self.n = value;
        self.z = value;
    }

    /// `a + b + carry` with all flags.
    #[inline(always)]
    pub(super) fn add_flags(&mut self, a: u32, b: u32, carry: bool) -> u32 {
        let wide = u64::from(a) + u64::from(b) + u64::from(carry);
        let result = wide as u32;
        self.c = wide >> 32 != 0;
        self.v = (a ^ result) & (b ^ result) & 0x8000_0000 != 0;
        self.set_nz(result);
        result
    }

    /// Condition codes of DDI 0403 A7.3.
    #[inline(always)]
    pub(super) fn passes(&self, cond: u8) -> bool {
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

    /// ITSTATE where xPSR has it.
    pub(super) fn it_bits(it: u8) -> u32 {
        let it = u32::from(it);
        ((it >> 2) << 10) | ((it & 3) << 25)
    }

    /// ITAdvance() (DDI 0403 A7.3.2).
    #[inline(always)]
    pub(super) fn it_next(it: u8) -> u8 {
        if it & 7 == 0 {
            0
        } else {
            (it & 0xe0) | ((it << 1) & 0x1f)
        }
    }
}
