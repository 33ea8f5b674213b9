//! The random number generator (RM0090 24). Waits are bounded, as the HAL's are not.

use embassy_stm32::{pac, peripherals, rcc};

use crate::hardware::resources::Random;

/// Looks at the status until a number must be there: 40 periods of 48 MHz (24.3.1).
const LOOKS: u32 = 1_000;

/// A random number; none if the generator reports a fault or stays silent.
pub(crate) fn number(_: Random) -> Option<u32> {
    rcc::enable_and_reset::<peripherals::RNG>();
    pac::RNG.cr().write(|w| w.set_rngen(true));
    // The first is only there to be compared with (24.3.1).
    let pair = next().zip(next());
    pac::RNG.cr().write(|_| {});
    pair.and_then(|(first, second)| (first != second).then_some(second))
}

fn next() -> Option<u32> {
    for _ in 0..LOOKS {
        let status = pac::RNG.sr().read();
        if status.ceis() || status.seis() {
            return None;
        }
        if status.drdy() {
            return Some(pac::RNG.dr().read());
        }
    }
    None
}
