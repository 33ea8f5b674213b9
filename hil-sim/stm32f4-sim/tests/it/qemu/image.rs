//! The image that both cores run, and what they leave in the SRAM.

use std::ops::Range;

use super::frame;
use super::program::{Case, STATE_WORDS};

/// Where loads and stores go; full of noise at first.
pub(crate) const SCRATCH: Range<u32> = 0x2000_3000..0x2000_7000;
/// Set when the program has ended.
pub(crate) const DONE: u32 = SRAM.start + 12;
/// CFSR and program counter of a fault.
pub(crate) const FAULT: u32 = SRAM.start + 16;
/// Four words an exception: IPSR, EXC_RETURN, xPSR, number of the SVC.
pub(crate) const LOG: Range<u32> = 0x2000_7000..0x2000_9000;
/// The state after each case.
pub(crate) const RECORDS: Range<u32> = 0x2000_9000..SRAM.end;
pub(crate) const SRAM: Range<u32> = 0x2000_0000..0x2002_0000;
/// APSR, FPSCR, S0 to S31, R0 to R12, LR, SP.
pub(crate) const RECORD_WORDS: usize = 49;
/// As many cases as there is room for records.
pub(crate) const CASES: usize = (RECORDS.end - RECORDS.start) as usize / (RECORD_WORDS * 4);

const FLASH: u32 = 0x0800_0000;
const STACK: u32 = 0x2000_2000;
const PARAMETERS: u32 = FLASH + 0x80;
const FILE_NAME: u32 = FLASH + 0x700;
const NOISE: u32 = FLASH + 0x1000;
const CODE: u32 = FLASH + 0x8000;
const STATES: u32 = FLASH + 0x4_0000;

/// An ELF with the cases. `noise` fills the scratch memory; `process_stack` has the cases
/// run on PSP. With a file name the program hands the SRAM to a semihosting host there:
/// that and nothing else tells the two images apart.
pub(crate) fn elf(
    cases: &[Case],
    noise: &[u8],
    process_stack: bool,
    file: Option<&str>,
) -> Vec<u8> {
    let mut flash = vec![0; (STATES - FLASH) as usize + cases.len() * STATE_WORDS * 4];
    let mut put = |at: u32, bytes: &[u8]| {
        let at = (at - FLASH) as usize;
        flash[at..at + bytes.len()].copy_from_slice(bytes);
    };
    let words = |words: &[u32]| {
        words
            .iter()
            .flat_map(|w| w.to_le_bytes())
            .collect::<Vec<u8>>()
    };
    let halves = |halves: &[u16]| {
        halves
            .iter()
            .flat_map(|h| h.to_le_bytes())
            .collect::<Vec<u8>>()
    };

    let mut vectors = [frame::entry("fault") | 1; 16];
    vectors[..2].copy_from_slice(&[STACK, frame::entry("reset") | 1]);
    vectors[11] = frame::entry("handler") | 1;
    vectors[14] = frame::entry("handler") | 1;
    put(FLASH, &words(&vectors));
    let name = file.unwrap_or_default();
    // Mode 5 of SYS_OPEN is "wb".
    let open = [FILE_NAME, 5, name.len() as u32];
    let flags = [
        u32::from(process_stack),
        CODE | 1,
        u32::from(file.is_some()),
    ];
    put(
        PARAMETERS,
        &words(&[&[NOISE, STATES], &flags[..], &open].concat()),
    );
    put(FILE_NAME, name.as_bytes());
    put(frame::AT, &halves(&frame::code()));
    put(NOISE, noise);

    let mut code = Vec::new();
    let call = |code: &mut Vec<u16>, target: u32| {
        let offset = target.wrapping_sub(CODE + code.len() as u32 * 2 + 4);
        code.extend(branch_with_link(offset));
    };
    for case in cases {
        call(&mut code, frame::entry("load"));
        code.extend(case.units.iter().flat_map(|unit| &unit.code));
        code.extend([0xf84d, 0xed04]); // str lr, [sp, #-4]!
        call(&mut code, frame::entry("dump"));
    }
    call(&mut code, frame::entry("finish"));
    assert!(
        CODE + code.len() as u32 * 2 + 0x2000 < STATES,
        "too much code"
    );
    put(CODE, &halves(&code));
    for (n, case) in cases.iter().enumerate() {
        put(STATES + (n * STATE_WORDS * 4) as u32, &words(&case.state));
    }
    header(&flash)
}

/// BL (A7.7 BL, encoding T1).
fn branch_with_link(offset: u32) -> [u16; 2] {
    let bit = |n: u32| (offset >> n & 1) as u16;
    let sign = bit(24);
    let (j1, j2) = (1 ^ bit(23) ^ sign, 1 ^ bit(22) ^ sign);
    [
        0xf000 | sign << 10 | (offset >> 12 & 0x3ff) as u16,
        0xd000 | j1 << 13 | j2 << 11 | (offset >> 1 & 0x7ff) as u16,
    ]
}

/// An ELF for ARM with one segment at the start of the flash.
fn header(flash: &[u8]) -> Vec<u8> {
    const EHDR: u32 = 52;
    const PHDR: u32 = 32;
    let mut file = b"\x7fELF\x01\x01\x01".to_vec();
    file.resize(16, 0);
    for half in [2u16, 40] {
        file.extend(half.to_le_bytes()); // ET_EXEC, EM_ARM
    }
    for word in [1, frame::entry("reset") | 1, EHDR, 0, 0x0500_0000] {
        file.extend(word.to_le_bytes());
    }
    for half in [EHDR as u16, PHDR as u16, 1, 40, 0, 0] {
        file.extend(half.to_le_bytes());
    }
    let size = flash.len() as u32;
    for word in [1, EHDR + PHDR, FLASH, FLASH, size, size, 5, 1] {
        file.extend(word.to_le_bytes());
    }
    file.extend(flash);
    file
}
