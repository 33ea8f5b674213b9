//! Registers of the MPU-9150 that the board uses (MPU-9150 Register Map and
//! Descriptions, RM-MPU-9150A-00), by their names there.

/// I2C address with AD0 low.
pub const ADDRESS: u8 = 0x68;

/// What WHO_AM_I holds.
pub const IDENTITY: u8 = 0x68;

macro_rules! registers {
    ($($(#[$doc:meta])* $name:ident = $number:expr;)*) => {
        $($(#[$doc])* pub const $name: u8 = $number;)*

        /// The name of a register in the register map, if it is one of these.
        #[must_use]
        pub const fn register_name(register: u8) -> Option<&'static str> {
            match register {
                $($name => Some(stringify!($name)),)*
                _ => None,
            }
        }
    };
}

registers! {
    /// Divider of the sample rate.
    SMPLRT_DIV = 0x19;
    /// Digital low-pass.
    CONFIG = 0x1A;
    /// Full scale of the gyroscope.
    GYRO_CONFIG = 0x1B;
    /// Full scale of the accelerometer.
    ACCEL_CONFIG = 0x1C;
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
