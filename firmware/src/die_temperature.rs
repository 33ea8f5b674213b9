//! The chip's temperature from its own sensor.
//!
//! The factory converted the sensor at 30 and at 110 °C and the internal reference, all at
//! 3.3 V, and wrote the codes into the chip (DS8626 tables 70 and 72). The sensor is
//! linear between (RM0090 13.10):
//!
//! ```text
//! celsius = 30 + 80 · (sensor − TS_CAL1) / (TS_CAL2 − TS_CAL1)
//! ```
//!
//! A code is relative to the supply, which is 2.9 V on this board and not 3.3 V: the
//! sensor's is first taken times VREFINT_CAL / reference.

/// Calibration values that the factory wrote.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Calibration {
    /// The reference, at 0x1FFF7A2A.
    pub reference: u16,
    /// The sensor at 30 °C, at 0x1FFF7A2C.
    pub at_30: u16,
    /// The sensor at 110 °C, at 0x1FFF7A2E.
    pub at_110: u16,
}

/// The chip's analog supply in mV from the code of the reference (RM0090 13.10, "reading the
/// internal reference"): the factory's was taken at 3.3 V. `None` if it is of no working chip.
#[must_use]
pub fn supply_mv(calibration: &Calibration, reference: u16) -> Option<u16> {
    let millivolts = (3_300 * u32::from(calibration.reference)).checked_div(reference.into())?;
    // What the chip is made for, and some (DS8626 table 14).
    (1_500..=4_000)
        .contains(&millivolts)
        .then_some(millivolts as u16)
}

/// Temperature in 0.1 °C from the codes of sensor and reference; `None` if they, or the
/// calibration, are of no working chip.
#[must_use]
pub fn decidegrees(calibration: &Calibration, sensor: u16, reference: u16) -> Option<i16> {
    let [at_30, at_110] = [calibration.at_30, calibration.at_110].map(i64::from);
    let reference = i64::from(reference);
    let sensor = i64::from(sensor) * i64::from(calibration.reference);
    let beyond = (sensor - at_30 * reference) * 800;
    let tenths = 300 + beyond.checked_div(reference * (at_110 - at_30))?;
    // What the chip is made for, and some (DS8626 table 14).
    (-500..=1_400).contains(&tenths).then_some(tenths as i16)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CHIP: Calibration = Calibration {
        reference: 1_500,
        at_30: 940,
        at_110: 1_200,
    };

    #[test]
    fn the_supply_cancels() {
        // Volts: the sensor at 30 °C, 110 °C and half way; the reference is 1.209 V.
        let code = |volts: f64, supply: f64| (volts / supply * 4_095.0).round() as u16;
        let volts = |code: u16| f64::from(code) / 4_095.0 * 3.3;
        for supply in [1.8, 2.4, 2.9, 3.3, 3.6] {
            for (sensor, expected) in [(940, 300), (1_200, 1_100), (1_070, 700)] {
                let sensor = code(volts(sensor), supply);
                let reference = code(volts(1_500), supply);
                let tenths = decidegrees(&CHIP, sensor, reference).unwrap();
                // Half a code of each of both is 0.2 °C at 3.3 V.
                assert!((tenths - expected).abs() <= 4, "{supply} V: {tenths}");
                // Half a code of the reference at 3.6 V is 1.3 mV, and so is the factory's.
                let millivolts = f64::from(supply_mv(&CHIP, reference).unwrap());
                assert!(
                    (millivolts - supply * 1e3).abs() < 4.0,
                    "{supply} V: {millivolts}"
                );
            }
        }
    }

    #[test]
    fn no_temperature_comes_of_a_chip_that_does_not_convert() {
        for (sensor, reference) in [(0, 0), (940, 0), (4_095, 4_095), (4_095, 1_500), (0, 1_500)] {
            assert_eq!(decidegrees(&CHIP, sensor, reference), None);
        }
        assert_eq!(supply_mv(&CHIP, 0), None);
        assert_eq!(supply_mv(&CHIP, 4_095), None);
        let blank = Calibration {
            reference: u16::MAX,
            at_30: u16::MAX,
            at_110: u16::MAX,
        };
        assert_eq!(decidegrees(&blank, 940, 1_500), None);
    }
}
