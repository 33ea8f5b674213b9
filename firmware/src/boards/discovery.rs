//! STM32F4DISCOVERY: STM32F407VG, crystal of 8 MHz.

use protocol::BoardModel;

use super::Board;

pub(super) const BOARD: Board = Board {
    model: BoardModel::Discovery,
    crystal_hz: 8_000_000,
    pll_divider: 4,
    pll_factor: 96,
    // RM0090 table 61.
    interrupts: 82,
    // RM0090 38.6.1; revision A gives the STM32F2's device ID (ES0182).
    cannot_prefetch: Some((0x413, 0x1000)),
    // RM0090 13.10.
    temperature_channel: 16,
    // Powered through its other connector (UM1472, 6.10).
    senses_vbus: true,
};
