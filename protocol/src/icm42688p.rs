//! Registers of the ICM-42688-P that the board uses, by their names in its data sheet
//! (DS-000347, revision 1.8, chapters 13 to 16). Those of another bank
//! than 0 are named after it.

crate::registers! {
    /// Software reset.
    DEVICE_CONFIG = 0x11;
    /// Slew rates of the pins.
    DRIVE_CONFIG = 0x13;
    /// Behaviour of the interrupt pins.
    INT_CONFIG = 0x14;
    /// First of the 14 bytes of a sample: temperature, acceleration, rate.
    TEMP_DATA1 = 0x1D;
    /// What registers of data may hold.
    INTF_CONFIG0 = 0x4C;
    /// Clock source.
    INTF_CONFIG1 = 0x4D;
    /// Which sensors are on.
    PWR_MGMT0 = 0x4E;
    /// Full scale and rate of the gyroscope.
    GYRO_CONFIG0 = 0x4F;
    /// Full scale and rate of the accelerometer.
    ACCEL_CONFIG0 = 0x50;
    /// Order of the gyroscope's low-pass.
    GYRO_CONFIG1 = 0x51;
    /// Bandwidths of both low-passes.
    GYRO_ACCEL_CONFIG0 = 0x52;
    /// Order of the accelerometer's low-pass.
    ACCEL_CONFIG1 = 0x53;
    /// Length of the interrupt's pulse.
    INT_CONFIG1 = 0x64;
    /// Which interrupts are on INT1.
    INT_SOURCE0 = 0x65;
    /// Identity.
    WHO_AM_I = 0x75;
    /// Which bank the addresses mean.
    REG_BANK_SEL = 0x76;
    /// Notch and anti-alias filter of the gyroscope (bank 1).
    BANK1_GYRO_CONFIG_STATIC2 = 0x0B;
    /// What pin 9 is (bank 1).
    BANK1_INTF_CONFIG5 = 0x7B;
    /// Which buses are on (bank 1).
    BANK1_INTF_CONFIG6 = 0x7C;
    /// Anti-alias filter of the accelerometer (bank 2).
    BANK2_ACCEL_CONFIG_STATIC2 = 0x03;
}
