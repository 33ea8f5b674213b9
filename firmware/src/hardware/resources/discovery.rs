//! Resources of the STM32F4DISCOVERY.

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
    random: Random { rng: RNG }
    outputs: Outputs { edges: TIM1, wakes: TIM5, pps: PE9, second: PE11, third: PE13, fourth: PE14 }
    sentences: Sentences { uart: UART5, pin: PC12, dma: DMA1_CH7 }
    leds: Leds { imu: PD12, pulse: PD13, fault: PD14, link: PD15 }
}

/// PD12 to PD15: green, orange, red, blue (UM1472, 6.3).
pub(crate) const LEDS: [LedPin; 4] = [
    (pac::GPIOD, 12, false),
    (pac::GPIOD, 13, false),
    (pac::GPIOD, 14, false),
    (pac::GPIOD, 15, false),
];

pub(crate) fn split(all: Peripherals) -> AssignedResources {
    split_resources!(all)
}
