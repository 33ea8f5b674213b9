//! The random number generator (RM0090 24).

use embassy_stm32::{Peri, pac, peripherals};

/// Looks at the status until a number must be there: 40 periods of 48 MHz (24.3.1).
const LOOKS: u32 = 1_000;

/// A random number; none if the generator reports a fault or stays silent. Its clock is
/// on ([`super::clocks::enable_peripherals`]).
pub(crate) fn number(_: Peri<'static, peripherals::RNG>) -> Option<u32> {
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
