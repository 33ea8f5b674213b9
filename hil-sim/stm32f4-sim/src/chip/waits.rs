//! Waits of an access of the core beyond the one clock that every access takes:
//! always the longest that the sources allow, so that what the firmware does in time here
//! it does in time on the chip. No manual gives the core's waits for a peripheral: AN4031
//! (table 4) gives those of a DMA controller, which are taken for it.
//!
//! | access | waits, in clocks of the core | source |
//! |---|---|---|
//! | APB1, APB2 | 3 clocks of the bus: up to one for the bridge to meet an edge of the bus, with one clock of AHB to synchronise in it, two for the transfer | AN4031 table 4 |
//! | AHB | 2: one of arbitration in the matrix, one of the peripheral | AN4031 table 4 |
//! | a line of 16 bytes of the flash, for code or a constant | the wait states in FLASH_ACR | RM0090 table 10 |
//!
//! The flash is taken as its accelerator is when it is cold: no line is in its cache, and
//! none was prefetched. The chip has 64 lines of code and 8 of constants, and reads the
//! next line while one is executed. A buffered store costs the core less on the chip, too.

use super::Soc;
use super::rules::{ACR_LATENCY, FLASH_ACR};

/// Clocks of a bus that an access to its peripherals waits, at most.
const APB: u64 = 3;
const AHB: u64 = 2;

/// Waits in the present setting of the clocks, in clocks of the core.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Waits {
    apb1: u64,
    apb2: u64,
    /// For each line that is read.
    pub(super) flash: u64,
}

impl Waits {
    /// Returns the clocks of an access to the peripheral at an address.
    pub(super) fn at(&self, address: u32) -> u64 {
        match address >> 16 {
            0x4000 => self.apb1,
            0x4001 => self.apb2,
            _ => AHB,
        }
    }
}

impl Soc {
    /// Clocks or wait states changed.
    pub(super) fn update_waits(&mut self) {
        let ratio = |bus: u64| self.clocks.hclk.hz_rounded().div_ceil(bus.max(1));
        let acr = self.cells.read(FLASH_ACR).unwrap_or(0);
        self.waits = Waits {
            apb1: APB * ratio(self.clocks.pclk1.hz_rounded()),
            apb2: APB * ratio(self.clocks.pclk2.hz_rounded()),
            flash: u64::from(acr & ACR_LATENCY),
        };
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};

    use super::super::rules::tests::{chip, write};
    use super::*;
    use crate::cpu::{Cpu, Event};
    use crate::shared::lock;

    const RCC_CFGR: u32 = 0x4002_3808;
    const RCC_AHB1ENR: u32 = 0x4002_3830;
    const RCC_APB1ENR: u32 = 0x4002_3840;
    const RCC_APB2ENR: u32 = 0x4002_3844;
    /// Where the program lies: 0x200 into the flash, at the start of a line.
    const AT: u32 = 0x0800_0200;
    const NOP: u16 = 0xbf00;
    /// `ldr r2, [r0, r1]` and `str r2, [r0, r1]`.
    const LOAD: u16 = 0x5842;
    const STORE: u16 = 0x5042;

    /// Cycles from one half-word of a program to another, with APB1 at a quarter of the
    /// core's clock, APB2 at half of it, and a number of wait states.
    fn cycles(program: &[u16], from: u32, to: u32, states: u32) -> u64 {
        let mut soc = chip();
        let words = [0x2001_0000, AT | 1];
        let code = program.iter().flat_map(|half| half.to_le_bytes());
        let vectors = words.into_iter().flat_map(u32::to_le_bytes);
        soc.mem.flash.splice(..8, vectors);
        soc.mem.flash.splice(0x200..0x200 + 2 * program.len(), code);
        write(
            &mut soc,
            &[
                (FLASH_ACR, states),
                (RCC_CFGR, 5 << 10 | 4 << 13),
                (RCC_AHB1ENR, 1),
                (RCC_APB1ENR, 1),
                (RCC_APB2ENR, 1),
            ],
        );
        let soc = Arc::new(Mutex::new(soc));
        let mut cpu = Cpu::new(Arc::clone(&soc), 0x400).unwrap();
        cpu.cycles = lock(&soc).cycle;
        lock(&soc).set_slice_end(u64::MAX);
        let [from, to] = [from, to].map(|half| AT + 2 * half);
        cpu.add_breakpoint(from);
        cpu.add_breakpoint(to);
        let mut reached = |at| {
            while cpu.run() != Event::Breakpoint(at) {
                lock(&soc).at_cycle(cpu.cycles);
                assert!(cpu.cycles < 10_000, "{at:#x} is not reached");
            }
            cpu.cycles
        };
        let begun = reached(from);
        let cycles = reached(to) - begun;
        assert_eq!(lock(&soc).end, None);
        cycles
    }

    /// One access, at `base << shift` and `offset << 16` beyond.
    fn access(shift: u16, offset: u16, instruction: u16, states: u32) -> u64 {
        let program = [
            0x2001,          // movs r0, #1
            shift << 6,      // lsls r0, r0, #shift
            0x2100 | offset, // movs r1, #offset
            0x0409,          // lsls r1, r1, #16
            NOP,
            instruction,
            NOP,
        ];
        // Less the instruction before it, and itself.
        cycles(&program, 4, 6, states) - 1 - 2
    }

    #[test]
    fn an_access_waits_for_its_bus() {
        const PERIPHERALS: u16 = 30;
        for instruction in [LOAD, STORE] {
            assert_eq!(access(PERIPHERALS, 0, instruction, 0), 12, "TIM2 on APB1");
            assert_eq!(access(PERIPHERALS, 1, instruction, 0), 6, "TIM1 on APB2");
            assert_eq!(access(PERIPHERALS, 2, instruction, 0), 2, "GPIOA on AHB1");
            assert_eq!(access(29, 0, instruction, 3), 0, "SRAM");
        }
        assert_eq!(access(27, 0, LOAD, 3), 3, "a constant in the flash");
        assert_eq!(access(27, 0, LOAD, 0), 0);
    }

    /// 16 bytes are 8 of these instructions, each of one cycle.
    #[test]
    fn each_line_of_code_takes_the_wait_states() {
        for states in [0, 3, 5] {
            let within = cycles(&[NOP; 40], 8, 15, states);
            assert_eq!(within, 7, "it stops where the line has come");
            let three = cycles(&[NOP; 40], 9, 33, states);
            assert_eq!(three, 24 + 3 * u64::from(states));
        }
        // Back and forth between two lines: nothing stays in a cache.
        let mut program = [NOP; 40];
        program[9] = 0xe005; // b 16
        program[16] = 0xe7f8; // b 10
        assert_eq!(cycles(&program, 9, 10, 3), 3 + 3 + 3 + 3);
    }
}
