//! The firmware's call stack, unwound with its `.debug_frame` section.
//!
//! Interrupted code is followed through exception frames. Where there is no
//! unwinding information the walk ends: no guesses.

use gimli::{
    BaseAddresses, CfaRule, DebugFrame, EndianSlice, LittleEndian, RegisterRule, UnwindContext,
    UnwindSection,
};
use object::{Object, ObjectSection};

use crate::firmware::Firmware;

/// Deepest stack that is shown.
const MAX_FRAMES: usize = 48;
/// Return "addresses" from here on are EXC_RETURN values (DDI 0403 B1.5.8).
const EXC_RETURN: u32 = 0xffff_ffe0;

/// Return addresses from the innermost function outwards, beginning with the
/// program counter in `regs`. `psp` is the process stack of interrupted tasks, `read` reads a
/// word of memory.
pub(crate) fn unwind(
    firmware: &Firmware,
    regs: [u32; 16],
    psp: u32,
    read: impl Fn(u32) -> Option<u32>,
) -> Vec<u32> {
    let mut out = vec![regs[15]];
    let Ok(file) = object::File::parse(firmware.bytes()) else {
        return out;
    };
    let Some(data) = file
        .section_by_name(".debug_frame")
        .and_then(|s| s.uncompressed_data().ok())
    else {
        return out;
    };
    let mut section = DebugFrame::from(EndianSlice::new(&data, LittleEndian));
    section.set_address_size(4);
    let bases = BaseAddresses::default();
    let mut context = UnwindContext::new();
    let mut regs = regs;
    while out.len() < MAX_FRAMES {
        // A return address lies after the call: look at the call itself.
        let at = if out.len() == 1 {
            regs[15]
        } else {
            regs[15].wrapping_sub(2)
        };
        let Ok(row) = section.unwind_info_for_address(
            &bases,
            &mut context,
            u64::from(at),
            DebugFrame::cie_from_offset,
        ) else {
            break;
        };
        let CfaRule::RegisterAndOffset { register, offset } = row.cfa() else {
            break;
        };
        let Some(base) = regs.get(usize::from(register.0)) else {
            break;
        };
        let cfa = base.wrapping_add(*offset as u32);
        let mut caller = regs;
        for n in 4..15u16 {
            if let RegisterRule::Offset(o) = row.register(gimli::Register(n)) {
                match read(cfa.wrapping_add(o as u32)) {
                    Some(v) => caller[usize::from(n)] = v,
                    None => return out,
                }
            }
        }
        caller[13] = cfa;
        let ret = caller[14];
        if ret >= EXC_RETURN {
            // The caller is the hardware: its frame has what was interrupted.
            let Some(interrupted) = exception_frame(caller, psp, &read) else {
                return out;
            };
            regs = interrupted;
            out.push(regs[15]);
            continue;
        }
        let pc = ret & !1;
        if pc == 0 || (pc == regs[15] && caller[13] == regs[13]) || ret == u32::MAX {
            break;
        }
        caller[15] = pc;
        regs = caller;
        out.push(pc);
    }
    out
}

/// Registers of the code that an exception interrupted. `regs` are those at
/// the handler's first instruction: LR is the EXC_RETURN value; SP is the frame, or `psp` if
/// that says so (DDI 0403 B1.5.8).
pub(crate) fn exception_frame(
    regs: [u32; 16],
    psp: u32,
    read: &impl Fn(u32) -> Option<u32>,
) -> Option<[u32; 16]> {
    let sp = match regs[14] & (1 << 2) {
        0 => regs[13],
        _ => psp,
    };
    let mut out = regs;
    for (n, slot) in [0usize, 1, 2, 3, 12, 14, 15].into_iter().enumerate() {
        out[slot] = read(sp.wrapping_add(n as u32 * 4))?;
    }
    let xpsr = read(sp.wrapping_add(28))?;
    let mut size = if regs[14] & (1 << 4) == 0 { 0x68 } else { 0x20 };
    if xpsr & (1 << 9) != 0 {
        size += 4;
    }
    out[13] = sp.wrapping_add(size);
    out[15] &= !1;
    Some(out)
}

/// The stack as lines for people.
pub(crate) fn describe(firmware: &Firmware, addresses: &[u32]) -> Vec<String> {
    let mut out = Vec::new();
    let lines = firmware.lines();
    for (n, address) in addresses.iter().enumerate() {
        // All but the innermost are return addresses.
        let at = if n == 0 {
            *address
        } else {
            address.wrapping_sub(2)
        };
        for (k, text) in firmware
            .describe(lines.as_ref(), at)
            .into_iter()
            .enumerate()
        {
            if k == 0 {
                out.push(format!("{n:3}: {address:#010x} {text}"));
            } else {
                out.push(format!("                {text}"));
            }
        }
    }
    out
}
