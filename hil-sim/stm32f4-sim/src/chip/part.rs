//! Which chip of the family it is: the STM32F407VG, which the rest of the model describes,
//! or one that differs from it.

use super::Revision;
use super::memory::Memory;
use super::names;

/// A chip.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Part {
    /// STM32F407VG (RM0090, DS8626).
    #[default]
    Stm32f407vg,
    /// STM32F411CE (RM0383, DS10314): 512 KiB of flash, no core-coupled memory, and fewer
    /// peripherals. That its 48 pins do not show most of ports C, D and E is not modelled.
    Stm32f411ce,
}

/// Peripherals of the STM32F407 that the STM32F411 lacks (RM0383 2.3).
const NOT_ON_F411: [&str; 25] = [
    "TIM6", "TIM7", "TIM8", "TIM12", "TIM13", "TIM14", "CAN1", "CAN2", "DAC", "USART3", "UART4",
    "UART5", "ADC2", "ADC3", "GPIOF", "GPIOG", "GPIOI", "BKPSRAM", "ETH", "OTG_HS", "DCMI", "CRYP",
    "HASH", "RNG", "FSMC",
];

impl Part {
    /// True if this chip has no peripheral at an address where the STM32F407 has one.
    pub(super) fn lacks(self, address: u32) -> bool {
        match self {
            Self::Stm32f407vg => false,
            Self::Stm32f411ce => {
                names::name(address).is_some_and(|name| NOT_ON_F411.contains(&name))
            }
        }
    }

    pub(super) fn memory(self) -> Memory {
        match self {
            Self::Stm32f407vg => Memory::new(),
            Self::Stm32f411ce => Memory::without_ccm(usize::from(self.flash_kib()) * 1024),
        }
    }

    /// Size of the flash, in KiB.
    pub(super) const fn flash_kib(self) -> u16 {
        match self {
            Self::Stm32f407vg => 1024,
            Self::Stm32f411ce => 512,
        }
    }

    /// DBGMCU_IDCODE (RM0090 38.6.1, RM0383 23.6.1).
    pub(super) fn id(self, revision: Revision) -> u32 {
        match self {
            Self::Stm32f407vg => revision.id(),
            Self::Stm32f411ce => 0x1000_6431,
        }
    }

    /// The ADC's channel of the temperature sensor (RM0090 13.10, RM0383 11.9).
    pub(super) const fn temperature_channel(self) -> u32 {
        match self {
            Self::Stm32f407vg => 16,
            Self::Stm32f411ce => 18,
        }
    }

    /// Highest HCLK, PCLK1 and PCLK2 in Hz (DS8626 and DS10314, table 14).
    pub(super) const fn fastest(self) -> [u64; 3] {
        match self {
            Self::Stm32f407vg => [168_000_000, 42_000_000, 84_000_000],
            Self::Stm32f411ce => [100_000_000, 50_000_000, 100_000_000],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_smaller_chip_lacks_what_its_manual_does_not_have() {
        let small = Part::Stm32f411ce;
        for present in [
            0x4000_0000,
            0x4001_0000,
            0x4001_3800,
            0x5000_0000,
            0x4002_1c00,
        ] {
            assert!(!small.lacks(present), "{present:#x}");
        }
        for absent in [
            0x5006_0800,
            0x4000_5000,
            0x5005_0000,
            0x4002_1400,
            0x4001_0400,
        ] {
            assert!(small.lacks(absent), "{absent:#x}");
            assert!(!Part::Stm32f407vg.lacks(absent));
        }
        assert!(NOT_ON_F411.iter().all(|name| names::is_name(name)));
    }
}
