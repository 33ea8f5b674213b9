//! The boards that the firmware is built for: what differs between them, a file each.
//!
//! All have the same wiring: the trigger on PA5, data-ready on PA1, the strobe on PA2, the
//! read-back on PA3 (the channels of TIM2), the IMU's bus on PB6 and PB7 and its clocks on
//! PA8 and PB0, USB on PA11 and PA12. `CONTRIBUTING.md` says what another board needs.

mod black_pill;
mod discovery;

use protocol::BoardModel;

/// Properties in which boards differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Board {
    /// Which one it is; this says too whether it has the auxiliary outputs.
    pub model: BoardModel,
    /// Crystal, in Hz.
    pub crystal_hz: u32,
    /// The PLL's input is the crystal's frequency by this (PLLM), in 1 to 2 MHz.
    pub pll_divider: u8,
    /// The PLL's oscillator is its input times this (PLLN): 192 MHz.
    pub pll_factor: u16,
    /// Interrupts of the chip.
    pub interrupts: usize,
    /// Where the chip's first revision cannot prefetch from the flash: the device ID of all
    /// later ones, and that revision's ID (DBGMCU_IDCODE).
    pub cannot_prefetch: Option<(u16, u16)>,
    /// Channel of the ADC that has the temperature sensor.
    pub temperature_channel: u8,
    /// The computer's 5 V are at PA9. Without that wire a cable that is unplugged shows as a
    /// bus that is suspended.
    pub senses_vbus: bool,
}

/// The board of this build.
pub const BOARD: Board = if cfg!(feature = "black-pill") {
    black_pill::BOARD
} else {
    discovery::BOARD
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{SYSCLK_HZ, TIM2_HZ};

    #[test]
    fn clocks_follow_from_each_crystal() {
        for board in [discovery::BOARD, black_pill::BOARD] {
            let divider = u32::from(board.pll_divider);
            assert_eq!(board.crystal_hz % divider, 0);
            let input = board.crystal_hz / divider;
            // RM0090 7.3.2, RM0383 6.3.2.
            assert!((1_000_000..=2_000_000).contains(&input));
            let oscillator = input * u32::from(board.pll_factor);
            assert!((100_000_000..=432_000_000).contains(&oscillator));
            assert_eq!(oscillator / 2, SYSCLK_HZ);
            assert_eq!(oscillator / 4, 48_000_000, "USB");
            assert_eq!(SYSCLK_HZ / 4 * 2, TIM2_HZ);
            assert_eq!(SYSCLK_HZ / 5, 19_200_000, "the IMU's clock");
        }
    }
}
