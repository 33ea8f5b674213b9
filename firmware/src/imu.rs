//! Drivers of the IMUs that the board takes.
//!
//! Over any `embedded-hal-async` I2C bus. They do not time out by themselves: the
//! caller drops a transfer that takes too long and asks [`Imu::register`] which one it
//! was. Every setting is read back.
//!
//! A family is a file with the same five functions: [`mpu`] (MPU-6050, 9150, 6500, 9250)
//! and [`icm42688p`]. [`Imu`] finds out which it is, by WHO_AM_I, which is register 0x75 at
//! address 0x68 in all of them, and calls the right one. Families are an enum and not trait
//! objects: `no_std` has no boxed futures, and the compiler names every place where a new
//! one is missing.
//!
//! The interrupt pin gives a short pulse for each sample, whether the last
//! one was read or not, so that a sample that is not read in time is seen as an
//! edge without data and not as silence. That edge is the sample's time, whatever clock the
//! sensor runs on.

pub(crate) mod icm42688p;
pub(crate) mod mpu;

use core::array;

use embedded_hal::i2c::{Error, ErrorKind};
use embedded_hal_async::delay::DelayNs;
use embedded_hal_async::i2c::I2c;
use protocol::mpu9150::{ADDRESS, WHO_AM_I};
use protocol::{
    ImuClock, ImuConfig, ImuFault, ImuModel, ImuSensor, ImuSetup, ImuStatus, Refusal, TICK_HZ,
};

/// Highest rate, in Hz: what [`ImuConfig::divider`] divides.
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
    /// Returns true if an axis is at an end of its range.
    #[must_use]
    pub fn is_saturated(&self) -> bool {
        let at_end = |&value: &i16| value == i16::MIN || value == i16::MAX;
        self.accel.iter().any(at_end) || self.gyro.iter().any(at_end)
    }
}

/// Which file drives a sensor.
#[derive(Clone, Copy)]
enum Family {
    Mpu,
    Icm42688P,
}

/// The family of a sensor; one that is not found yet counts as an MPU-6050.
const fn family(model: ImuModel) -> Family {
    match model {
        ImuModel::Unknown | ImuModel::Mpu6050 | ImuModel::Mpu6500 | ImuModel::Mpu9250 => {
            Family::Mpu
        }
        ImuModel::Icm42688P => Family::Icm42688P,
    }
}

/// A family's properties at one setting.
struct Description {
    gyro_delay_us: u32,
    accel_delay_us: u32,
    sensor: ImuSensor,
}

const fn interval_ticks(config: &ImuConfig) -> u32 {
    (config.divider as u32 + 1) * (TICK_HZ / BASE_RATE_HZ)
}

/// Milliseconds between samples.
#[must_use]
pub const fn interval_ms(config: &ImuConfig) -> u32 {
    (config.divider as u32 + 1) * 1_000 / BASE_RATE_HZ
}

/// Refuses settings that this sensor does not have.
///
/// # Errors
///
/// The divider is above [`ImuConfig::MAX_DIVIDER`], or the sensor has no such rate.
pub fn check(model: ImuModel, config: &ImuConfig) -> Result<(), Refusal> {
    let has = match family(model) {
        Family::Mpu => mpu::has(config),
        Family::Icm42688P => icm42688p::has(config),
    };
    if has {
        Ok(())
    } else {
        Err(Refusal::ImuSettingOutOfRange)
    }
}

/// The IMU as it is set up, with the scales and delays that follow. One that is not
/// found yet is described as an MPU-6050.
#[must_use]
pub fn describe(model: ImuModel, config: ImuConfig, status: ImuStatus) -> ImuSetup {
    let found = match family(model) {
        Family::Mpu => mpu::describe(model, &config),
        Family::Icm42688P => icm42688p::describe(&config),
    };
    ImuSetup {
        config,
        interval: interval_ticks(&config),
        gyro_lsb_per_dps_times_10: config.gyro_range.lsb_per_dps_times_10(),
        accel_lsb_per_g: config.accel_range.lsb_per_g(),
        gyro_delay_us: found.gyro_delay_us,
        accel_delay_us: found.accel_delay_us,
        status,
        sensor: found.sensor,
    }
}

/// Whose identity it is.
const fn model_of(identity: u8) -> Option<ImuModel> {
    Some(match identity {
        mpu::IDENTITY_6050 => ImuModel::Mpu6050,
        mpu::IDENTITY_6500 => ImuModel::Mpu6500,
        mpu::IDENTITY_9250 | mpu::IDENTITY_9255 => ImuModel::Mpu9250,
        icm42688p::IDENTITY => ImuModel::Icm42688P,
        _ => return None,
    })
}

/// The sensor on its bus.
#[derive(Debug)]
pub struct Imu<B> {
    registers: Registers<B>,
    model: ImuModel,
}

impl<B: I2c> Imu<B> {
    /// The sensor at its one address; `model` is what an earlier [`Imu::set_up`] found.
    #[must_use]
    pub const fn new(bus: B, model: ImuModel) -> Self {
        let registers = Registers { bus, register: 0 };
        Self { registers, model }
    }

    /// The register that the last transfer was about.
    #[must_use]
    pub const fn register(&self) -> u8 {
        self.registers.register
    }

    /// Which sensor [`Imu::set_up`] found.
    #[must_use]
    pub const fn model(&self) -> ImuModel {
        self.model
    }

    /// Finds out which sensor it is, resets it and sets it up on its own clock, up to
    /// what [`Imu::start`] does.
    ///
    /// # Errors
    ///
    /// Faults of the bus; an unknown sensor; settings that it does not have; a register that
    /// does not keep what is written.
    pub async fn set_up(
        &mut self,
        config: &ImuConfig,
        delay: &mut impl DelayNs,
    ) -> Result<(), ImuFault> {
        self.model = self.identify().await?;
        if check(self.model, config).is_err() {
            return Err(ImuFault::NoSuchSetting);
        }
        let registers = &mut self.registers;
        match family(self.model) {
            Family::Mpu => mpu::set_up(registers, self.model, config, delay).await,
            Family::Icm42688P => icm42688p::set_up(registers, config, delay).await,
        }
    }

    /// Starts a sensor that is set up: on its own clock, or on the one at CLKIN, if it takes
    /// one. Without a clock there it may stop, and may not even answer any more: then it is
    /// to be set up again.
    ///
    /// # Errors
    ///
    /// Faults of the bus; a register does not keep what is written.
    pub async fn start(
        &mut self,
        clock: ImuClock,
        delay: &mut impl DelayNs,
    ) -> Result<(), ImuFault> {
        let external = matches!(clock, ImuClock::External);
        let registers = &mut self.registers;
        match family(self.model) {
            Family::Mpu => mpu::start(registers, external).await,
            Family::Icm42688P => icm42688p::start(registers, external, delay).await,
        }
    }

    /// Reads a sample. One transfer: the sensor keeps the registers of one
    /// sample together while they are read.
    ///
    /// # Errors
    ///
    /// Faults of the bus.
    pub async fn read_sample(&mut self) -> Result<RawSample, ImuFault> {
        let (register, sample): (u8, fn([i16; 7]) -> RawSample) = match family(self.model) {
            Family::Mpu => (mpu::SAMPLE, mpu::sample),
            Family::Icm42688P => (icm42688p::SAMPLE, icm42688p::sample),
        };
        let bytes: [u8; 14] = self.registers.read_all(register).await?;
        Ok(sample(array::from_fn(|word| {
            i16::from_be_bytes([bytes[2 * word], bytes[2 * word + 1]])
        })))
    }

    async fn identify(&mut self) -> Result<ImuModel, ImuFault> {
        if let Some(model) = model_of(self.registers.read(WHO_AM_I).await?) {
            return Ok(model);
        }
        // An ICM-42688-P whose set-up was cut short may still show another bank.
        self.registers
            .write(protocol::icm42688p::REG_BANK_SEL, 0)
            .await?;
        let found = self.registers.read(WHO_AM_I).await?;
        model_of(found).ok_or(ImuFault::WrongIdentity { found })
    }
}

/// Access to single registers.
#[derive(Debug)]
struct Registers<B> {
    bus: B,
    /// Register of the last transfer.
    register: u8,
}

impl<B: I2c> Registers<B> {
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

    /// Sets the bits of `mask` to those of `value`, and leaves the others.
    async fn update(&mut self, register: u8, mask: u8, value: u8) -> Result<(), ImuFault> {
        let before = self.read(register).await?;
        self.set(register, (before & !mask) | value).await
    }

    /// Reads a register, and the next: of a single byte the STOP must be asked for while that is
    /// on the wire (AN2824), and this driver can be interrupted.
    async fn read(&mut self, register: u8) -> Result<u8, ImuFault> {
        let [value, _] = self.read_all(register).await?;
        Ok(value)
    }

    /// Reads registers from `register` on, in one transfer.
    async fn read_all<const N: usize>(&mut self, register: u8) -> Result<[u8; N], ImuFault> {
        self.register = register;
        let mut bytes = [0; N];
        let result = self.bus.write_read(ADDRESS, &[register], &mut bytes).await;
        result.map_err(|error| fault(&error, register))?;
        Ok(bytes)
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

/// Returns the fault that reports a bus error in messages.
fn fault(error: &impl Error, register: u8) -> ImuFault {
    match error.kind() {
        ErrorKind::NoAcknowledge(_) => ImuFault::NoAcknowledge { register },
        _ => ImuFault::Bus { register },
    }
}

#[cfg(test)]
mod tests;
