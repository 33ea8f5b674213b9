//! Registers of the ICM-42688-P that the board uses, by their names in its data sheet
//! (DS-000347, revision 1.8, chapters 13 to 16). Those of another bank
//! than 0 are named after it.

/// Software reset.
pub const DEVICE_CONFIG: u8 = 0x11;
/// Slew rates of the pins.
pub const DRIVE_CONFIG: u8 = 0x13;
/// Behaviour of the interrupt pins.
pub const INT_CONFIG: u8 = 0x14;
/// First of the 14 bytes of a sample: temperature, acceleration, rate.
pub const TEMP_DATA1: u8 = 0x1D;
/// Format of the data registers.
pub const INTF_CONFIG0: u8 = 0x4C;
/// Clock source.
pub const INTF_CONFIG1: u8 = 0x4D;
/// Which sensors are on.
pub const PWR_MGMT0: u8 = 0x4E;
/// Full scale and rate of the gyroscope.
pub const GYRO_CONFIG0: u8 = 0x4F;
/// Full scale and rate of the accelerometer.
pub const ACCEL_CONFIG0: u8 = 0x50;
/// Order of the gyroscope's low-pass.
pub const GYRO_CONFIG1: u8 = 0x51;
/// Bandwidths of both low-passes.
pub const GYRO_ACCEL_CONFIG0: u8 = 0x52;
/// Order of the accelerometer's low-pass.
pub const ACCEL_CONFIG1: u8 = 0x53;
/// Length of the interrupt's pulse.
pub const INT_CONFIG1: u8 = 0x64;
/// Which interrupts are on INT1.
pub const INT_SOURCE0: u8 = 0x65;
/// Identity.
pub const WHO_AM_I: u8 = 0x75;
/// Which bank the addresses mean.
pub const REG_BANK_SEL: u8 = 0x76;
/// Notch and anti-alias filter of the gyroscope (bank 1).
pub const BANK1_GYRO_CONFIG_STATIC2: u8 = 0x0B;
/// Function of pin 9 (bank 1).
pub const BANK1_INTF_CONFIG5: u8 = 0x7B;
/// Which buses are on (bank 1).
pub const BANK1_INTF_CONFIG6: u8 = 0x7C;
/// Anti-alias filter of the accelerometer (bank 2).
pub const BANK2_ACCEL_CONFIG_STATIC2: u8 = 0x03;
