//! The instructions that are tested, as the encoding tables of the ARMv7-M Architecture
//! Reference Manual (DDI 0403E) have them. Only defined encodings are made: what a
//! page calls UNPREDICTABLE is left out by the field's letter or by the row's rule.
//!
//! | letter | field |
//! |---|---|
//! | `d`, `e` | a register that is written (or stored): two different ones, never SP, PC, the base or the index |
//! | `n`, `m`, `a` | a register that is read: never SP or PC |
//! | `M` | the same register as `m` |
//! | `b`, `x` | the case's base register (a word-aligned pointer into the scratch memory) and index register (below 256) |
//! | `r` | a list of at least two registers, without base and index |
//! | `i` | anything |
//!
//! Loads and stores that write the base back move it by whole words, for those that
//! must be aligned (A3.2.1).

/// A row of an encoding table.
pub(crate) struct Encoding {
    /// Section of DDI 0403E.
    pub(crate) section: &'static str,
    /// The bits, highest first.
    pub(crate) bits: &'static str,
    /// True if these bits are a defined instruction of this row.
    pub(crate) defined: fn(u32) -> bool,
}

const fn row(section: &'static str, bits: &'static str) -> Encoding {
    Encoding {
        section,
        bits,
        defined: |_| true,
    }
}

const fn only(section: &'static str, bits: &'static str, defined: fn(u32) -> bool) -> Encoding {
    Encoding {
        section,
        bits,
        defined,
    }
}

/// Bits `high` to `low`.
const fn field(word: u32, high: u32, low: u32) -> u32 {
    (word >> low) & ((1 << (high - low + 1)) - 1)
}

/// ThumbExpandImm (A5.3.2): a byte of zero in a pattern of several bytes is UNPREDICTABLE.
fn immediate(word: u32) -> bool {
    field(word, 26, 26) != 0
        || field(word, 14, 14) != 0
        || field(word, 13, 12) == 0
        || field(word, 7, 0) != 0
}

/// AND, BIC, ORR, ORN, EOR, ADD, ADC, SBC, SUB, RSB (A5.3.1, A5.3.11); the others of the
/// field are other instructions or undefined.
fn operation(word: u32) -> bool {
    matches!(field(word, 24, 21), 0..=4 | 8 | 10 | 11 | 13 | 14)
}

/// Lowest bit and width of SBFX and UBFX: the field ends within the register.
fn extracted(word: u32) -> bool {
    field(word, 14, 12) * 4 + field(word, 7, 6) + field(word, 4, 0) <= 31
}

/// BFI, BFC: UNPREDICTABLE if the highest bit is below the lowest.
fn inserted(word: u32) -> bool {
    field(word, 4, 0) >= field(word, 14, 12) * 4 + field(word, 7, 6)
}

/// SSAT, USAT: a right shift by zero is SSAT16, USAT16.
fn saturated(word: u32) -> bool {
    field(word, 21, 21) == 0 || field(word, 14, 12) != 0 || field(word, 7, 6) != 0
}

/// Sizes of bytes, half-words and words.
fn sized(word: u32) -> bool {
    field(word, 22, 21) != 3
}

/// S0 to S31 only, at least one (VLDM, VSTM).
fn singles(word: u32) -> bool {
    let first = field(word, 15, 12) * 2 + field(word, 22, 22);
    let count = field(word, 7, 0);
    count >= 1 && first + count <= 32
}

/// D0 to D15 only, at least one (VLDM, VSTM).
fn doubles(word: u32) -> bool {
    let count = field(word, 7, 1);
    count >= 1 && field(word, 15, 12) + count <= 16
}

/// VCVT with a fixed-point number: UNPREDICTABLE if it has fewer than no fraction bits.
fn fraction(word: u32) -> bool {
    field(word, 7, 7) != 0 || field(word, 3, 0) * 2 + field(word, 5, 5) <= 16
}

/// VMOV of two registers: UNPREDICTABLE from or to S31 and the one after it.
fn not_the_last(word: u32) -> bool {
    field(word, 3, 0) * 2 + field(word, 5, 5) != 31
}

/// Integer and DSP instructions without branches. All may stand in an IT block but the
/// first ([`OUTSIDE_IT`]).
pub(crate) const INTEGER: &[Encoding] = &[
    // MOV (register) T2 sets flags and is UNPREDICTABLE in an IT block.
    row("A5.2.1", "0000000000mmmddd"),
    only("A5.2.1", "000iiiiiiimmmddd", |w| {
        field(w, 12, 11) != 3 && field(w, 12, 6) != 0
    }),
    row("A5.2.1", "000110immmnnnddd"),
    row("A5.2.1", "000111iiiinnnddd"),
    row("A5.2.1", "00100dddiiiiiiii"),
    row("A5.2.1", "00101nnniiiiiiii"),
    row("A5.2.1", "0011idddiiiiiiii"),
    row("A5.2.2", "010000iiiimmmddd"),
    row("A5.2.3", "01000100dmmmmddd"),
    // CMP T2 with two low registers is UNPREDICTABLE.
    only("A5.2.3", "01000101nmmmmnnn", |w| {
        field(w, 7, 7) != 0 || field(w, 6, 6) != 0
    }),
    row("A5.2.3", "01000110dmmmmddd"),
    row("A7.7 LDR (literal)", "01001dddiiiiiiii"),
    row("A5.2.4", "0101iiixxxbbbddd"),
    row("A5.2.4", "011iiiiiiibbbddd"),
    row("A5.2.4", "1000iiiiiibbbddd"),
    row("A5.2.4", "1001idddiiiiiiii"),
    row("A7.7 ADR", "10100dddiiiiiiii"),
    row("A7.7 ADD (SP plus immediate)", "10101dddiiiiiiii"),
    row("A5.2.5", "10110010iimmmddd"),
    only("A5.2.5", "10111010iimmmddd", |w| field(w, 7, 6) != 2),
    row("A7.7 LDM, STM", "1100ibbbrrrrrrrr"),
    only("A5.3.1", "11110i0iiiiinnnn0iiiddddiiiiiiii", |w| {
        operation(w) && immediate(w)
    }),
    only("A5.3.1", "11110i00010i11110iiiddddiiiiiiii", immediate),
    only("A5.3.1", "11110i00011i11110iiiddddiiiiiiii", immediate),
    only("A5.3.1", "11110i00i001nnnn0iii1111iiiiiiii", immediate),
    only("A5.3.1", "11110i010001nnnn0iii1111iiiiiiii", immediate),
    only("A5.3.1", "11110i011011nnnn0iii1111iiiiiiii", immediate),
    row("A5.3.3", "11110i100000nnnn0iiiddddiiiiiiii"),
    row("A5.3.3", "11110i101010nnnn0iiiddddiiiiiiii"),
    row("A5.3.3", "11110i10i100iiii0iiiddddiiiiiiii"),
    row("A7.7 ADR", "11110i10000011110iiiddddiiiiiiii"),
    row("A7.7 ADR", "11110i10101011110iiiddddiiiiiiii"),
    only("A5.3.3", "1111001100i0nnnn0iiiddddii0iiiii", saturated),
    only("A5.3.3", "1111001110i0nnnn0iiiddddii0iiiii", saturated),
    row("A5.3.3", "111100111010nnnn0000dddd0000iiii"),
    row("A5.3.3", "111100110010nnnn0000dddd0000iiii"),
    only("A5.3.3", "111100110100nnnn0iiiddddii0iiiii", extracted),
    only("A5.3.3", "111100111100nnnn0iiiddddii0iiiii", extracted),
    only("A5.3.3", "111100110110nnnn0iiiddddii0iiiii", inserted),
    only("A5.3.3", "11110011011011110iiiddddii0iiiii", inserted),
    only("A5.3.11", "1110101iiiiinnnn0iiiddddiiiimmmm", operation),
    row("A5.3.11", "11101010010i11110iiiddddiiiimmmm"),
    row("A5.3.11", "11101010011i11110iiiddddiiiimmmm"),
    row("A5.3.11", "111010101100nnnn0iiiddddiii0mmmm"),
    row("A5.3.11", "111010100001nnnn0iii1111iiiimmmm"),
    row("A5.3.11", "111010101001nnnn0iii1111iiiimmmm"),
    row("A5.3.11", "111010110001nnnn0iii1111iiiimmmm"),
    row("A5.3.11", "111010111011nnnn0iii1111iiiimmmm"),
    row("A5.3.12", "111110100iiinnnn1111dddd0000mmmm"),
    only("A5.3.12", "111110100iiinnnn1111dddd10iimmmm", |w| {
        field(w, 22, 20) < 6
    }),
    only("A5.3.12", "111110100iii11111111dddd10iimmmm", |w| {
        field(w, 22, 20) < 6
    }),
    // Parallel addition and subtraction; these codes alone are defined.
    only(
        "A5.3.13, A5.3.14",
        "111110101iiinnnn1111dddd0iiimmmm",
        |w| !matches!(field(w, 22, 20), 3 | 7) && field(w, 5, 4) != 3,
    ),
    row("A5.3.15", "111110101000nnnn1111dddd10iimmmm"),
    row("A5.3.15", "111110101001MMMM1111dddd10iimmmm"),
    row("A5.3.15", "111110101010nnnn1111dddd1000mmmm"),
    row("A5.3.15", "111110101011MMMM1111dddd1000mmmm"),
    row("A5.3.16", "111110110000nnnnaaaadddd000immmm"),
    row("A5.3.16", "111110110000nnnn1111dddd0000mmmm"),
    row("A5.3.16", "111110110001nnnnaaaadddd00iimmmm"),
    row("A5.3.16", "111110110001nnnn1111dddd00iimmmm"),
    row("A5.3.16", "111110110010nnnnaaaadddd000immmm"),
    row("A5.3.16", "111110110010nnnn1111dddd000immmm"),
    row("A5.3.16", "111110110011nnnnaaaadddd000immmm"),
    row("A5.3.16", "111110110011nnnn1111dddd000immmm"),
    row("A5.3.16", "111110110100nnnnaaaadddd000immmm"),
    row("A5.3.16", "111110110100nnnn1111dddd000immmm"),
    row("A5.3.16", "111110110101nnnnaaaadddd000immmm"),
    row("A5.3.16", "111110110101nnnn1111dddd000immmm"),
    row("A5.3.16", "111110110110nnnnaaaadddd000immmm"),
    row("A5.3.16", "111110110111nnnnaaaadddd0000mmmm"),
    row("A5.3.16", "111110110111nnnn1111dddd0000mmmm"),
    row("A5.3.17", "1111101110i0nnnnddddeeee0000mmmm"),
    row("A5.3.17", "1111101111i0nnnnddddeeee0000mmmm"),
    row("A5.3.17", "1111101110i1nnnn1111dddd1111mmmm"),
    row("A5.3.17", "111110111100nnnnddddeeee10iimmmm"),
    row("A5.3.17", "11111011110innnnddddeeee110immmm"),
    row("A5.3.17", "111110111110nnnnddddeeee0110mmmm"),
    only("A5.3.7 to 10", "111110001iiibbbbddddiiiiiiiiiiii", sized),
    row("A5.3.8, A5.3.9", "1111100110i1bbbbddddiiiiiiiiiiii"),
    only("A5.3.7 to 10", "111110000iiibbbbdddd1100iiiiiiii", sized),
    only("A5.3.7 to 10", "111110000iiibbbbdddd1110iiiiiiii", sized),
    only("A5.3.7 to 10", "111110000iiibbbbdddd11i1iiiiii00", sized),
    only("A5.3.7 to 10", "111110000iiibbbbdddd10i1iiiiii00", sized),
    row("A5.3.8, A5.3.9", "1111100100i1bbbbdddd1100iiiiiiii"),
    row("A5.3.8, A5.3.9", "1111100100i1bbbbdddd11i1iiiiii00"),
    row("A5.3.8, A5.3.9", "1111100100i1bbbbdddd10i1iiiiii00"),
    only("A5.3.7 to 10", "111110000iiibbbbdddd000000iixxxx", sized),
    row("A5.3.8, A5.3.9", "1111100100i1bbbbdddd000000iixxxx"),
    only("A5.3.7 to 9", "11111000iii11111ddddiiiiiiiiiiii", sized),
    row("A5.3.8, A5.3.9", "11111001i0i11111ddddiiiiiiiiiiii"),
    row("A5.3.6", "11101001i10ibbbbddddeeeeiiiiiiii"),
    row("A5.3.6", "11101001i11ibbbbddddeeee00iiiiii"),
    row("A5.3.6", "11101000i11ibbbbddddeeee00iiiiii"),
    row("A5.3.5", "1110100010iibbbb000rrrrrrrrrrrrr"),
    row("A5.3.5", "1110100100iibbbb000rrrrrrrrrrrrr"),
    row("A5.3.4 MRS APSR", "11110011111011111000dddd00000000"),
    row("A5.3.4 MRS XPSR", "11110011111011111000dddd00000011"),
    row("A5.3.4 MRS CONTROL", "11110011111011111000dddd00010100"),
    row("A5.3.4 MSR APSR", "111100111000nnnn10001i0000000000"),
    row("A5.3.4 MSR APSR", "111100111000nnnn1000010000000000"),
    only(
        "A5.3.4 DSB, DMB, ISB",
        "11110011101111111000111101ii1111",
        |w| field(w, 5, 4) != 3,
    ),
    row("A5.2.5 NOP", "1011111100000000"),
    row("A5.3.4 NOP", "11110011101011111000000000000000"),
];

/// Rows at the start of [`INTEGER`] that may not stand in an IT block.
pub(crate) const OUTSIDE_IT: usize = 1;

/// Floating point. Every S register is defined; of the D registers the first sixteen.
pub(crate) const FLOAT: &[Encoding] = &[
    row("A6.4 VMLA, VMLS", "111011100i00iiiiiiii1010iii0iiii"),
    row("A6.4 VNMLA, VNMLS", "111011100i01iiiiiiii1010iii0iiii"),
    row("A6.4 VMUL, VNMUL", "111011100i10iiiiiiii1010iii0iiii"),
    row("A6.4 VADD, VSUB", "111011100i11iiiiiiii1010iii0iiii"),
    row("A6.4 VDIV", "111011101i00iiiiiiii1010i0i0iiii"),
    row("A6.4 VFNMA, VFNMS", "111011101i01iiiiiiii1010iii0iiii"),
    row("A6.4 VFMA, VFMS", "111011101i10iiiiiiii1010iii0iiii"),
    row("A6.4 VMOV (immediate)", "111011101i11iiiiiiii10100000iiii"),
    row("A6.4 VMOV, VABS", "111011101i110000iiii1010i1i0iiii"),
    row("A6.4 VNEG, VSQRT", "111011101i110001iiii1010i1i0iiii"),
    row("A6.4 VCVTB, VCVTT", "111011101i11001iiiii1010i1i0iiii"),
    row("A6.4 VCMP", "111011101i110100iiii1010i1i0iiii"),
    row("A6.4 VCMP with zero", "111011101i110101iiii1010i1000000"),
    row("A6.4 VCVT from integer", "111011101i111000iiii1010i1i0iiii"),
    row("A6.4 VCVT to integer", "111011101i11110iiiii1010i1i0iiii"),
    only(
        "A6.4 VCVT fixed",
        "111011101i111i1iiiii1010i1i0iiii",
        fraction,
    ),
    row("A6.6 VMRS APSR", "11101110111100011111101000010000"),
    row("A6.6 VMRS", "1110111011110001dddd101000010000"),
    row("A6.6 VMOV", "11101110000iiiiidddd1010i0010000"),
    row("A6.6 VMOV scalar", "1110111000iiiiiidddd101100010000"),
    only(
        "A6.7 VMOV",
        "11101100010ieeeedddd101000i1iiii",
        not_the_last,
    ),
    row("A6.7 VMOV", "11101100010ieeeedddd10110001iiii"),
    row("A6.5 VLDR, VSTR", "11101101ii0ibbbbiiii1010iiiiiiii"),
    row("A6.5 VLDR, VSTR", "11101101i00ibbbbiiii1011iiiiiiii"),
    row("A6.5 VLDR literal", "11101101ii011111iiii1010iiiiiiii"),
    row("A6.5 VLDR literal", "11101101i0011111iiii1011iiiiiiii"),
    only(
        "A6.5 VLDM, VSTM",
        "111011001iiibbbbiiii1010000iiiii",
        singles,
    ),
    only(
        "A6.5 VLDM, VSTM",
        "111011010i1ibbbbiiii1010000iiiii",
        singles,
    ),
    only(
        "A6.5 VLDM, VSTM",
        "1110110010iibbbbiiii1011000iiii0",
        doubles,
    ),
    only(
        "A6.5 VLDM, VSTM",
        "11101101001ibbbbiiii1011000iiii0",
        doubles,
    ),
];
