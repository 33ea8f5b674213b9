//! What can be read off the edges of a pin.

use stm32f4_sim::pin::{Level, Pin};
use stm32f4_sim::time::{SimDuration, SimTime};

/// An edge as the simulation logs it.
pub(crate) type Edge = (Pin, Level, SimTime);

/// Times of the edges of one pin.
pub(crate) fn times(edges: &[Edge], pin: Pin) -> Vec<SimTime> {
    let of_pin = edges.iter().filter(|edge| edge.0 == pin);
    of_pin.map(|edge| edge.2).collect()
}

/// The bytes on an asynchronous line (8 bits, no parity) that idles high.
pub(crate) fn bytes(edges: &[Edge], pin: Pin, baud: u64) -> Vec<u8> {
    let bit = SimDuration::from_nanos(1_000_000_000 / baud);
    let edges: Vec<_> = edges.iter().filter(|edge| edge.0 == pin).collect();
    let level = |at: SimTime| {
        let before = edges.iter().take_while(|edge| edge.2 <= at).last();
        before.is_none_or(|edge| edge.1.is_high())
    };
    let mut bytes = Vec::new();
    let mut free = SimTime::ZERO;
    for (_, to, at) in &edges {
        if to.is_high() || *at < free {
            continue;
        }
        // The middles of the bits after the start bit.
        let middle = |n: u64| *at + SimDuration::from_units(bit.units() * (2 * n + 3) / 2);
        bytes.push((0..8).fold(0, |byte, n| byte | u8::from(level(middle(n))) << n));
        free = middle(8);
    }
    bytes
}
