//! Which signal is on which pin: the one table, for the board test and the book. Tests hold the
//! drawings and the simulated board's wires against it; the firmware, whose pins are types, runs
//! on that board.

/// The table, a line a pin. A number of a header is a place on P1 or P2 of an STM32F4DISCOVERY
/// (UM1472, table of the extension connectors).
pub const PINS: &str = "\
| pin | header | Black Pill | direction | signal | wired |
|---|---|---|---|---|---|
| PA5 | P1-15 | the same | out | trigger 1, of the depth camera | through a buffer; 10 kΩ to ground |
| PA3 | P1-13 | the same | in | read-back of the trigger | after the buffer; from 5 V through 10 kΩ and 20 kΩ |
| PA2 | P1-14 | the same | in | strobe: comparator of a photodiode, or any event | 3.3 V; from 5 V through 1.8 kΩ and 3.3 kΩ |
| PA1 | P1-11 | the same | in | data-ready of the IMU (INT, INT1) | direct |
| PB6 | P2-23 | the same | bus | SCL of the IMU | 2.2 to 10 kΩ to 3V |
| PB7 | P2-24 | the same | bus | SDA of the IMU | 2.2 to 10 kΩ to 3V |
| PB0 | P1-22 | the same | out | 32 kHz for CLKIN of an ICM-42688-P | direct |
| PA8 | P2-43 | the same | out | 19.2 MHz for CLKIN of an MPU-6050 or MPU-9150 | 33 Ω at the pin |
| PE11 | P1-29 | none | out | trigger 2 | as PA5 |
| PE13 | P1-31 | none | out | trigger 3 | as PA5 |
| PE14 | P1-32 | none | out | trigger 4 | as PA5 |
| PE9 | P1-27 | none | out | pulse per second for a lidar | as PA5 |
| PC12 | P2-35 | none | out | sentences for a lidar | inverting gate; 10 kΩ to 3V |
| PD12 | P1-44 | PB12, to be wired | LED, green | IMU samples come | on the board |
| PD13 | P1-45 | PB13, to be wired | LED, orange | toggles with each pulse | on the board |
| PD14 | P1-46 | PC13, on the board | LED, red | a fault, or a last run that failed | on the board |
| PD15 | P1-47 | PB15, to be wired | LED, blue | a host is linked | on the board |
";

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
