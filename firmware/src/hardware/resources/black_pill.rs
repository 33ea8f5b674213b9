//! Resources of the Black Pill, which has no generator of random numbers, no UART5, and other
//! uses for TIM1's pins.

use embassy_stm32::{Peri, Peripherals, pac, peripherals};

use crate::hardware::leds::LedPin;

assign_with_common! {
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
