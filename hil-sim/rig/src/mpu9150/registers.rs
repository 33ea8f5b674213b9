//! The part of the MPU-9150's register map that the model knows.
//!
//! Numbers such as "4.3" are sections, and "register 55" the registers in decimal, of "MPU-9150 Register Map and Descriptions",
//! RM-MPU-9150A-00, revision 4.2; electrical facts are from the "MPU-9150
//! Product Specification", PS-MPU-9150A-00, revision 4.3.

use crate::inertial_channel::LowPass;

/// Addresses of registers.
pub mod address {
    /// Sample rate divider (4.2).
    pub const SMPLRT_DIV: u8 = 0x19;
    /// DLPF_CFG and EXT_SYNC_SET (4.3).
    pub const CONFIG: u8 = 0x1a;
    /// Full scale and self-test of the gyroscope (4.4).
    pub const GYRO_CONFIG: u8 = 0x1b;
    /// Full scale and self-test of the accelerometer (4.5).
    pub const ACCEL_CONFIG: u8 = 0x1c;
    /// Level, drive, latch and clearing of the interrupt pin (register 55).
    pub(crate) const INT_PIN_CFG: u8 = 0x37;
    /// Interrupt sources that drive the pin (register 56).
    pub(crate) const INT_ENABLE: u8 = 0x38;
    /// Interrupts that came (register 58).
    pub(crate) const INT_STATUS: u8 = 0x3a;
    /// First of the 14 bytes of acceleration, temperature and angular rate (registers 59 to 72).
    pub const ACCEL_XOUT_H: u8 = 0x3b;
    /// Last of these bytes.
    pub(crate) const GYRO_ZOUT_L: u8 = 0x48;
    /// Resets of the analogue and digital signal paths (register 104).
    pub(crate) const SIGNAL_PATH_RESET: u8 = 0x68;
    /// FIFO, auxiliary bus, and their resets (register 106).
    pub(crate) const USER_CTRL: u8 = 0x6a;
    /// Reset, sleep, clock (register 107).
    pub const PWR_MGMT_1: u8 = 0x6b;
    /// Standby of single axes (register 108).
    pub(crate) const PWR_MGMT_2: u8 = 0x6c;
    /// FIFO data (register 116): the address does not move on.
    pub(crate) const FIFO_R_W: u8 = 0x74;
    /// Identity (register 117).
    pub(crate) const WHO_AM_I: u8 = 0x75;
}

/// Bits of INT_PIN_CFG (register 55).
pub(crate) mod int_pin {
    /// Active low.
    pub(crate) const INT_LEVEL: u8 = 0x80;
    /// Open drain.
    pub(crate) const INT_OPEN: u8 = 0x40;
    /// Held until cleared, instead of a pulse of 50 µs.
    pub(crate) const LATCH_INT_EN: u8 = 0x20;
    /// Any read clears, instead of a read of INT_STATUS only.
    pub(crate) const INT_RD_CLEAR: u8 = 0x10;
}

/// DATA_RDY_EN of INT_ENABLE and DATA_RDY_INT of INT_STATUS.
pub(crate) const DATA_RDY: u8 = 0x01;

/// Bits of PWR_MGMT_1 (register 107).
pub mod power {
    /// Resets all registers; clears itself.
    pub(crate) const DEVICE_RESET: u8 = 0x80;
    /// Low-power sleep.
    pub(crate) const SLEEP: u8 = 0x40;
    /// Wakes from time to time.
    pub(crate) const CYCLE: u8 = 0x20;
    /// Temperature sensor off.
    pub(crate) const TEMP_DIS: u8 = 0x08;
    /// Clock source.
    pub(crate) const CLKSEL: u8 = 0x07;
}

/// SIG_COND_RESET of USER_CTRL (register 106): resets signal paths and sensor registers.
pub(crate) const SIG_COND_RESET: u8 = 0x01;

/// Number of registers that have an address.
pub(crate) const REGISTERS: usize = 128;

/// What registers hold after power-on or DEVICE_RESET (section 3): zero, but
/// PWR_MGMT_1 asleep and the identity.
#[must_use]
pub(crate) fn reset_values() -> [u8; REGISTERS] {
    let mut registers = [0; REGISTERS];
    registers[address::PWR_MGMT_1 as usize] = power::SLEEP;
    registers[address::WHO_AM_I as usize] = 0x68;
    registers
}

/// Whether the controller can write the register (section 3, table of registers).
#[must_use]
pub(crate) fn writable(register: u8) -> bool {
    matches!(register,
        0x0d..=0x10 | 0x19..=0x1c | 0x1f..=0x22 | 0x23..=0x34 | 0x37 | 0x38
        | 0x63..=0x69 | 0x6a..=0x6c | 0x72..=0x74)
}

/// What the sensor's signal path does at a DLPF_CFG (4.3).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SignalPath {
    /// Low-pass of the gyroscope.
    pub gyro: LowPass,
    /// Low-pass of the accelerometer.
    pub accel: LowPass,
    /// Internal samples of the gyroscope a second, nominally; the sample rate
    /// divider divides these.
    pub gyro_hz: u64,
}

/// Internal samples of the accelerometer a second (4.2): always 1 kHz.
pub(crate) const ACCEL_HZ: u64 = 1000;

/// The table of section 4.3. Setting 7 is reserved; the model takes it as 0
/// (same internal rate).
#[must_use]
pub(crate) fn signal_path(config: u8) -> SignalPath {
    // Bandwidth in Hz and delay in µs of the gyroscope, then the accelerometer.
    let (gyro, accel, gyro_hz) = match config & 0x07 {
        1 => ((188.0, 1_900), (184.0, 2_000), 1000),
        2 => ((98.0, 2_800), (94.0, 3_000), 1000),
        3 => ((42.0, 4_800), (44.0, 4_900), 1000),
        4 => ((20.0, 8_300), (21.0, 8_500), 1000),
        5 => ((10.0, 13_400), (10.0, 13_800), 1000),
        6 => ((5.0, 18_600), (5.0, 19_000), 1000),
        _ => ((256.0, 980), (260.0, 0), 8000),
    };
    let pass = |(bandwidth_hz, delay_us): (f64, u32)| LowPass {
        bandwidth_hz,
        delay_s: f64::from(delay_us) * 1e-6,
    };
    SignalPath {
        gyro: pass(gyro),
        accel: pass(accel),
        gyro_hz,
    }
}

/// Counts per degree a second at a GYRO_CONFIG (4.4).
#[must_use]
pub(crate) fn gyro_counts_per_dps(gyro_config: u8) -> f64 {
    match gyro_config >> 3 & 3 {
        0 => 131.0,
        1 => 65.5,
        2 => 32.8,
        _ => 16.4,
    }
}

/// Counts per g at an ACCEL_CONFIG (4.5).
#[must_use]
pub(crate) fn accel_counts_per_g(accel_config: u8) -> f64 {
    match accel_config >> 3 & 3 {
        0 => 16_384.0,
        1 => 8_192.0,
        2 => 4_096.0,
        _ => 2_048.0,
    }
}

/// Counts at a die temperature in °C: `raw / 340 + 35` (registers 65 and 66).
#[must_use]
pub(crate) fn temperature_counts(celsius: f64) -> i16 {
    crate::inertial_channel::quantise(celsius - 35.0, 340.0)
}

/// What clocks the sensor, by CLKSEL (register 107).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClockSource {
    /// 0 and the reserved 6: internal 8 MHz oscillator.
    Internal,
    /// 1 to 3: PLL on a gyroscope.
    GyroPll,
    /// 4: PLL on an external 32.768 kHz.
    External32k,
    /// 5: PLL on an external 19.2 MHz.
    External19M2,
    /// 7: stopped.
    Stopped,
}

/// The source that PWR_MGMT_1 selects.
#[must_use]
pub(crate) fn clock_source(power_management: u8) -> ClockSource {
    match power_management & power::CLKSEL {
        1..=3 => ClockSource::GyroPll,
        4 => ClockSource::External32k,
        5 => ClockSource::External19M2,
        7 => ClockSource::Stopped,
        _ => ClockSource::Internal,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_protocol_and_the_sensor_agree_on_every_setting() {
        use protocol::{AccelRange, GyroRange, LowPass};
        for (setting, pass) in [
            (1, LowPass::Hz188),
            (2, LowPass::Hz98),
            (3, LowPass::Hz42),
            (4, LowPass::Hz20),
            (5, LowPass::Hz10),
            (6, LowPass::Hz5),
        ] {
            let path = signal_path(setting);
            assert_eq!(
                (path.gyro.delay_s * 1e6).round() as u32,
                pass.gyro_delay_us()
            );
            assert_eq!(
                (path.accel.delay_s * 1e6).round() as u32,
                pass.accel_delay_us()
            );
            assert_eq!(path.gyro_hz, 1000);
        }
        for (setting, range) in [
            (0x00, GyroRange::Dps250),
            (0x08, GyroRange::Dps500),
            (0x10, GyroRange::Dps1000),
            (0x18, GyroRange::Dps2000),
        ] {
            let tenths = f64::from(range.lsb_per_dps_times_10());
            assert!((gyro_counts_per_dps(setting) * 10.0 - tenths).abs() < 1e-9);
        }
        for (setting, range) in [
            (0x00, AccelRange::G2),
            (0x08, AccelRange::G4),
            (0x10, AccelRange::G8),
            (0x18, AccelRange::G16),
        ] {
            assert!((accel_counts_per_g(setting) - f64::from(range.lsb_per_g())).abs() < 1e-9);
        }
    }

    #[test]
    fn temperature_is_raw_over_340_plus_35() {
        assert_eq!(temperature_counts(35.0), 0);
        assert_eq!(temperature_counts(36.0), 340);
        assert_eq!(temperature_counts(25.0), -3400);
    }
}
