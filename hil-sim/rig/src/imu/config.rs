//! The sensor and its properties: plain data.

use nalgebra::Rotation3;

use super::icm42688p::IcmRegisters;
use super::map::RegisterMap;
use super::mpu::MpuRegisters;
use crate::clocks::oscillator::OscillatorConfig;
use crate::motion::STANDARD_GRAVITY;
use crate::motion::inertial_channel::ChannelConfig;
use crate::random::{Seed, Stream};
use stm32f4_sim::time::{SimDuration, UNITS_PER_SECOND};

/// The sensor's model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum SensorModel {
    /// The published rig's.
    #[default]
    #[value(name = "mpu-9150")]
    Mpu9150,
    /// As the MPU-9150, but for its thermometer.
    #[value(name = "mpu-6050")]
    Mpu6050,
    /// Without a clock input.
    #[value(name = "mpu-6500")]
    Mpu6500,
    /// Without a clock input.
    #[value(name = "mpu-9250")]
    Mpu9250,
    /// With a clock input of 31 to 50 kHz.
    #[value(name = "icm-42688-p")]
    Icm42688P,
}

impl SensorModel {
    /// Name by its maker.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Mpu9150 => "MPU-9150",
            Self::Mpu6050 => "MPU-6050",
            Self::Mpu6500 => "MPU-6500",
            Self::Mpu9250 => "MPU-9250",
            Self::Icm42688P => "ICM-42688-P",
        }
    }

    /// Its registers, as after power-on.
    pub(super) fn map(self) -> Box<dyn RegisterMap> {
        match self {
            Self::Icm42688P => Box::new(IcmRegisters::new()),
            model => Box::new(MpuRegisters::new(model)),
        }
    }
}

/// A sensor's imperfections and times.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimImuConfig {
    /// The sensor's model.
    pub model: SensorModel,
    /// Gyroscope, in rad/s.
    pub gyro: ChannelConfig,
    /// Accelerometer, in m/s².
    pub accel: ChannelConfig,
    /// Die temperature when the sensor was off for long, in °C.
    pub temperature_c: f64,
    /// By how much it is warmer after running for long, in °C (with a time
    /// constant of [`SimImuConfig::warm_up_s`]).
    pub self_heating_c: f64,
    /// Time constant of warming up, in seconds.
    pub warm_up_s: f64,
    /// Change of the gyroscope's bias with the die's temperature, rad/s per °C.
    pub gyro_drift: [f64; 3],
    /// Errors of data-ready against a clock on CLKIN, of which it should be an exact
    /// division.
    pub data_ready: DataReady,
    /// Noise of the thermometer, standard deviation of a sample in °C.
    pub temperature_noise_c: f64,
    /// The sensor's own oscillator, as its PLL on a gyroscope makes it (within ±1 % by
    /// the product specifications of the MPUs, ±1.5 % of the ICM-42688-P).
    pub own_clock: OscillatorConfig,
    /// Rate error of its internal oscillator (CLKSEL 0), in ppm; within
    /// ±5 % by the product specification (MPU-6500 ±2 %, ICM-42688-P ±3 %).
    pub internal_ppm: f64,
    /// From power-on or device reset until registers answer: 11 ms typical,
    /// 100 ms at most.
    pub start_up: SimDuration,
}

/// Errors of the samples' times against the clock on CLKIN.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DataReady {
    /// Rate of the samples against that clock, parts per million.
    pub rate_ppm: f64,
    /// Amplitude of their slow wander, nanoseconds.
    pub wander_ns: f64,
}

impl DataReady {
    /// Time in which the wander goes to and fro, seconds.
    const WANDER_S: f64 = 7.0;

    /// Delay against the exact division of a sample that comes after `since_s`
    /// seconds, in units of [`SimTime`](stm32f4_sim::time::SimTime).
    pub(super) fn late(self, since_s: f64) -> i64 {
        let turn = 2.0 * core::f64::consts::PI * since_s / Self::WANDER_S;
        let late_s = self.wander_ns * 1e-9 * turn.sin() - self.rate_ppm * 1e-6 * since_s;
        (late_s * UNITS_PER_SECOND as f64) as i64
    }
}

/// Degrees a second in one rad/s.
pub(super) const DEGREES: f64 = 180.0 / core::f64::consts::PI;

impl SimImuConfig {
    /// A perfect sensor along the rig's axes, with the times of a real one.
    #[must_use]
    pub fn ideal() -> Self {
        Self {
            model: SensorModel::default(),
            gyro: ChannelConfig::ideal(),
            accel: ChannelConfig::ideal(),
            temperature_c: 35.0,
            self_heating_c: 0.0,
            warm_up_s: 60.0,
            gyro_drift: [0.0; 3],
            data_ready: DataReady::default(),
            temperature_noise_c: 0.0,
            own_clock: OscillatorConfig::default(),
            internal_ppm: 0.0,
            start_up: SimDuration::from_millis(11),
        }
    }

    /// A sensor as the product specification describes a typical one
    /// (gyroscope 0.005 °/s/√Hz, accelerometer 400 µg/√Hz), with scale errors,
    /// biases and clock errors within its tolerances drawn from the seed. It is
    /// mounted along the rig's axes up to half a degree.
    #[must_use]
    pub fn typical(seed: Seed) -> Self {
        let mut random = seed.stream(Stream::ImuConfig);
        let mut spread = |size: f64| [0; 3].map(|_| random.uniform(-size, size));
        let gyro = ChannelConfig {
            rotation: Rotation3::new(spread(0.5 / DEGREES).into()),
            scale_error: spread(0.01),
            bias: spread(2.0 / DEGREES),
            bias_walk: 2e-5,
            noise_density: 0.005 / DEGREES,
        };
        let accel = ChannelConfig {
            rotation: gyro.rotation,
            scale_error: spread(0.01),
            bias: spread(0.05 * STANDARD_GRAVITY),
            bias_walk: 1e-4,
            noise_density: 400e-6 * STANDARD_GRAVITY,
        };
        Self {
            gyro,
            accel,
            temperature_c: 26.0,
            self_heating_c: 4.0,
            temperature_noise_c: 0.05,
            own_clock: OscillatorConfig {
                offset_ns: 0,
                rate_ppm: random.uniform(-8000.0, 8000.0),
                wander: 3e-7,
                ..OscillatorConfig::default()
            },
            internal_ppm: random.uniform(-40_000.0, 40_000.0),
            ..Self::ideal()
        }
    }

    /// The same as another sensor is by its data sheet: noise, biases and clocks. What was
    /// drawn stays drawn, in proportion.
    #[must_use]
    pub fn with_model(mut self, model: SensorModel) -> Self {
        // Against the MPU-9150: noise of gyroscope and accelerometer, biases of both, own
        // clocks. MPU-9250 product specification, 3.1 and 3.2: 0.01 °/s/√Hz, 300 µg/√Hz,
        // ±5 °/s for ±20, ±60 mg for ±150 (z); internal oscillator ±2 % for ±5 % and the
        // MPU-6500's: guesses.
        // ICM-42688-P data sheet, 3.1 to 3.3: 0.0028 °/s/√Hz, 70 µg/√Hz, ±0.5 °/s,
        // ±20 mg, ±1.5 % and ±3 %.
        let [noise, accel_noise, bias, accel_bias, pll, internal] = match model {
            SensorModel::Mpu9150 | SensorModel::Mpu6050 => [1.0; 6],
            SensorModel::Mpu6500 | SensorModel::Mpu9250 => [2.0, 0.75, 0.25, 0.4, 1.0, 0.4],
            SensorModel::Icm42688P => [0.56, 0.175, 0.025, 0.13, 1.5, 0.6],
        };
        self.model = model;
        self.gyro.noise_density *= noise;
        self.accel.noise_density *= accel_noise;
        self.gyro.bias = self.gyro.bias.map(|axis| axis * bias);
        self.accel.bias = self.accel.bias.map(|axis| axis * accel_bias);
        self.own_clock.rate_ppm *= pll;
        self.internal_ppm *= internal;
        if model == SensorModel::Icm42688P {
            // From power-on or reset, at most (3.3.2, 14.1).
            self.start_up = SimDuration::from_millis(1);
        }
        self
    }
}
