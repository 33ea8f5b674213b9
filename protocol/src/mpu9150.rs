//! Registers of the MPU family (MPU-6050, 9150, 6500, 9250) that the board uses, by their
//! names in the "MPU-9150 Register Map and Descriptions", RM-MPU-9150A-00. The MPU-6500
//! and MPU-9250 have [`ACCEL_CONFIG_2`] beside them (RM-MPU-6500A-00, 4.8).

/// I2C address with AD0 low, of the ICM-42688-P too.
pub const ADDRESS: u8 = 0x68;

/// Divider of the sample rate.
pub const SMPLRT_DIV: u8 = 0x19;
/// Digital low-pass.
pub const CONFIG: u8 = 0x1A;
/// Full scale of the gyroscope.
pub const GYRO_CONFIG: u8 = 0x1B;
/// Full scale of the accelerometer.
pub const ACCEL_CONFIG: u8 = 0x1C;
/// Low-pass of the accelerometer, where it has its own.
pub const ACCEL_CONFIG_2: u8 = 0x1D;
/// Behaviour of the interrupt pin.
pub const INT_PIN_CFG: u8 = 0x37;
/// Which interrupts are on.
pub const INT_ENABLE: u8 = 0x38;
/// First of the 14 bytes of a sample: acceleration, temperature, rate.
pub const ACCEL_XOUT_H: u8 = 0x3B;
/// Reset, sleep, clock source.
pub const PWR_MGMT_1: u8 = 0x6B;
/// Identity.
pub const WHO_AM_I: u8 = 0x75;
