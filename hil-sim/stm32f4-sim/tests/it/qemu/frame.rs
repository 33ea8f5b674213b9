//! The frame of the program that both cores run, as machine code: no assembler is
//! needed to test.

/// Where the frame is loaded.
pub(crate) const AT: u32 = 0x0800_0100;
/// Entry of `reset`.
pub(crate) const RESET: u32 = AT;
/// Entry of `load`.
pub(crate) const LOAD: u32 = AT + 0xa4;
/// Entry of `dump`.
pub(crate) const DUMP: u32 = AT + 0xcc;
/// Entry of `handler`.
pub(crate) const HANDLER: u32 = AT + 0x110;
/// Entry of `fault`.
pub(crate) const FAULT: u32 = AT + 0x192;
/// Entry of `finish`.
pub(crate) const FINISH: u32 = AT + 0x1b6;

/// Enables the FPU (CPACR), fills the scratch memory, clears log, records and what is
/// above the stack, sets the
/// pointers up, takes the process stack if asked to, and jumps to the cases.
#[rustfmt::skip]
const RESET_CODE: &[u16] = &[
    0xf64e, 0x5088,  // movw r0, #0xed88
    0xf2ce, 0x0000,  // movt r0, #0xe000
    0x6801,          // ldr r1, [r0, #0]
    0xf441, 0x0170,  // orr r1, r1, #0xf00000
    0x6001,          // str r1, [r0, #0]
    0xf3bf, 0x8f4f,  // dsb sy
    0xf3bf, 0x8f6f,  // isb sy
    0xf240, 0x0c80,  // movw ip, #128
    0xf6c0, 0x0c00,  // movt ip, #0x800
    0xf8dc, 0x4000,  // ldr r4, [ip]
    0xf243, 0x0000,  // movw r0, #0x3000
    0xf2c2, 0x0000,  // movt r0, #0x2000
    0xf244, 0x0200,  // movw r2, #0x4000
    0xf854, 0x3b04,  // ldr r3, [r4], #4
    0xf840, 0x3b04,  // str r3, [r0], #4
    0x3a04,          // subs r2, #4
    0xd1f9,          // bne -10
    0xf249, 0x0200,  // movw r2, #0x9000
    0xf2c0, 0x0201,  // movt r2, #1
    0x2300,          // movs r3, #0
    0xf840, 0x3b04,  // str r3, [r0], #4
    0x3a04,          // subs r2, #4
    0xd1fb,          // bne -6
    0x4668,          // mov r0, sp
    0xf44f, 0x5280,  // mov r2, #0x1000
    0xf840, 0x3b04,  // str r3, [r0], #4
    0x3a04,          // subs r2, #4
    0xd1fb,          // bne -6
    0xf04f, 0x5000,  // mov r0, #0x20000000
    0xf8dc, 0x1004,  // ldr r1, [ip, #4]
    0x6041,          // str r1, [r0, #4]
    0xf249, 0x0100,  // movw r1, #0x9000
    0xf2c2, 0x0100,  // movt r1, #0x2000
    0x6001,          // str r1, [r0, #0]
    0xf247, 0x0100,  // movw r1, #0x7000
    0xf2c2, 0x0100,  // movt r1, #0x2000
    0x6081,          // str r1, [r0, #8]
    0x60c3,          // str r3, [r0, #12]
    0x6103,          // str r3, [r0, #16]
    0x6143,          // str r3, [r0, #20]
    0xf8dc, 0x1008,  // ldr r1, [ip, #8]
    0xb159,          // cbz r1, +26
    0x4669,          // mov r1, sp
    0xf381, 0x8809,  // msr PSP, r1
    0xf5a1, 0x5180,  // sub r1, r1, #0x1000
    0xf381, 0x8808,  // msr MSP, r1
    0x2102,          // movs r1, #2
    0xf381, 0x8814,  // msr CONTROL, r1
    0xf3bf, 0x8f6f,  // isb sy
    0xf8dc, 0x100c,  // ldr r1, [ip, #12]
    0x4708,          // bx r1
];

/// Loads the next state: S0 to S31, FPSCR, APSR, R0 to R12, LR.
#[rustfmt::skip]
const LOAD_CODE: &[u16] = &[
    0xf04f, 0x5000,  // mov r0, #0x20000000
    0x6841,          // ldr r1, [r0, #4]
    0xecb1, 0x0a20,  // vldmia r1!, {s0-s31}
    0xf851, 0x2b04,  // ldr r2, [r1], #4
    0xeee1, 0x2a10,  // vmsr fpscr, r2
    0xf101, 0x033c,  // add r3, r1, #60
    0x6043,          // str r3, [r0, #4]
    0xb500,          // push {lr}
    0xf851, 0x2b04,  // ldr r2, [r1], #4
    0xf382, 0x8c00,  // msr CPSR_fs, r2
    0xe891, 0x5fff,  // ldmia r1, {r0, r1, r2, r3, r4, r5, r6, r7, r8, r9, sl, fp, ip, lr}
    0xbd00,          // pop {pc}
];

/// Appends the state to the records; the caller has pushed its LR.
#[rustfmt::skip]
const DUMP_CODE: &[u16] = &[
    0xe92d, 0x5fff,  // stmdb sp!, {r0, r1, r2, r3, r4, r5, r6, r7, r8, r9, sl, fp, ip, lr}
    0xf04f, 0x5000,  // mov r0, #0x20000000
    0x6802,          // ldr r2, [r0, #0]
    0xf3ef, 0x8100,  // mrs r1, CPSR
    0xf842, 0x1b04,  // str r1, [r2], #4
    0xeef1, 0x1a10,  // vmrs r1, fpscr
    0xf842, 0x1b04,  // str r1, [r2], #4
    0xeca2, 0x0a20,  // vstmia r2!, {s0-s31}
    0x466b,          // mov r3, sp
    0x240d,          // movs r4, #13
    0xf853, 0x5b04,  // ldr r5, [r3], #4
    0xf842, 0x5b04,  // str r5, [r2], #4
    0x3c01,          // subs r4, #1
    0xd1f9,          // bne -10
    0x9d0e,          // ldr r5, [sp, #56]
    0xf842, 0x5b04,  // str r5, [r2], #4
    0xb00d,          // add sp, #52
    0xbc02,          // pop {r1}
    0xb001,          // add sp, #4
    0x466d,          // mov r5, sp
    0xf842, 0x5b04,  // str r5, [r2], #4
    0x6002,          // str r2, [r0, #0]
    0x4708,          // bx r1
];

/// SVCall and PendSV: logs IPSR, EXC_RETURN, the stacked xPSR (of PendSV, which may come
/// an instruction earlier or later, without ITSTATE) and the number of the SVC. Changes
/// the stacked R0 or R1; an odd SVC pends PendSV (tail-chaining), one with bit 1 uses the
/// FPU (lazy stacking).
#[rustfmt::skip]
const HANDLER_CODE: &[u16] = &[
    0xf01e, 0x0f04,  // tst lr, #4
    0xbf0c,          // ite eq
    0xf3ef, 0x8108,  // mrseq r1, MSP
    0xf3ef, 0x8109,  // mrsne r1, PSP
    0xf04f, 0x5200,  // mov r2, #0x20000000
    0xf8d2, 0xc008,  // ldr ip, [r2, #8]
    0xf3ef, 0x8005,  // mrs r0, IPSR
    0xf84c, 0x0b04,  // str r0, [ip], #4
    0xf84c, 0xeb04,  // str lr, [ip], #4
    0x69cb,          // ldr r3, [r1, #28]
    0x280b,          // cmp r0, #11
    0xd00e,          // beq +32
    0xf023, 0x63c0,  // bic r3, r3, #0x6000000
    0xf423, 0x437c,  // bic r3, r3, #0xfc00
    0xf84c, 0x3b04,  // str r3, [ip], #4
    0x2300,          // movs r3, #0
    0xf84c, 0x3b04,  // str r3, [ip], #4
    0xf8c2, 0xc008,  // str ip, [r2, #8]
    0x680a,          // ldr r2, [r1, #0]
    0x3201,          // adds r2, #1
    0x600a,          // str r2, [r1, #0]
    0x4770,          // bx lr
    0xf84c, 0x3b04,  // str r3, [ip], #4
    0x698b,          // ldr r3, [r1, #24]
    0xf813, 0x3c02,  // ldrb r3, [r3, #-2]
    0xf84c, 0x3b04,  // str r3, [ip], #4
    0xf8c2, 0xc008,  // str ip, [r2, #8]
    0x684a,          // ldr r2, [r1, #4]
    0xea82, 0x12c3,  // eor r2, r2, r3, lsl #7
    0x604a,          // str r2, [r1, #4]
    0x07da,          // lsls r2, r3, #31
    0xd006,          // beq +16
    0xf64e, 0x5004,  // movw r0, #0xed04
    0xf2ce, 0x0000,  // movt r0, #0xe000
    0xf04f, 0x5280,  // mov r2, #0x10000000
    0x6002,          // str r2, [r0, #0]
    0xf013, 0x0f02,  // tst r3, #2
    0xd003,          // beq +10
    0xee00, 0x1a10,  // vmov s0, r1
    0xeec0, 0x0a21,  // vdiv.f32 s1, s0, s3
    0x4770,          // bx lr
];

/// Any fault: notes CFSR and where.
#[rustfmt::skip]
const FAULT_CODE: &[u16] = &[
    0xf64e, 0x5028,  // movw r0, #0xed28
    0xf2ce, 0x0000,  // movt r0, #0xe000
    0x6802,          // ldr r2, [r0, #0]
    0xf04f, 0x5000,  // mov r0, #0x20000000
    0x6102,          // str r2, [r0, #16]
    0xf01e, 0x0f04,  // tst lr, #4
    0xbf0c,          // ite eq
    0xf3ef, 0x8108,  // mrseq r1, MSP
    0xf3ef, 0x8109,  // mrsne r1, PSP
    0x698a,          // ldr r2, [r1, #24]
    0x6142,          // str r2, [r0, #20]
    0xe7ff,          // b +2
];

/// Marks the end. With a semihosting host (QEMU): opens the file, writes the SRAM, exits.
#[rustfmt::skip]
const FINISH_CODE: &[u16] = &[
    0xf04f, 0x5000,  // mov r0, #0x20000000
    0x2101,          // movs r1, #1
    0x60c1,          // str r1, [r0, #12]
    0xf240, 0x0c80,  // movw ip, #128
    0xf6c0, 0x0c00,  // movt ip, #0x800
    0xf8dc, 0x1010,  // ldr r1, [ip, #16]
    0xb1a9,          // cbz r1, +46
    0xf10c, 0x0114,  // add r1, ip, #20
    0x2001,          // movs r0, #1
    0xbeab,          // bkpt 0x00ab
    0xf04f, 0x5300,  // mov r3, #0x20000000
    0xf240, 0x0400,  // movw r4, #0
    0xf2c0, 0x0402,  // movt r4, #2
    0xf503, 0x7180,  // add r1, r3, #256
    0xe881, 0x0019,  // stmia r1, {r0, r3, r4}
    0x2005,          // movs r0, #5
    0xbeab,          // bkpt 0x00ab
    0x2018,          // movs r0, #24
    0xf240, 0x0126,  // movw r1, #38
    0xf2c0, 0x0102,  // movt r1, #2
    0xbeab,          // bkpt 0x00ab
    0xe7fe,          // b +0
];

/// The whole frame.
pub(crate) fn code() -> Vec<u16> {
    [
        RESET_CODE,
        LOAD_CODE,
        DUMP_CODE,
        HANDLER_CODE,
        FAULT_CODE,
        FINISH_CODE,
    ]
    .concat()
}
