//! Driver of the MPU-9150's accelerometer and gyroscope.
//!
//! Over any `embedded-hal-async` I2C bus. It does not time out by itself: the
//! caller drops a transfer that takes too long and asks [`Mpu9150::register`]
//! which one it was. Register names and values follow the register map
//! (RM-MPU-9150A-00); every setting is read back.
//!
//! The interrupt pin gives a pulse of 50 µs for each sample, whether the last
//! one was read or not, so that a sample that is not read in time is seen as an
//! edge without data and not as silence.

use embedded_hal::i2c::{Error, ErrorKind};
use embedded_hal_async::delay::DelayNs;
use embedded_hal_async::i2c::I2c;
use protocol::mpu9150::{
    ACCEL_CONFIG, ACCEL_XOUT_H, ADDRESS, CONFIG, GYRO_CONFIG, IDENTITY, INT_ENABLE, INT_PIN_CFG,
    PWR_MGMT_1, SMPLRT_DIV, WHO_AM_I,
};
use protocol::{
    AccelRange, GyroRange, ImuConfig, ImuFault, ImuSetup, ImuStatus, LowPass, Refusal, TICK_HZ,
};

/// PWR_MGMT_1: reset all registers; the bit clears itself.
const DEVICE_RESET: u8 = 0x80;

/// PWR_MGMT_1 after a reset: asleep.
const AFTER_RESET: u8 = 0x40;

/// PWR_MGMT_1, CLKSEL: PLL with the x gyroscope as reference.
const CLOCK_GYRO_X: u8 = 1;

/// PWR_MGMT_1, CLKSEL: PLL with external 19.2 MHz.
const CLOCK_EXTERNAL: u8 = 5;

/// INT_PIN_CFG: active high, push-pull, a pulse of 50 µs, cleared by any read.
const INTERRUPT_PULSE: u8 = 0x10;

/// INT_ENABLE: DATA_RDY_EN.
const INTERRUPT_DATA_READY: u8 = 0x01;

/// From reset to the next access, in ms: the data sheet gives 11 ms as typical,
/// 100 as the most (6.3).
const RESET_MS: u32 = 100;

/// Sampling rate before the divider, with the low-pass on, in Hz.
const BASE_RATE_HZ: u32 = 1_000;

/// The registers of a sample, as they are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RawSample {
    /// Acceleration x, y, z.
    pub accel: [i16; 3],
    /// Die temperature.
    pub temperature: i16,
    /// Angular rate x, y, z.
    pub gyro: [i16; 3],
}

impl RawSample {
    /// From the 14 bytes at ACCEL_XOUT_H, big-endian.
    const fn from_bytes(bytes: &[u8; 14]) -> Self {
        const fn word(bytes: &[u8; 14], index: usize) -> i16 {
            i16::from_be_bytes([bytes[2 * index], bytes[2 * index + 1]])
        }
        Self {
            accel: [word(bytes, 0), word(bytes, 1), word(bytes, 2)],
            temperature: word(bytes, 3),
            gyro: [word(bytes, 4), word(bytes, 5), word(bytes, 6)],
        }
    }

    /// Whether an axis stands at an end of its range.
    #[must_use]
    pub fn is_saturated(&self) -> bool {
        let at_end = |&value: &i16| value == i16::MIN || value == i16::MAX;
        self.accel.iter().any(at_end) || self.gyro.iter().any(at_end)
    }
}

const fn interval_ticks(config: &ImuConfig) -> u32 {
    (config.divider as u32 + 1) * (TICK_HZ / BASE_RATE_HZ)
}

/// Milliseconds between samples.
#[must_use]
pub const fn interval_ms(config: &ImuConfig) -> u32 {
    (config.divider as u32 + 1) * 1_000 / BASE_RATE_HZ
}

/// Refuses settings that the board does not take.
///
/// # Errors
///
/// The divider is above [`ImuConfig::MAX_DIVIDER`].
pub const fn check(config: &ImuConfig) -> Result<(), Refusal> {
    if config.divider > ImuConfig::MAX_DIVIDER {
        return Err(Refusal::ImuSettingOutOfRange);
    }
    Ok(())
}

/// The IMU as it is set up, with the scales and delays that follow.
#[must_use]
pub const fn describe(config: ImuConfig, status: ImuStatus) -> ImuSetup {
    ImuSetup {
        config,
        interval: interval_ticks(&config),
        gyro_lsb_per_dps_times_10: config.gyro_range.lsb_per_dps_times_10(),
        accel_lsb_per_g: config.accel_range.lsb_per_g(),
        gyro_delay_us: config.low_pass.gyro_delay_us(),
        accel_delay_us: config.low_pass.accel_delay_us(),
        status,
    }
}

/// DLPF_CFG (register map, 4.3).
const fn dlpf_cfg(low_pass: LowPass) -> u8 {
    match low_pass {
        LowPass::Hz188 => 1,
        LowPass::Hz98 => 2,
        LowPass::Hz42 => 3,
        LowPass::Hz20 => 4,
        LowPass::Hz10 => 5,
        LowPass::Hz5 => 6,
    }
}

/// GYRO_CONFIG: FS_SEL in bits 4 and 3 (register map, 4.4).
const fn gyro_config(range: GyroRange) -> u8 {
    (match range {
        GyroRange::Dps250 => 0,
        GyroRange::Dps500 => 1,
        GyroRange::Dps1000 => 2,
        GyroRange::Dps2000 => 3,
    }) << 3
}

/// ACCEL_CONFIG: AFS_SEL in bits 4 and 3 (register map, 4.5).
const fn accel_config(range: AccelRange) -> u8 {
    (match range {
        AccelRange::G2 => 0,
        AccelRange::G4 => 1,
        AccelRange::G8 => 2,
        AccelRange::G16 => 3,
    }) << 3
}

/// The sensor on its bus.
#[derive(Debug)]
pub struct Mpu9150<B> {
    bus: B,
    register: u8,
}

impl<B: I2c> Mpu9150<B> {
    /// The sensor at its one address.
    #[must_use]
    pub const fn new(bus: B) -> Self {
        Self { bus, register: 0 }
    }

    /// The register that the last transfer was about.
    #[must_use]
    pub const fn register(&self) -> u8 {
        self.register
    }

    /// Resets the sensor and sets it up on its own clock, up to data-ready pulses.
    ///
    /// # Errors
    ///
    /// Faults of the bus; another sensor; a register that does not keep what
    /// is written.
    pub async fn set_up(
        &mut self,
        config: &ImuConfig,
        delay: &mut impl DelayNs,
    ) -> Result<(), ImuFault> {
        let found = self.read(WHO_AM_I).await?;
        if found != IDENTITY {
            return Err(ImuFault::WrongIdentity { found });
        }
        self.write(PWR_MGMT_1, DEVICE_RESET).await?;
        delay.delay_ms(RESET_MS).await;
        self.expect(PWR_MGMT_1, DEVICE_RESET, AFTER_RESET).await?;

        for (register, value) in [
            (PWR_MGMT_1, CLOCK_GYRO_X),
            (SMPLRT_DIV, config.divider),
            (CONFIG, dlpf_cfg(config.low_pass)),
            (GYRO_CONFIG, gyro_config(config.gyro_range)),
            (ACCEL_CONFIG, accel_config(config.accel_range)),
            (INT_PIN_CFG, INTERRUPT_PULSE),
            (INT_ENABLE, INTERRUPT_DATA_READY),
        ] {
            self.set(register, value).await?;
        }
        Ok(())
    }

    /// Switches a sensor that is set up to the clock at CLKIN. Without one there it may
    /// stop, and may not even answer any more: then it is to be set up again.
    ///
    /// # Errors
    ///
    /// Faults of the bus; the register does not keep what is written.
    pub async fn use_external_clock(&mut self) -> Result<(), ImuFault> {
        self.set(PWR_MGMT_1, CLOCK_EXTERNAL).await
    }

    /// Reads a sample. One transfer: the sensor keeps the registers of one
    /// sample together while they are read.
    ///
    /// # Errors
    ///
    /// Faults of the bus.
    pub async fn read_sample(&mut self) -> Result<RawSample, ImuFault> {
        let mut bytes = [0; 14];
        self.register = ACCEL_XOUT_H;
        let result = self.bus.write_read(ADDRESS, &[ACCEL_XOUT_H], &mut bytes);
        result.await.map_err(|error| fault(&error, ACCEL_XOUT_H))?;
        Ok(RawSample::from_bytes(&bytes))
    }

    async fn write(&mut self, register: u8, value: u8) -> Result<(), ImuFault> {
        self.register = register;
        let result = self.bus.write(ADDRESS, &[register, value]).await;
        result.map_err(|error| fault(&error, register))
    }

    /// Writes a register and reads it back.
    async fn set(&mut self, register: u8, value: u8) -> Result<(), ImuFault> {
        self.write(register, value).await?;
        self.expect(register, value, value).await
    }

    async fn read(&mut self, register: u8) -> Result<u8, ImuFault> {
        self.register = register;
        let mut value = [0];
        let result = self.bus.write_read(ADDRESS, &[register], &mut value).await;
        result.map_err(|error| fault(&error, register))?;
        Ok(value[0])
    }

    async fn expect(&mut self, register: u8, wrote: u8, expected: u8) -> Result<(), ImuFault> {
        let read = self.read(register).await?;
        if read != expected {
            return Err(ImuFault::Readback {
                register,
                wrote,
                read,
            });
        }
        Ok(())
    }
}

/// What an error of the bus is called in messages.
fn fault(error: &impl Error, register: u8) -> ImuFault {
    match error.kind() {
        ErrorKind::NoAcknowledge(_) => ImuFault::NoAcknowledge { register },
        _ => ImuFault::Bus { register },
    }
}

#[cfg(test)]
mod tests;
