//! The ICM-42688-P (data sheet DS-000347, revision 1.8, whose sections are meant by bare
//! numbers).
//!
//! Its clock input takes 31 to 50 kHz; at 32 kHz its rates are those that it is set to
//! (12.5), so the board gives it that. Registers other than those of rates, ranges and modes
//! are only changed while both sensors are off (12.9).
//!
//! The low-pass is the second-order UI filter (5.5), whose documented delay is that of the
//! sample. Notch and anti-alias filter are bypassed: the data sheet does not give
//! their delay.

use embedded_hal_async::delay::DelayNs;
use embedded_hal_async::i2c::I2c;
use protocol::icm42688p::{
    ACCEL_CONFIG0, ACCEL_CONFIG1, BANK1_GYRO_CONFIG_STATIC2, BANK1_INTF_CONFIG5,
    BANK1_INTF_CONFIG6, BANK2_ACCEL_CONFIG_STATIC2, DEVICE_CONFIG, DRIVE_CONFIG,
    GYRO_ACCEL_CONFIG0, GYRO_CONFIG0, GYRO_CONFIG1, INT_CONFIG, INT_CONFIG1, INT_SOURCE0,
    INTF_CONFIG0, INTF_CONFIG1, PWR_MGMT0, REG_BANK_SEL, TEMP_DATA1,
};
use protocol::{AccelRange, GyroRange, ImuConfig, ImuFault, ImuModel, ImuSensor, LowPass};

use super::{Description, RawSample, Registers};

/// WHO_AM_I (14.58).
pub(super) const IDENTITY: u8 = 0x47;

/// DEVICE_CONFIG: reset all registers; the bit clears itself (14.1).
const SOFT_RESET: u8 = 0x01;

/// From reset to the next access, in ms: 1 (14.1), and one more.
const RESET_MS: u32 = 2;

/// PWR_MGMT0: gyroscope and accelerometer in low-noise mode (14.36).
const BOTH_ON: u8 = 0x0F;

/// Time after [`BOTH_ON`] in which no register may be written, in µs (14.36).
const QUIET_US: u32 = 200;

/// The sensor's filters of the second order at one rate, by GYRO_UI_FILT_BW and ACCEL_UI_FILT_BW
/// (5.5).
struct Rate {
    /// Divider in [`ImuConfig`].
    divider: u8,
    /// GYRO_ODR and ACCEL_ODR (14.37, 14.38).
    code: u8,
    /// Frequencies of the 3 dB point, in 0.1 Hz.
    bandwidths: [u16; 8],
    /// In 0.1 ms.
    delays: [u16; 8],
}

/// From 200 Hz down: but for the first, the filter runs at 400 Hz there.
const fn slow(divider: u8, code: u8, bandwidth: u16, delay: u16) -> Rate {
    Rate {
        divider,
        code,
        bandwidths: [bandwidth, 923, 766, 470, 388, 238, 192, 85],
        delays: [delay, 51, 58, 80, 91, 129, 153, 300],
    }
}

const RATES: [Rate; 6] = [
    Rate {
        divider: 0,
        code: 6,
        bandwidths: [4933, 2307, 1916, 1175, 971, 596, 480, 213],
        delays: [7, 21, 24, 32, 37, 52, 61, 120],
    },
    Rate {
        divider: 1,
        code: 15,
        bandwidths: [2467, 1153, 958, 588, 485, 298, 240, 106],
        delays: [13, 41, 47, 64, 73, 104, 122, 240],
    },
    slow(4, 7, 987, 33),
    slow(9, 8, 493, 65),
    slow(19, 9, 247, 129),
    slow(39, 10, 123, 257),
];

/// Returns the filters at a setting, or `None` if the sensor has no such rate.
fn at(config: &ImuConfig) -> Option<&'static Rate> {
    RATES.iter().find(|rate| rate.divider == config.divider)
}

/// Number of the filter next to the one that is asked for, as a ratio, and not above half
/// of the rate.
fn nearest(rate: &Rate, low_pass: LowPass) -> u8 {
    let asked = u32::from(low_pass.gyro_bandwidth_hz_times_10());
    // ODR/2, which is the widest.
    let most = rate.bandwidths[0];
    let filters = (0_u8..).zip(rate.bandwidths);
    let distance = |width: u32| width.max(asked) * 1_000 / width.min(asked);
    filters
        .filter(|(_, width)| *width <= most)
        .min_by_key(|(_, width)| distance((*width).into()))
        .map_or(0, |(filter, _)| filter)
}

pub(super) fn has(config: &ImuConfig) -> bool {
    at(config).is_some()
}

pub(super) fn describe(config: &ImuConfig) -> Description {
    // Another rate is refused.
    let rate = at(config).unwrap_or(&RATES[0]);
    let filter = usize::from(nearest(rate, config.low_pass));
    let delay_us = u32::from(rate.delays[filter]) * 100;
    let sensor = ImuSensor {
        model: ImuModel::Icm42688P,
        gyro_bandwidth_hz_times_10: rate.bandwidths[filter],
        // 3.1, 3.2 (z) and 14.6.
        gyro_noise_udps: 2_800,
        accel_noise_ug: 70,
        temperature_lsb_per_c_times_100: 13_248,
        temperature_at_zero_centidegrees: 2_500,
    };
    Description {
        gyro_delay_us: delay_us,
        accel_delay_us: delay_us,
        sensor,
    }
}

/// GYRO_FS_SEL in bits 7 to 5 (14.37).
const fn gyro_range(range: GyroRange) -> u8 {
    (match range {
        GyroRange::Dps2000 => 0,
        GyroRange::Dps1000 => 1,
        GyroRange::Dps500 => 2,
        GyroRange::Dps250 => 3,
    }) << 5
}

/// ACCEL_FS_SEL in bits 7 to 5 (14.38).
const fn accel_range(range: AccelRange) -> u8 {
    (match range {
        AccelRange::G16 => 0,
        AccelRange::G8 => 1,
        AccelRange::G4 => 2,
        AccelRange::G2 => 3,
    }) << 5
}

/// Everything but the clock, with both sensors off.
pub(super) async fn set_up<B: I2c>(
    registers: &mut Registers<B>,
    config: &ImuConfig,
    delay: &mut impl DelayNs,
) -> Result<(), ImuFault> {
    let rate = at(config).ok_or(ImuFault::NoSuchSetting)?;
    let filter = nearest(rate, config.low_pass);
    registers.write(REG_BANK_SEL, 0).await?;
    registers.write(DEVICE_CONFIG, SOFT_RESET).await?;
    delay.delay_ms(RESET_MS).await;
    registers.expect(DEVICE_CONFIG, SOFT_RESET, 0).await?;

    for (register, mask, value) in [
        // Slew rates for I2C (12.3).
        (DRIVE_CONFIG, 0x3F, 0x09),
        // INT1: a pulse, push-pull, active high (14.3).
        (INT_CONFIG, 0x07, 0x03),
        // All values are valid, so that the ends of the range are as in the MPUs (12.8, 14.34).
        (INTF_CONFIG0, 0x80, 0x80),
        (
            GYRO_CONFIG0,
            0xEF,
            gyro_range(config.gyro_range) | rate.code,
        ),
        (
            ACCEL_CONFIG0,
            0xEF,
            accel_range(config.accel_range) | rate.code,
        ),
        // Second order (14.39, 14.41).
        (GYRO_CONFIG1, 0x0C, 0x04),
        (ACCEL_CONFIG1, 0x18, 0x08),
        (GYRO_ACCEL_CONFIG0, 0xFF, (filter << 4) | filter),
        // A pulse of 100 µs; INT_ASYNC_RESET is to be cleared (12.6, 14.50).
        (INT_CONFIG1, 0x70, 0x00),
        // Data-ready alone (14.51).
        (INT_SOURCE0, 0x7F, 0x08),
    ] {
        registers.update(register, mask, value).await?;
    }
    registers.set(REG_BANK_SEL, 1).await?;
    // No anti-alias, no notch filter (15.2).
    registers
        .update(BANK1_GYRO_CONFIG_STATIC2, 0x03, 0x03)
        .await?;
    // I2C and no I3C (12.3).
    registers.update(BANK1_INTF_CONFIG6, 0x03, 0x00).await?;
    registers.set(REG_BANK_SEL, 2).await?;
    registers
        .update(BANK2_ACCEL_CONFIG_STATIC2, 0x01, 0x01)
        .await?;
    registers.set(REG_BANK_SEL, 0).await
}

/// Chooses the clock and switches both sensors on.
pub(super) async fn start<B: I2c>(
    registers: &mut Registers<B>,
    external: bool,
    delay: &mut impl DelayNs,
) -> Result<(), ImuFault> {
    if external {
        registers.set(REG_BANK_SEL, 1).await?;
        // Pin 9 is CLKIN (15.18).
        registers.update(BANK1_INTF_CONFIG5, 0x06, 0x04).await?;
        registers.set(REG_BANK_SEL, 0).await?;
        // RTC_MODE (14.35).
        registers.update(INTF_CONFIG1, 0x04, 0x04).await?;
    }
    registers.write(PWR_MGMT0, BOTH_ON).await?;
    delay.delay_us(QUIET_US).await;
    registers.expect(PWR_MGMT0, BOTH_ON, BOTH_ON).await
}

/// First of the seven registers of a sample, of two bytes each.
pub(super) const SAMPLE: u8 = TEMP_DATA1;

/// The sample in those registers.
pub(super) const fn sample([temperature, ax, ay, az, gx, gy, gz]: [i16; 7]) -> RawSample {
    RawSample {
        accel: [ax, ay, az],
        temperature,
        gyro: [gx, gy, gz],
    }
}
