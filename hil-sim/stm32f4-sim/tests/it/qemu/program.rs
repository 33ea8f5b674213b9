//! Random cases: a state, and instructions that run from it.

use stm32f4_sim::random::Random;

use super::encodings::{Encoding, FLOAT, INTEGER, OUTSIDE_IT};
use super::image::SCRATCH;

/// Words of a state: S0 to S31, FPSCR, APSR, R0 to R12, LR.
pub(crate) const STATE_WORDS: usize = 48;
/// Bits of FPSCR that are not reserved (A2.5.3), without AHP: the core does not know the
/// alternative half-precision format.
const FPSCR_BITS: u32 = 0xf3c0_009f;
/// N, Z, C, V, Q and GE (B1.4.2).
const APSR_BITS: u32 = 0xf80f_0000;
/// Instructions of a case, or a few more.
const LENGTH: usize = 10;

type Code = Vec<u16>;

/// An instruction, or several that need each other.
#[derive(Clone)]
pub(crate) struct Unit {
    /// Its name, or the section of DDI 0403E.
    pub(crate) what: &'static str,
    pub(crate) code: Code,
}

/// A state and what runs from it.
#[derive(Clone)]
pub(crate) struct Case {
    pub(crate) state: [u32; STATE_WORDS],
    pub(crate) units: Vec<Unit>,
    /// Instructions in the units.
    pub(crate) instructions: usize,
}

/// Makes the instructions of one case.
struct Maker<'a> {
    random: &'a mut Random,
    base: u16,
    index: u16,
    instructions: usize,
}

/// A case that nobody chose.
pub(crate) fn case(random: &mut Random) -> Case {
    // The handler changes R0 and R1.
    let base = 2 + below(random, 6) as u16;
    let index = 2 + (base - 1 + below(random, 5) as u16) % 6;
    let mut state = [0; STATE_WORDS];
    for word in &mut state[..32] {
        *word = float(random);
    }
    state[32] = random.bits() as u32 & FPSCR_BITS;
    state[33] = random.bits() as u32 & APSR_BITS;
    for word in &mut state[34..] {
        *word = integer(random);
    }
    state[34 + usize::from(base)] = SCRATCH.start + SCRATCH.len() as u32 / 2;
    state[34 + usize::from(index)] &= 0xff;
    let mut maker = Maker {
        random,
        base,
        index,
        instructions: 0,
    };
    let mut units = Vec::new();
    while maker.instructions < LENGTH {
        units.push(maker.unit());
    }
    Case {
        state,
        units,
        instructions: maker.instructions,
    }
}

fn below(random: &mut Random, end: u64) -> u64 {
    random.bits() % end
}

/// Small, near a limit of the sign, or anything.
fn integer(random: &mut Random) -> u32 {
    let bits = random.bits();
    let near = (bits >> 8) as u32 & 7;
    match bits & 7 {
        0 => near,
        1 => near.wrapping_neg(),
        2 => 0x8000_0000 ^ near,
        3 => 0x7fff_ffff ^ near,
        4 => 0x7fff_8000 ^ near,
        _ => (bits >> 32) as u32,
    }
}

/// Zero, infinity, NaN, subnormal, the limits of integers, near one, or anything.
fn float(random: &mut Random) -> u32 {
    let bits = random.bits();
    let sign = bits as u32 & 0x8000_0000;
    let fraction = (bits >> 32) as u32 & 0x007f_ffff;
    let exponent = |from: u64, count: u64| ((from + (bits >> 8) % count) as u32) << 23;
    sign | match bits & 15 {
        0 => 0,
        1 => 0x7f80_0000,
        2 => 0x7fc0_0000 | fraction,
        3 => 0x7f80_0001 | (fraction & 0x003f_ffff),
        4 => fraction,
        5 => fraction & 0xff,
        6 => exponent(1, 3) | fraction,
        7 => exponent(252, 3) | fraction,
        // Where 16 and 32 bits of an integer end, and half precision.
        8 => exponent(140, 5) | (fraction & 0x0070_0000),
        9 => exponent(156, 4) | fraction,
        10 => exponent(101, 15) | (fraction & 0x007f_f000),
        11..=13 => exponent(124, 8) | fraction,
        _ => (bits >> 33) as u32,
    }
}

impl Maker<'_> {
    fn unit(&mut self) -> Unit {
        let (what, code) = match below(self.random, 100) {
            0..=43 => return self.row(INTEGER),
            44..=69 => return self.row(FLOAT),
            70..=79 => ("IT block", self.it_block()),
            80..=86 => ("branch", self.branch()),
            87..=88 => ("table branch", self.table_branch()),
            89..=90 => ("exclusive access", self.exclusive()),
            91..=93 => ("stack", self.stack()),
            94..=96 => ("SVC", self.supervisor_call()),
            _ => ("PendSV", self.pend()),
        };
        Unit { what, code }
    }

    fn row(&mut self, table: &[Encoding]) -> Unit {
        let encoding = &table[below(self.random, table.len() as u64) as usize];
        self.instructions += 1;
        Unit {
            what: encoding.section,
            code: self.fill(encoding),
        }
    }

    /// An instruction that may stand in an IT block.
    fn conditional(&mut self) -> Code {
        if self.random.chance(0.3) {
            self.row(FLOAT).code
        } else {
            self.row(&INTEGER[OUTSIDE_IT..]).code
        }
    }

    /// Chooses the fields until the encoding is a defined one.
    fn fill(&mut self, encoding: &Encoding) -> Code {
        loop {
            let bits: Vec<char> = encoding.bits.chars().collect();
            let mut fields: Vec<(char, u32, u32)> = Vec::new();
            for letter in bits.iter().filter(|bit| bit.is_alphabetic()) {
                match fields.iter_mut().find(|field| field.0 == *letter) {
                    Some(field) => field.1 += 1,
                    None => fields.push((*letter, 1, 0)),
                }
            }
            let mut taken = None;
            for field in &mut fields {
                field.2 = self.value(field.0, field.1, &mut taken);
            }
            let of = |fields: &[(char, u32, u32)], letter| {
                fields.iter().find(|field| field.0 == letter).map(|f| f.2)
            };
            if let Some(register) = of(&fields, 'm') {
                for field in fields.iter_mut().filter(|field| field.0 == 'M') {
                    field.2 = register;
                }
            }
            let mut word = 0;
            for bit in &bits {
                word <<= 1;
                match fields.iter_mut().find(|field| field.0 == *bit) {
                    Some(field) => {
                        field.1 -= 1;
                        word |= (field.2 >> field.1) & 1;
                    }
                    None => word |= u32::from(*bit == '1'),
                }
            }
            if (encoding.defined)(word) {
                return if bits.len() == 32 {
                    vec![(word >> 16) as u16, word as u16]
                } else {
                    vec![word as u16]
                };
            }
        }
    }

    fn value(&mut self, letter: char, width: u32, taken: &mut Option<u16>) -> u32 {
        match letter {
            'd' | 'e' => {
                let register = self.register(width, *taken);
                *taken = Some(register);
                u32::from(register)
            }
            'n' | 'm' | 'a' => loop {
                let register = below(self.random, 1 << width) as u32;
                if register != 13 && register != 15 {
                    return register;
                }
            },
            'b' => u32::from(self.base),
            'x' => u32::from(self.index),
            'r' => loop {
                let keep = !(1 << self.base | 1 << self.index);
                let list = below(self.random, 1 << width) as u32 & keep;
                if list.count_ones() >= 2 {
                    return list;
                }
            },
            _ => below(self.random, 1 << width) as u32,
        }
    }

    /// A register that may be written.
    fn register(&mut self, width: u32, taken: Option<u16>) -> u16 {
        loop {
            let register = below(self.random, 1 << width) as u16;
            let free = ![self.base, self.index, 13, 15].contains(&register);
            if free && taken != Some(register) {
                return register;
            }
        }
    }

    /// IT (A7.7 IT: no condition 15, and "always" has no "else"; A7.3: the instructions
    /// of the block).
    fn it_block(&mut self) -> Code {
        let first = below(self.random, 15) as u16;
        let mask = loop {
            let mask = 1 + below(self.random, 15) as u16;
            if first != 14 || mask.count_ones() == 1 {
                break mask;
            }
        };
        self.instructions += 1;
        let mut unit = vec![0xbf00 | first << 4 | mask];
        for _ in mask.trailing_zeros()..4 {
            let next = match below(self.random, 16) {
                0 => self.supervisor_call(),
                _ => self.conditional(),
            };
            unit.extend(next);
        }
        unit
    }

    /// A branch forward over one to three others.
    fn branch(&mut self) -> Code {
        let mut body = Vec::new();
        for _ in 0..=below(self.random, 3) {
            body.extend(self.conditional());
        }
        let bytes = body.len() as u16 * 2;
        self.instructions += 1;
        let condition = below(self.random, 14) as u16;
        // Offsets count from the branch's address plus four.
        let (near, far) = ((bytes - 2) / 2, bytes / 2);
        let mut unit = match below(self.random, 6) {
            0 => vec![0xd000 | condition << 8 | near],
            1 => vec![0xe000 | near],
            2 => vec![0xf000 | condition << 6, 0x8000 | far],
            3 => vec![0xf000, 0xb800 | far],
            4 => vec![0xf000, 0xf800 | far],
            _ => {
                let compare = 0xb100 | (below(self.random, 2) as u16) << 11;
                vec![compare | near << 3 | below(self.random, 8) as u16]
            }
        };
        unit.extend(body);
        unit
    }

    /// TBB or TBH by a table of two entries after it.
    fn table_branch(&mut self) -> Code {
        let register = self.register(3, None);
        let choice = below(self.random, 2) as u16;
        let body = self.conditional();
        self.instructions += 2;
        let past = body.len() as u16;
        let mut unit = vec![0x2000 | register << 8 | choice, 0xe8df];
        // Offsets are in half-words from the table.
        if self.random.chance(0.5) {
            unit.extend([0xf000 | register, 1 | (1 + past) << 8]);
        } else {
            unit.extend([0xf010 | register, 2, 2 + past]);
        }
        unit.extend(body);
        unit
    }

    /// A load-exclusive and its store, with nothing, CLREX or an exception between
    /// (A3.4: anything else between is up to the implementation).
    fn exclusive(&mut self) -> Code {
        let load = self.register(4, None);
        let status = self.register(4, Some(load));
        let base = self.base;
        self.instructions += 2;
        let offset = below(self.random, 256) as u16;
        // Word, byte, half-word.
        let size = below(self.random, 3) as u16;
        let width = (3 + size) << 4;
        let mut unit = match size {
            0 => vec![0xe850 | base, load << 12 | 0x0f00 | offset],
            _ => vec![0xe8d0 | base, load << 12 | 0x0f0f | width],
        };
        match below(self.random, 3) {
            0 => {
                self.instructions += 1;
                unit.extend([0xf3bf, 0x8f2f]);
            }
            1 => unit.extend(self.supervisor_call()),
            _ => {}
        }
        unit.extend(match size {
            0 => vec![0xe840 | base, load << 12 | status << 8 | offset],
            _ => vec![0xe8c0 | base, load << 12 | 0x0f00 | width | status],
        });
        unit
    }

    /// PUSH and POP, VPUSH and VPOP, or SUB and ADD of SP around another.
    fn stack(&mut self) -> Code {
        self.instructions += 2;
        let count = 1 + below(self.random, 3) as u16;
        let mut body = self.conditional();
        let (before, after) = match below(self.random, 3) {
            0 => {
                let chosen = below(self.random, 256) | 1;
                let pushed: Vec<u16> = (0..8).filter(|r| chosen >> r & 1 != 0).take(6).collect();
                // As many registers come back, without base and index.
                let free = |r: &u16| *r != self.base && *r != self.index;
                let popped: Vec<u16> = (0..8).filter(free).take(pushed.len()).collect();
                let list = |registers: &[u16]| registers.iter().fold(0, |l, r| l | 1 << r);
                (vec![0xb400 | list(&pushed)], vec![0xbc00 | list(&popped)])
            }
            1 => {
                let first = below(self.random, 28) as u16;
                let list = (first & 1) << 6 | 0xd00;
                let hw2 = (first >> 1) << 12 | 0xa00 | count;
                (
                    vec![0xe02d | list, hw2],
                    vec![0xe0bd | list & 0x40 | 0xc00, hw2],
                )
            }
            // What lies below SP is an old exception frame: nothing to be read.
            _ => {
                body = self.row(FLOAT).code;
                (vec![0xb080 | count], vec![0xb000 | count])
            }
        };
        let mut unit = before;
        unit.extend(body);
        unit.extend(after);
        unit
    }

    fn supervisor_call(&mut self) -> Code {
        self.instructions += 1;
        vec![0xdf00 | below(self.random, 256) as u16]
    }

    /// Pends PendSV (ICSR) and waits for it (DSB, ISB; B2.2.5).
    fn pend(&mut self) -> Code {
        let address = self.register(3, None);
        let value = self.register(3, Some(address));
        self.instructions += 6;
        vec![
            0xf64e,
            0x5004 | address << 8, // movw address, #0xed04
            0xf2ce,
            address << 8, // movt address, #0xe000
            0xf04f,
            0x5080 | value << 8,           // mov value, #0x10000000
            0x6000 | address << 3 | value, // str value, [address]
            0xf3bf,
            0x8f4f, // dsb
            0xf3bf,
            0x8f6f, // isb
        ]
    }
}
