//! Registers of the MPU family (MPU-6050, 9150, 6500, 9250) that the board uses, by their
//! names in the "MPU-9150 Register Map and Descriptions", RM-MPU-9150A-00. The MPU-6500
//! and MPU-9250 have [`ACCEL_CONFIG_2`] beside them (RM-MPU-6500A-00, 4.8).

/// I2C address with AD0 low, of the ICM-42688-P too.
pub const ADDRESS: u8 = 0x68;

crate::registers! {
    /// Divider of the sample rate.
    SMPLRT_DIV = 0x19;
    /// Digital low-pass.
    CONFIG = 0x1A;
    /// Full scale of the gyroscope.
    GYRO_CONFIG = 0x1B;
    /// Full scale of the accelerometer.
    ACCEL_CONFIG = 0x1C;
    /// Low-pass of the accelerometer, where it has its own.
    ACCEL_CONFIG_2 = 0x1D;
    /// Behaviour of the interrupt pin.
    INT_PIN_CFG = 0x37;
    /// Which interrupts are on.
    INT_ENABLE = 0x38;
    /// First of the 14 bytes of a sample: acceleration, temperature, rate.
    ACCEL_XOUT_H = 0x3B;
    /// Reset, sleep, clock source.
    PWR_MGMT_1 = 0x6B;
    /// Identity.
    WHO_AM_I = 0x75;
}
