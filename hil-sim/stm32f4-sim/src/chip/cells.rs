//! Registers that are stored and not modelled: they read back what was written.
//!
//! A register belongs here if nothing that software or a pin can see on the chip
//! follows from it, or nothing that this simulator claims to show. What is neither
//! modelled nor listed ends the run when it is touched.

use std::collections::BTreeMap;

struct Cell {
    /// Address in the first block that has it.
    address: u32,
    /// In how many blocks, 0x400 apart.
    blocks: u32,
    name: &'static str,
    reset: u32,
    /// Bits that can be written.
    mask: u32,
    /// Why a cell suffices.
    why: &'static str,
}

const fn cell(address: u32, name: &'static str, reset: u32, why: &'static str) -> Cell {
    Cell {
        address,
        blocks: 1,
        name,
        reset,
        mask: u32::MAX,
        why,
    }
}

const SLEEP: &str = "the clocks of peripherals go on while the core sleeps, as after a reset";
const OSPEEDR: &str = "an edge of a pin takes no time";
const DEBUG: &str = "there is no debugger";

const CELLS: &[Cell] = &[
    cell(0x4000_5408, "I2C1_OAR1", 0, "there is no other controller"),
    cell(0x4000_540c, "I2C1_OAR2", 0, "there is no other controller"),
    cell(0x4000_5420, "I2C1_TRISE", 2, "an edge of SCL takes no time"),
    cell(0x4000_7000, "PWR_CR", 0x4000, "the supply limits no clock"),
    // Its one bit that matters: the regulator's scale is ready.
    Cell {
        mask: 0x0000_0310,
        ..cell(0x4000_7004, "PWR_CSR", 0x4000, "the supply is always there")
    },
    cell(0x4001_3800, "SYSCFG_MEMRMP", 0, "code runs from the flash"),
    cell(0x4001_3804, "SYSCFG_PMC", 0, "there is no Ethernet"),
    cell(
        0x4001_3820,
        "SYSCFG_CMPCR",
        0,
        "an edge of a pin takes no time",
    ),
    cell(0x4002_0008, "GPIOA_OSPEEDR", 0x0c00_0000, OSPEEDR),
    cell(0x4002_0408, "GPIOB_OSPEEDR", 0x0000_00c0, OSPEEDR),
    Cell {
        blocks: 7,
        ..cell(0x4002_0808, "GPIOx_OSPEEDR", 0, OSPEEDR)
    },
    // The bits that clear a flag read as zero.
    Cell {
        mask: 0x0000_7f00,
        ..cell(0x4002_380c, "RCC_CIR", 0, "software polls for oscillators")
    },
    cell(0x4002_3850, "RCC_AHB1LPENR", 0x7e67_91ff, SLEEP),
    cell(0x4002_3854, "RCC_AHB2LPENR", 0x0000_00f1, SLEEP),
    cell(0x4002_3858, "RCC_AHB3LPENR", 0x0000_0001, SLEEP),
    cell(0x4002_3860, "RCC_APB1LPENR", 0x36fe_c9ff, SLEEP),
    cell(0x4002_3864, "RCC_APB2LPENR", 0x0007_5f33, SLEEP),
    // LSERDY is never set.
    Cell {
        mask: 0x0001_8305,
        ..cell(0x4002_3870, "RCC_BDCR", 0, "there is no crystal of 32 kHz")
    },
    Cell {
        mask: 0,
        ..cell(0x4002_388c, "RCC_DCKCFGR", 0, "only larger chips have it")
    },
    cell(
        0x4002_3c00,
        "FLASH_ACR",
        0,
        "its wait states count, and the rules look at it; there is no cache",
    ),
    // The manual does not tell of it; drivers of this core look at its PHY's width.
    Cell {
        mask: 0,
        ..cell(
            0x5000_0050,
            "OTG_FS_GHWCFG4",
            0,
            "the full-speed PHY is narrow",
        )
    },
    cell(0xe004_2004, "DBGMCU_CR", 0, DEBUG),
    cell(0xe004_2008, "DBGMCU_APB1_FZ", 0, DEBUG),
    cell(0xe004_200c, "DBGMCU_APB2_FZ", 0, DEBUG),
];

/// The listed registers: name and why a cell suffices.
pub(crate) fn stored_registers() -> impl Iterator<Item = (&'static str, &'static str)> {
    CELLS.iter().map(|cell| (cell.name, cell.why))
}

/// The listed registers, as they were written.
#[derive(Debug, Default)]
pub(super) struct Cells(BTreeMap<u32, u32>);

impl Cells {
    fn find(address: u32) -> Option<&'static Cell> {
        CELLS.iter().find(|cell| {
            let offset = address.wrapping_sub(cell.address);
            offset % 0x400 == 0 && offset / 0x400 < cell.blocks
        })
    }

    pub(super) fn read(&self, address: u32) -> Option<u32> {
        let cell = Self::find(address)?;
        Some(self.0.get(&address).copied().unwrap_or(cell.reset))
    }

    /// True if there is such a register.
    pub(super) fn write(&mut self, address: u32, value: u32) -> bool {
        let Some(cell) = Self::find(address) else {
            return false;
        };
        let kept = (value & cell.mask) | (cell.reset & !cell.mask);
        self.0.insert(address, kept);
        true
    }

    /// Names of those that were written since their reset.
    pub(super) fn written(&self) -> impl Iterator<Item = &'static str> {
        let cells = self.0.keys().filter_map(|address| Self::find(*address));
        cells.map(|cell| cell.name)
    }

    /// All of them are reset.
    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    /// Those of the block at `base` are reset.
    pub(super) fn clear_block(&mut self, base: u32) {
        self.0.retain(|address, _| address & !0x3ff != base);
    }
}

#[cfg(test)]
mod tests {
    use super::super::names;
    use super::*;

    #[test]
    fn a_cell_keeps_what_can_be_written() {
        let mut cells = Cells::default();
        assert_eq!(cells.read(0x4002_1c08), Some(0), "GPIOH_OSPEEDR");
        assert!(cells.write(0x4002_1c08, 7));
        assert_eq!(cells.read(0x4002_1c08), Some(7));
        assert_eq!(cells.read(0x4002_1808), Some(0), "GPIOG_OSPEEDR");
        cells.clear_block(0x4002_1c00);
        assert_eq!(cells.read(0x4002_1c08), Some(0));
        assert!(cells.write(0x4002_388c, 7));
        assert_eq!(cells.read(0x4002_388c), Some(0), "RCC_DCKCFGR");
        assert_eq!(cells.read(0x4001_2000), None, "ADC1_SR");
    }

    #[test]
    fn the_list_is_complete() {
        for cell in CELLS {
            assert!(!cell.why.is_empty());
            if cell.blocks == 1 {
                assert_eq!(names::register(cell.address), cell.name);
            }
        }
    }
}
