//! WeAct Black Pill V2/V3: STM32F411CE in 48 pins, crystal of 25 MHz.
//!
//! Its one LED shows a fault; the other three are for the owner to wire, each with a resistor
//! to ground. TIM1's channel 1 is on PA8, where the IMU's clock is, and channel 4 on PA11, where
//! USB is; there is no UART5. So there are no auxiliary outputs and nothing for a lidar.

use protocol::BoardModel;

use super::Board;

pub(super) const BOARD: Board = Board {
    model: BoardModel::BlackPill,
    crystal_hz: 25_000_000,
    pll_divider: 25,
    pll_factor: 192,
    // RM0383 table 37.
    interrupts: 86,
    cannot_prefetch: None,
    // RM0383 11.9.
    temperature_channel: 18,
    // PA9 is on the header alone.
    senses_vbus: false,
};
