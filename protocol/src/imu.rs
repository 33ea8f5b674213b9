//! The IMU: its settings, samples and status.

use serde::{Deserialize, Serialize};

use crate::units::Ticks;

/// One sample of the IMU, as read from the registers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImuSample {
    /// Sequence number of the sample stream.
    pub seq: u32,
    /// The captured edge of data-ready. The sensor's filter delay is *not*
    /// subtracted ([`ImuSetup::gyro_delay_us`]).
    pub at: Ticks,
    /// Peculiarities of this sample.
    pub flags: ImuFlags,
    /// Acceleration x, y, z, in counts of [`ImuSetup::accel_lsb_per_g`].
    pub accel: [i16; 3],
    /// Die temperature, in counts of [`ImuSensor::temperature_lsb_per_c_times_100`].
    pub temperature: i16,
    /// Angular rate x, y, z, in counts of [`ImuSetup::gyro_lsb_per_dps_times_10`].
    pub gyro: [i16; 3],
}

/// Flags of one sample, as bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImuFlags(pub u8);

impl ImuFlags {
    /// The next data-ready came before the registers were read: the values may
    /// belong to the next sample.
    pub const LATE: Self = Self(1);
    /// At least one axis stands at an end of its range.
    pub const SATURATED: Self = Self(2);
    /// The first sample after the sensor was set up or recovered.
    pub const FIRST: Self = Self(4);
    /// At least one data-ready edge before this sample was lost.
    pub const AFTER_LOSS: Self = Self(8);

    /// Returns true if all bits of `flag` are set.
    #[must_use]
    pub const fn has(self, flag: Self) -> bool {
        self.0 & flag.0 == flag.0
    }

    /// Both together.
    #[must_use]
    pub const fn with(self, flag: Self) -> Self {
        Self(self.0 | flag.0)
    }
}

/// Settings of the IMU.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImuConfig {
    /// The rate is 1 kHz / (1 + divider); 0 to [`ImuConfig::MAX_DIVIDER`]. The
    /// ICM-42688-P has 0, 1, 4, 9, 19 and 39 alone.
    pub divider: u8,
    /// The digital low-pass: of those that the sensor has at this rate, the nearest.
    /// [`ImuSensor::gyro_bandwidth_hz_times_10`] says which that is.
    pub low_pass: LowPass,
    /// Full scale of the gyroscope.
    pub gyro_range: GyroRange,
    /// Full scale of the accelerometer.
    pub accel_range: AccelRange,
}

impl ImuConfig {
    /// The largest divider that the board takes: 5 Hz. Slower, and a sensor
    /// that fell silent could not be distinguished from a slow one within a second.
    pub const MAX_DIVIDER: u8 = 199;
}

/// Bandwidth of the gyroscope's low-pass, by its value in the MPU-6050 and MPU-9150.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum LowPass {
    /// 188 Hz.
    Hz188,
    /// 98 Hz.
    Hz98,
    /// 42 Hz.
    Hz42,
    /// 20 Hz.
    Hz20,
    /// 10 Hz.
    Hz10,
    /// 5 Hz.
    Hz5,
}

/// Full scale of the gyroscope.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum GyroRange {
    /// ±250 °/s, 131 LSB per °/s.
    Dps250,
    /// ±500 °/s, 65.5 LSB per °/s.
    Dps500,
    /// ±1000 °/s, 32.8 LSB per °/s.
    Dps1000,
    /// ±2000 °/s, 16.4 LSB per °/s.
    Dps2000,
}

/// Full scale of the accelerometer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum AccelRange {
    /// ±2 g, 16,384 LSB per g.
    G2,
    /// ±4 g, 8,192 LSB per g.
    G4,
    /// ±8 g, 4,096 LSB per g.
    G8,
    /// ±16 g, 2,048 LSB per g.
    G16,
}

impl LowPass {
    /// Bandwidth of the gyroscope's low-pass in the MPU-6050 and MPU-9150, in 0.1 Hz
    /// (their register maps, 4.3).
    #[must_use]
    pub const fn gyro_bandwidth_hz_times_10(self) -> u16 {
        match self {
            Self::Hz188 => 1_880,
            Self::Hz98 => 980,
            Self::Hz42 => 420,
            Self::Hz20 => 200,
            Self::Hz10 => 100,
            Self::Hz5 => 50,
        }
    }

    /// Group delay of the gyroscope's low-pass in the MPU-6050 and MPU-9150, in µs
    /// (their register maps, 4.3).
    #[must_use]
    pub const fn gyro_delay_us(self) -> u32 {
        match self {
            Self::Hz188 => 1_900,
            Self::Hz98 => 2_800,
            Self::Hz42 => 4_800,
            Self::Hz20 => 8_300,
            Self::Hz10 => 13_400,
            Self::Hz5 => 18_600,
        }
    }

    /// Group delay of the accelerometer's low-pass in the MPU-6050 and MPU-9150, in µs
    /// (their register maps, 4.3).
    #[must_use]
    pub const fn accel_delay_us(self) -> u32 {
        match self {
            Self::Hz188 => 2_000,
            Self::Hz98 => 3_000,
            Self::Hz42 => 4_900,
            Self::Hz20 => 8_500,
            Self::Hz10 => 13_800,
            Self::Hz5 => 19_000,
        }
    }
}

impl GyroRange {
    /// Counts per °/s, times ten, of all families (MPU-9150 register map, 4.19;
    /// ICM-42688-P data sheet, 3.1).
    #[must_use]
    pub const fn lsb_per_dps_times_10(self) -> u16 {
        match self {
            Self::Dps250 => 1_310,
            Self::Dps500 => 655,
            Self::Dps1000 => 328,
            Self::Dps2000 => 164,
        }
    }
}

impl AccelRange {
    /// Counts per g, of all families (MPU-9150 register map, 4.17; ICM-42688-P data
    /// sheet, 3.2).
    #[must_use]
    pub const fn lsb_per_g(self) -> u16 {
        match self {
            Self::G2 => 16_384,
            Self::G4 => 8_192,
            Self::G8 => 4_096,
            Self::G16 => 2_048,
        }
    }
}

/// The IMU as it is set up now.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImuSetup {
    /// The settings.
    pub config: ImuConfig,
    /// Nominal distance of samples, in ticks.
    pub interval: u32,
    /// Counts per °/s, times ten.
    pub gyro_lsb_per_dps_times_10: u16,
    /// Counts per g.
    pub accel_lsb_per_g: u16,
    /// Documented delay of the gyroscope's low-pass, in µs, to be subtracted by
    /// the host.
    pub gyro_delay_us: u32,
    /// The same of the accelerometer, in µs.
    pub accel_delay_us: u32,
    /// Its status.
    pub status: ImuStatus,
    /// The sensor that was found.
    pub sensor: ImuSensor,
}

/// A family of sensors, as the identity register tells it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ImuModel {
    /// Not found yet.
    Unknown,
    /// MPU-6050 or MPU-9150, which have one identity and one register map.
    Mpu6050,
    /// MPU-6500.
    Mpu6500,
    /// MPU-9250.
    Mpu9250,
    /// ICM-42688-P.
    Icm42688P,
}

impl ImuModel {
    /// Returns the maker's name of it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Unknown => "not found",
            Self::Mpu6050 => "MPU-6050 or MPU-9150",
            Self::Mpu6500 => "MPU-6500",
            Self::Mpu9250 => "MPU-9250",
            Self::Icm42688P => "ICM-42688-P",
        }
    }

    /// The pin of the board and the frequency of the clock that its CLKIN takes; `None`
    /// if it has no such pin.
    #[must_use]
    pub const fn clock_input(self) -> Option<(&'static str, &'static str)> {
        match self {
            Self::Unknown | Self::Mpu6050 => Some(("PA8", "19.2 MHz")),
            Self::Mpu6500 | Self::Mpu9250 => None,
            Self::Icm42688P => Some(("PB0", "32 kHz")),
        }
    }
}

/// Properties of the sensor, by its data sheet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImuSensor {
    /// The family.
    pub model: ImuModel,
    /// Bandwidth of the gyroscope's low-pass as it is set, in 0.1 Hz; 0 if not reported.
    pub gyro_bandwidth_hz_times_10: u16,
    /// Noise density of the gyroscope, in µ°/s/√Hz.
    pub gyro_noise_udps: u16,
    /// Noise density of the accelerometer, in µg/√Hz.
    pub accel_noise_ug: u16,
    /// Counts of the thermometer per °C, times 100.
    pub temperature_lsb_per_c_times_100: u16,
    /// Temperature at a count of 0, in 0.01 °C.
    pub temperature_at_zero_centidegrees: i16,
}

impl ImuSensor {
    /// The MPU-9150 (product specification 6.1 and 6.2, register map 4.18), its bandwidth
    /// not reported.
    pub const MPU_9150: Self = Self {
        model: ImuModel::Mpu6050,
        gyro_bandwidth_hz_times_10: 0,
        gyro_noise_udps: 5_000,
        accel_noise_ug: 400,
        temperature_lsb_per_c_times_100: 34_000,
        temperature_at_zero_centidegrees: 3_500,
    };
}

impl Default for ImuSensor {
    fn default() -> Self {
        Self::MPU_9150
    }
}

/// Status of the IMU. Counters count from reset and saturate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImuStatus {
    /// State of the IMU.
    pub state: ImuState,
    /// Source of its clock.
    pub clock: ImuClock,
    /// Samples read.
    pub samples: u32,
    /// Samples marked [`ImuFlags::LATE`].
    pub late: u32,
    /// Data-ready edges lost (over-captures of TIM2 channel 2).
    pub overcaptures: u32,
    /// Number of times that the sensor was set up again after a fault.
    pub recoveries: u32,
    /// The last fault, if there was one.
    pub last_fault: Option<ImuFault>,
}

/// State of the IMU.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ImuState {
    /// Being set up.
    #[default]
    Starting,
    /// Samples come.
    Running,
    /// Not there or not well; tried again several times a second.
    Failed,
}

/// Source of the IMU's clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ImuClock {
    /// The board's ([`ImuModel::clock_input`]): its samples are an exact division of board
    /// time.
    External,
    /// Its own: a rate error of up to ±1 % (MPU family) or ±1.5 % (ICM-42688-P).
    Internal,
    /// Not known yet.
    #[default]
    Unknown,
}

/// A fault of the IMU; `register` is the number in the sensor's register map
/// ([`crate::mpu9150::register_name`], [`crate::icm42688p::register_name`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ImuFault {
    /// No acknowledge.
    NoAcknowledge {
        /// Being written or read.
        register: u8,
    },
    /// SDA or SCL held low, even after nine clocks.
    BusHeld,
    /// A transfer did not end in time.
    Timeout {
        /// Being written or read.
        register: u8,
    },
    /// Any other error of the bus (arbitration lost, misplaced start or stop).
    Bus {
        /// Being written or read.
        register: u8,
    },
    /// WHO_AM_I is none of the known sensors'.
    WrongIdentity {
        /// The identity that was read.
        found: u8,
    },
    /// A register did not keep what was written.
    Readback {
        /// The register.
        register: u8,
        /// Value written.
        wrote: u8,
        /// Value read.
        read: u8,
    },
    /// The sensor is set up, but no data-ready comes.
    NoDataReady,
    /// This sensor does not have the settings that it was to get.
    NoSuchSetting,
}
