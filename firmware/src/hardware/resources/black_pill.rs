//! Resources of the Black Pill, which has no generator of random numbers, no UART5, and other
//! uses for TIM1's pins.

use assign_resources::assign_resources;
use embassy_stm32::{Peri, Peripherals, pac, peripherals};

use crate::hardware::leds::LedPin;

assign_resources! {
    trigger: Trigger {
        timer: TIM2, trigger: PA5, data_ready: PA1, strobe: PA2, readback: PA3,
        falling_edges: DMA1_CH5,
    }
    imu_bus: ImuBus { i2c: I2C1, scl: PB6, sda: PB7, tx: DMA1_CH6, rx: DMA1_CH0 }
    imu_clock: ImuClock { slow: TIM3, slow_pin: PB0, fast: MCO1, fast_pin: PA8 }
    usb: Usb { core: USB_OTG_FS, dp: PA12, dm: PA11, vbus: PA9 }
    chip: Chip { adc: ADC1, flash: FLASH, handover: SPI3 }
    random: Random {}
    outputs: Outputs { edges: TIM1, wakes: TIM5 }
    sentences: Sentences {}
    leds: Leds { imu: PB12, pulse: PB13, fault: PC13, link: PB15 }
}

/// To be wired, but for that on the board, from 3.3 V.
pub(crate) const LEDS: [LedPin; 4] = [
    (pac::GPIOB, 12, false),
    (pac::GPIOB, 13, false),
    (pac::GPIOC, 13, true),
    (pac::GPIOB, 15, false),
];

pub(crate) fn split(all: Peripherals) -> AssignedResources {
    split_resources!(all)
}
