//! Which signal is on which pin: the one table, for the board test and the book. Tests hold the
//! drawings and the simulated board's wires against it; the firmware, whose pins are types, runs
//! on that board.

/// The table of `pins.md`, a line a pin. A number of a header is a place on P1 or P2 of an STM32F4DISCOVERY
/// (UM1472, table of the extension connectors). VDD is the board's supply; what is pulled in the
/// chip takes no more than 0.3 V above it (DS8626 table 14, note 6).
pub const PINS: &str = include_str!("pins.md");

/// The pins, and for each its header and its signal.
pub fn pins() -> impl Iterator<Item = (&'static str, &'static str, &'static str)> {
    PINS.lines().skip(2).map(|line| {
        let mut cells = line.split('|').map(str::trim).skip(1);
        let mut next = || cells.next().unwrap_or_default();
        let (pin, header) = (next(), next());
        let _ = (next(), next());
        (pin, header, next())
    })
}

/// The pin of the signal that begins so.
#[must_use]
pub fn pin_of(signal: &str) -> &'static str {
    let found = pins().find(|(_, _, name)| name.starts_with(signal));
    found.map_or("?", |(pin, _, _)| pin)
}
