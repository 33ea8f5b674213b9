//! Predecoded instructions.
//!
//! rsemu decodes an instruction every time it runs. Here it is decoded once
//! (by rsemu's own decoder) into a compact operation with everything that is
//! known beforehand folded in: branch targets, literal values, immediates.
//! An instruction without a compact form becomes [`Op::Slow`] and is run by rsemu.

use rsemu::cpu::arm::v7m::isa::{BitfieldOp, DpOp, ExtendOp, MiscOp, ShiftType};

/// Width of a load or store, and extension of a load.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Word,
    Half,
    Byte,
    SignedHalf,
    SignedByte,
}

/// One operation of the fast interpreter. Register numbers are 0 to 14: every
/// use of the program counter as an operand is resolved when decoding or is [`Op::Slow`].
/// Eight bytes: the code of a firmware shall stay in the computer's cache.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Op {
    /// The run ends here; the instruction at this address is decoded elsewhere.
    Next,
    /// Left to rsemu.
    Slow,
    Nop,
    MovImm {
        rd: u8,
        imm: u32,
    },
    MovReg {
        rd: u8,
        rm: u8,
    },
    MovTop {
        rd: u8,
        imm: u16,
    },
    /// `MOVS #imm`; the carry stays.
    MovsImm {
        rd: u8,
        imm: u32,
    },
    AddImm {
        rd: u8,
        rn: u8,
        imm: u32,
    },
    AddReg {
        rd: u8,
        rn: u8,
        rm: u8,
    },
    AddsImm {
        rd: u8,
        rn: u8,
        imm: u32,
    },
    AddsReg {
        rd: u8,
        rn: u8,
        rm: u8,
    },
    SubReg {
        rd: u8,
        rn: u8,
        rm: u8,
    },
    SubsImm {
        rd: u8,
        rn: u8,
        imm: u32,
    },
    SubsReg {
        rd: u8,
        rn: u8,
        rm: u8,
    },
    CmpImm {
        rn: u8,
        imm: u32,
    },
    CmpReg {
        rn: u8,
        rm: u8,
    },
    /// Any data-processing operation with an immediate, whose carry is 0, 1 or 2 for
    /// unchanged; 3 leaves all flags alone. `rd` and `rn` share a byte, `rn` the upper half.
    DpImm {
        op: DpOp,
        carry: u8,
        rd_rn: u8,
        imm: u32,
    },
    /// Any data-processing operation with a register shifted by a constant.
    DpReg {
        op: DpOp,
        s: bool,
        rd: u8,
        rn: u8,
        rm: u8,
        ty: ShiftType,
        amount: u8,
    },
    ShiftReg {
        ty: ShiftType,
        s: bool,
        rd: u8,
        rn: u8,
        rm: u8,
    },
    Branch {
        target: u32,
    },
    BranchCond {
        cond: u8,
        target: u32,
    },
    BranchLink {
        target: u32,
    },
    Bx {
        rm: u8,
    },
    Blx {
        rm: u8,
    },
    Cbz {
        nonzero: bool,
        rn: u8,
        target: u32,
    },
    /// `TBB`/`TBH`; `base` is the table if the base register is the PC, else 0.
    Table {
        rn: u8,
        rm: u8,
        half: bool,
        base: u32,
    },
    It {
        state: u8,
    },
    /// `[rn + imm]`, no write-back.
    LoadImm {
        kind: Kind,
        rt: u8,
        rn: u8,
        imm: i32,
    },
    StoreImm {
        kind: Kind,
        rt: u8,
        rn: u8,
        imm: i32,
    },
    /// `[rn + (rm << lsl)]`.
    LoadReg {
        kind: Kind,
        rt: u8,
        rn: u8,
        rm: u8,
        lsl: u8,
    },
    StoreReg {
        kind: Kind,
        rt: u8,
        rn: u8,
        rm: u8,
        lsl: u8,
    },
    /// Write-back of `rn + imm`; the access is there (`pre`) or at `rn`.
    LoadWb {
        kind: Kind,
        rt: u8,
        rn: u8,
        pre: bool,
        imm: i16,
    },
    StoreWb {
        kind: Kind,
        rt: u8,
        rn: u8,
        pre: bool,
        imm: i16,
    },
    /// A PC-relative load from flash, which never changes.
    LoadConst {
        rt: u8,
        value: u32,
    },
    LoadDual {
        rt: u8,
        rt2: u8,
        rn: u8,
        imm: i16,
        pre: bool,
        wback: bool,
    },
    StoreDual {
        rt: u8,
        rt2: u8,
        rn: u8,
        imm: i16,
        pre: bool,
        wback: bool,
    },
    LoadEx {
        kind: Kind,
        rt: u8,
        rn: u8,
        imm: u16,
    },
    StoreEx {
        kind: Kind,
        rd: u8,
        rt: u8,
        rn: u8,
        imm: u16,
    },
    ClearEx,
    LoadMulti {
        rn: u8,
        list: u16,
        wback: bool,
        before: bool,
    },
    StoreMulti {
        rn: u8,
        list: u16,
        wback: bool,
        before: bool,
    },
    Mul {
        rd: u8,
        rn: u8,
        rm: u8,
        s: bool,
    },
    MulAdd {
        rd: u8,
        rn: u8,
        rm: u8,
        ra: u8,
        sub: bool,
    },
    MulLong {
        signed: bool,
        accumulate: bool,
        rdlo: u8,
        rdhi: u8,
        rn: u8,
        rm: u8,
    },
    /// SMMUL (`ra` of 15), SMMLA, SMMLS: the upper word of a product of 64 bits.
    MulTop {
        rd: u8,
        rn: u8,
        rm: u8,
        ra: u8,
        sub: bool,
        round: bool,
    },
    Umaal {
        rdlo: u8,
        rdhi: u8,
        rn: u8,
        rm: u8,
    },
    Div {
        signed: bool,
        rd: u8,
        rn: u8,
        rm: u8,
    },
    /// `rn` of 15 means no accumulator.
    Extend {
        op: ExtendOp,
        rd: u8,
        rn: u8,
        rm: u8,
        rotate: u8,
    },
    Misc {
        op: MiscOp,
        rd: u8,
        rm: u8,
    },
    Bitfield {
        op: BitfieldOp,
        rd: u8,
        rn: u8,
        lsb: u8,
        width: u8,
    },
    /// `CPSIE i` / `CPSID i`.
    Cps {
        enable: bool,
    },
    MrsPrimask {
        rd: u8,
    },
    MrsBasepri {
        rd: u8,
    },
    MsrPrimask {
        rn: u8,
    },
    /// `MSR BASEPRI`, or `BASEPRI_MAX` if it only raises.
    MsrBasepri {
        rn: u8,
        raise_only: bool,
    },
}

const _: () = assert!(size_of::<Op>() == 8);

impl Op {
    /// True if what follows in memory may be no code.
    pub(super) const fn is_jump(self) -> bool {
        match self {
            Self::Slow
            | Self::Branch { .. }
            | Self::BranchLink { .. }
            | Self::Bx { .. }
            | Self::Blx { .. }
            | Self::Table { .. } => true,
            Self::LoadMulti { list, .. } => list & (1 << 15) != 0,
            _ => false,
        }
    }
}
