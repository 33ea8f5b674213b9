//! From instructions to compact operations, by rsemu's own decoder.

use rsemu::cpu::arm::v7m::isa::{
    BitfieldOp, DpOp, DualMulOp, ExtendOp, HintOp, Insn, MemOffset, Operand, ShiftType, Size,
    decode, is_32bit,
};

use super::op::{Kind, Op};

/// Decodes the instruction at `pc`. `half(addr)` and `word(addr)` read code
/// memory; `in_it` says whether the instruction stands in an IT block (where
/// 16-bit data processing leaves the flags alone, DDI 0403 A7.3.2).
pub(crate) fn decode_at(
    pc: u32,
    in_it: bool,
    half: impl Fn(u32) -> Option<u16>,
    word: impl Fn(u32, u32) -> Option<u32>,
) -> (Op, u8) {
    let Some(first) = half(pc) else {
        return (Op::Slow, 2);
    };
    let wide = is_32bit(first);
    let second = if wide {
        half(pc.wrapping_add(2))
    } else {
        Some(0)
    };
    let Some(second) = second else {
        return (Op::Slow, 4);
    };
    let insn = decode(first, second);
    let keep_flags = in_it && !wide;
    let len = if wide { 4 } else { 2 };
    (compact(insn, pc, keep_flags, word), len)
}

fn kind_of(size: Size, signed: bool) -> Kind {
    match (size, signed) {
        (Size::Word, _) => Kind::Word,
        (Size::Half, false) => Kind::Half,
        (Size::Half, true) => Kind::SignedHalf,
        (Size::Byte, false) => Kind::Byte,
        (Size::Byte, true) => Kind::SignedByte,
    }
}

fn signed_offset(imm: u32, add: bool) -> i32 {
    if add {
        imm as i32
    } else {
        (imm as i32).wrapping_neg()
    }
}

#[allow(clippy::too_many_lines)] // One arm per instruction shape.
fn compact(insn: Insn, pc: u32, keep_flags: bool, word: impl Fn(u32, u32) -> Option<u32>) -> Op {
    // The PC reads as the instruction's address plus four (DDI 0403 A5.1.2).
    let here = pc.wrapping_add(4);
    match insn {
        Insn::DataProc {
            op,
            s,
            rd,
            rn,
            operand,
        } => {
            let s = s && (!keep_flags || op.is_test());
            data_proc(op, s, rd, rn, operand)
        }
        Insn::ShiftReg { ty, s, rd, rn, rm } if rd != 15 && rn != 15 && rm != 15 => Op::ShiftReg {
            ty,
            s: s && !keep_flags,
            rd,
            rn,
            rm,
        },
        Insn::Adr { rd, imm, add } if rd != 15 => Op::MovImm {
            rd,
            imm: (here & !3).wrapping_add(signed_offset(imm, add) as u32),
        },
        Insn::MovImm16 {
            top: false,
            rd,
            imm,
        } if rd != 15 => Op::MovImm {
            rd,
            imm: u32::from(imm),
        },
        Insn::MovImm16 { top: true, rd, imm } if rd != 15 => Op::MovTop { rd, imm },
        Insn::Branch { cond, offset } => {
            let target = here.wrapping_add(offset as u32) & !1;
            match cond {
                None => Op::Branch { target },
                Some(c) => Op::BranchCond { cond: c.0, target },
            }
        }
        Insn::BranchLink { offset } => Op::BranchLink {
            target: here.wrapping_add(offset as u32) & !1,
        },
        Insn::Bx { rm } if rm != 15 => Op::Bx { rm },
        Insn::Blx { rm } if rm != 15 => Op::Blx { rm },
        Insn::Cbz {
            nonzero,
            rn,
            offset,
        } => Op::Cbz {
            nonzero,
            rn,
            target: here.wrapping_add(offset) & !1,
        },
        Insn::TableBranch { rn, rm, half } if rm != 15 => Op::Table {
            rn: rn & 15,
            rm,
            half,
            base: if rn == 15 { here } else { 0 },
        },
        Insn::It { cond, mask } => Op::It {
            state: (cond.0 << 4) | mask,
        },
        Insn::LoadStore {
            load,
            size,
            signed,
            rt,
            rn,
            offset,
            index,
            add,
            wback,
            unpriv: false,
        } => load_store(
            load,
            kind_of(size, signed),
            rt,
            rn,
            offset,
            index,
            add,
            wback,
        ),
        Insn::LoadLiteral {
            size,
            signed,
            rt,
            imm,
            add,
        } if rt != 15 => {
            let addr = (here & !3).wrapping_add(signed_offset(imm, add) as u32);
            let kind = kind_of(size, signed);
            match word(addr, size.bytes()) {
                Some(raw) => Op::LoadConst {
                    rt,
                    value: extend_load(kind, raw),
                },
                None => Op::Slow,
            }
        }
        Insn::LoadStoreDual {
            load,
            rt,
            rt2,
            rn,
            imm,
            index,
            add,
            wback,
        } if rn != 15 && rt != 15 && rt2 != 15 && (index || wback) => {
            let Ok(imm) = i16::try_from(signed_offset(imm, add)) else {
                return Op::Slow;
            };
            if load {
                Op::LoadDual {
                    rt,
                    rt2,
                    rn,
                    imm,
                    pre: index,
                    wback,
                }
            } else {
                Op::StoreDual {
                    rt,
                    rt2,
                    rn,
                    imm,
                    pre: index,
                    wback,
                }
            }
        }
        Insn::LoadStoreExclusive {
            load,
            size,
            rd,
            rt,
            rn,
            imm,
        } if rn != 15 && rt != 15 && imm < 0x1_0000 => {
            let kind = kind_of(size, false);
            let imm = imm as u16;
            if load {
                Op::LoadEx { kind, rt, rn, imm }
            } else if rd != 15 {
                Op::StoreEx {
                    kind,
                    rd,
                    rt,
                    rn,
                    imm,
                }
            } else {
                Op::Slow
            }
        }
        Insn::ClearExclusive => Op::ClearEx,
        Insn::LoadStoreMultiple {
            load,
            rn,
            list,
            wback,
            before,
        } if rn != 15 && list != 0 => {
            if load {
                Op::LoadMulti {
                    rn,
                    list,
                    wback,
                    before,
                }
            } else if list & (1 << 15) == 0 {
                Op::StoreMulti {
                    rn,
                    list,
                    wback,
                    before,
                }
            } else {
                Op::Slow
            }
        }
        Insn::Mul {
            rd,
            rn,
            rm,
            ra,
            sub,
            s,
        } if rd != 15 && rn != 15 && rm != 15 => match ra {
            None => Op::Mul {
                rd,
                rn,
                rm,
                s: s && !keep_flags,
            },
            Some(ra) if ra != 15 && !s => Op::MulAdd {
                rd,
                rn,
                rm,
                ra,
                sub,
            },
            Some(_) => Op::Slow,
        },
        Insn::MulLong {
            signed,
            accumulate,
            rdlo,
            rdhi,
            rn,
            rm,
            umaal,
        } if rdlo != 15 && rdhi != 15 && rn != 15 && rm != 15 => {
            if umaal {
                Op::Umaal { rdlo, rdhi, rn, rm }
            } else {
                Op::MulLong {
                    signed,
                    accumulate,
                    rdlo,
                    rdhi,
                    rn,
                    rm,
                }
            }
        }
        Insn::DualMul {
            op,
            rd,
            rn,
            rm,
            ra,
            x,
        } if op.bit_is_round() => Op::MulTop {
            rd,
            rn,
            rm,
            ra,
            sub: op == DualMulOp::Smmls,
            round: x,
        },
        Insn::Div { signed, rd, rn, rm } if rd != 15 && rn != 15 && rm != 15 => {
            Op::Div { signed, rd, rn, rm }
        }
        Insn::Extend {
            op,
            rd,
            rn,
            rm,
            rotate,
        } if rd != 15 && rm != 15 && !matches!(op, ExtendOp::Sxtb16 | ExtendOp::Uxtb16) => {
            Op::Extend {
                op,
                rd,
                rn,
                rm,
                rotate,
            }
        }
        Insn::Misc { op, rd, rm } if rd != 15 && rm != 15 => Op::Misc { op, rd, rm },
        Insn::Bitfield {
            op,
            rd,
            rn,
            lsb,
            width,
        } if rd != 15 && (rn != 15 || op == BitfieldOp::Bfc) => Op::Bitfield {
            op,
            rd,
            rn: rn & 15,
            lsb: lsb & 31,
            width: width.clamp(1, 32),
        },
        Insn::Cps {
            enable,
            i: true,
            f: false,
        } => Op::Cps { enable },
        Insn::Mrs { rd, sysm: 16 } if rd != 15 => Op::MrsPrimask { rd },
        Insn::Mrs { rd, sysm: 17 | 18 } if rd != 15 => Op::MrsBasepri { rd },
        Insn::Msr { rn, sysm: 16, .. } if rn != 15 => Op::MsrPrimask { rn },
        Insn::Msr {
            rn,
            sysm: sysm @ (17 | 18),
            ..
        } if rn != 15 => Op::MsrBasepri {
            rn,
            raise_only: sysm == 18,
        },
        Insn::Barrier { .. } => Op::Nop,
        Insn::Hint {
            op: HintOp::Nop | HintOp::Yield | HintOp::Preload | HintOp::Dbg(_),
        } => Op::Nop,
        _ => Op::Slow,
    }
}

fn data_proc(op: DpOp, s: bool, rd: u8, rn: u8, operand: Operand) -> Op {
    if (rd == 15 && !op.is_test()) || (rn == 15 && !op.is_unary()) {
        return Op::Slow;
    }
    let (rd, rn) = (rd & 15, rn & 15);
    match operand {
        Operand::Imm { value: imm, carry } => match (op, s, carry) {
            (DpOp::Mov, false, _) => Op::MovImm { rd, imm },
            (DpOp::Mvn, false, _) => Op::MovImm { rd, imm: !imm },
            (DpOp::Mov, true, None) => Op::MovsImm { rd, imm },
            (DpOp::Add, false, _) => Op::AddImm { rd, rn, imm },
            (DpOp::Sub, false, _) => Op::AddImm {
                rd,
                rn,
                imm: imm.wrapping_neg(),
            },
            (DpOp::Add, true, _) => Op::AddsImm { rd, rn, imm },
            (DpOp::Sub, true, _) => Op::SubsImm { rd, rn, imm },
            (DpOp::Cmp, _, _) => Op::CmpImm { rn, imm },
            _ => Op::DpImm {
                op,
                carry: if s { carry.map_or(2, u8::from) } else { 3 },
                rd_rn: rd | rn << 4,
                imm,
            },
        },
        Operand::Reg { rm: 15, .. } => Op::Slow,
        Operand::Reg { rm, shift } if shift.is_none() => match (op, s) {
            (DpOp::Mov, false) => Op::MovReg { rd, rm },
            (DpOp::Add, false) => Op::AddReg { rd, rn, rm },
            (DpOp::Add, true) => Op::AddsReg { rd, rn, rm },
            (DpOp::Sub, false) => Op::SubReg { rd, rn, rm },
            (DpOp::Sub, true) => Op::SubsReg { rd, rn, rm },
            (DpOp::Cmp, _) => Op::CmpReg { rn, rm },
            _ => Op::DpReg {
                op,
                s,
                rd,
                rn,
                rm,
                ty: ShiftType::Lsl,
                amount: 0,
            },
        },
        Operand::Reg { rm, shift } => Op::DpReg {
            op,
            s,
            rd,
            rn,
            rm,
            ty: shift.ty,
            amount: shift.amount,
        },
    }
}

#[allow(clippy::too_many_arguments, clippy::fn_params_excessive_bools)]
fn load_store(
    load: bool,
    kind: Kind,
    rt: u8,
    rn: u8,
    offset: MemOffset,
    index: bool,
    add: bool,
    wback: bool,
) -> Op {
    if rn == 15 || rt == 15 {
        return Op::Slow;
    }
    match offset {
        MemOffset::Imm(imm) => {
            let imm = signed_offset(imm, add);
            match (wback, index, load) {
                (false, true, true) => Op::LoadImm { kind, rt, rn, imm },
                (false, true, false) => Op::StoreImm { kind, rt, rn, imm },
                (true, pre, load) => match i16::try_from(imm) {
                    Ok(imm) if load => Op::LoadWb {
                        kind,
                        rt,
                        rn,
                        pre,
                        imm,
                    },
                    Ok(imm) => Op::StoreWb {
                        kind,
                        rt,
                        rn,
                        pre,
                        imm,
                    },
                    Err(_) => Op::Slow,
                },
                (false, false, _) => Op::Slow,
            }
        }
        MemOffset::Reg { rm, lsl } if !wback && index && add && rm != 15 => {
            if load {
                Op::LoadReg {
                    kind,
                    rt,
                    rn,
                    rm,
                    lsl,
                }
            } else {
                Op::StoreReg {
                    kind,
                    rt,
                    rn,
                    rm,
                    lsl,
                }
            }
        }
        MemOffset::Reg { .. } => Op::Slow,
    }
}

/// A value from memory as a load of this kind puts it into a register.
#[inline]
pub(crate) fn extend_load(kind: Kind, raw: u32) -> u32 {
    match kind {
        Kind::Word => raw,
        Kind::Half => raw & 0xffff,
        Kind::Byte => raw & 0xff,
        Kind::SignedHalf => i32::from(raw as u16 as i16) as u32,
        Kind::SignedByte => i32::from(raw as u8 as i8) as u32,
    }
}
