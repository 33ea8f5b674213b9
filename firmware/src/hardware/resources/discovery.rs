//! Resources of the STM32F4DISCOVERY.

use embassy_stm32::{Peri, Peripherals, pac, peripherals};

use crate::hardware::leds::LedPin;

assign_with_common! {
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
