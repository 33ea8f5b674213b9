//! The IMU on the board's I2C bus: registers, interrupt pin, clock, faults.
//!
//! [`SimImu`] is one state machine with two sides: an [`I2cTarget`](stm32f4_sim::i2c::I2cTarget)
//! at address 0x68 and a [`PinModel`] that drives the data-ready pin (PA1) and listens to
//! the reference clocks (PA8, PB0). It is shared by both through
//! [`stm32f4_sim::i2c::Shared`]. Which sensor it is, is its register map's business
//! ([`mpu`] for four of them, `icm42688p`).
//!
//! # What is modelled
//!
//! - All registers that the firmware needs with their reset values; single and burst access
//!   with the address moving on; read-only registers stay as they are.
//! - Sleep, device reset, and the time after power-on in which nothing answers.
//! - Clock selection. With CLKSEL = 5 the sample clock of an MPU-6050 or MPU-9150 is the
//!   frequency on PA8 divided by 19,200 (2,400 with the low-pass off), exactly: at 19.2 MHz a
//!   sample every 96,000 ticks of the board's timer. The PLL locks only near
//!   19.2 MHz. With RTC_MODE an ICM-42688-P counts the edges on PB0, 64 a sample at 500 Hz.
//!   Without a clock there are no samples, and no data-ready. On its own oscillator a sensor
//!   runs in true time, with its own rate error and wander.
//! - Rates, low-passes (bandwidth, delay, internal rate), full scales,
//!   standby of axes, temperature.
//! - Data-ready: the pulse or the latched level, either polarity, push
//!   pull or open drain, cleared by the status register or by any read.
//! - Burst consistency: the registers that a master sees are refreshed only
//!   while the bus is idle (registers 59 to 64 of the MPUs); a sample that falls into a
//!   transaction shows after its stop condition.
//!
//! # What is not
//!
//! FIFO, auxiliary bus and magnetometer, self-test, motion detection, CYCLE,
//! FSYNC, notch and anti-alias filter. Their registers can be written and read;
//! [`SimImu::unmodelled`]
//! tells which were given a value that the model ignores. The PLL takes
//! [`SimImuConfig::pll_settling`] to lock, and a sample clock begins with
//! its first whole period after that; in which phase a real sensor begins is not
//! documented. A changed divider takes effect after the sample under way.

mod bus;
mod faults;
mod icm42688p;
mod log;
mod map;
pub mod mpu;
mod sampling;
#[cfg(test)]
mod tests;

use std::collections::BTreeSet;
use std::sync::Arc;

use nalgebra::Rotation3;
use serde::{Deserialize, Serialize};

use crate::inertial_channel::ChannelConfig;
use crate::motion::{Motion, STANDARD_GRAVITY};
use crate::oscillator::{BoardTime, OscillatorConfig};
use crate::random::{Seed, Stream};
use crate::wiring;
use stm32f4_sim::clock::Rate;
use stm32f4_sim::i2c::Shared;
use stm32f4_sim::model::{PinIo, PinModel};
use stm32f4_sim::pin::{Drive, Level, Pin};
use stm32f4_sim::time::{SimDuration, SimTime, UNITS_PER_SECOND};

pub use faults::Fault;
use icm42688p::IcmRegisters;
pub use log::{SampleLog, SampleRecord, Values};
use map::RegisterMap;
use mpu::MpuRegisters;
use sampling::Sampling;

/// Address on the I2C bus with AD0 low.
pub(crate) const ADDRESS: u8 = 0x68;

/// Address of the identity in all maps.
const IDENTITY: u8 = 0x75;

/// Which sensor it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
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
    /// All of them.
    pub const ALL: [Self; 5] = [
        Self::Mpu9150,
        Self::Mpu6050,
        Self::Mpu6500,
        Self::Mpu9250,
        Self::Icm42688P,
    ];

    /// What its maker calls it.
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

    fn map(self) -> Box<dyn RegisterMap> {
        match self {
            Self::Icm42688P => Box::new(IcmRegisters::new()),
            model => Box::new(MpuRegisters::new(model)),
        }
    }
}

/// A sensor's imperfections and times.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SimImuConfig {
    /// Which sensor it is.
    #[serde(default)]
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
    #[serde(default)]
    pub gyro_drift: [f64; 3],
    /// How data-ready goes wrong against a clock on CLKIN, of which it should be an exact
    /// division.
    #[serde(default)]
    pub data_ready: DataReady,
    /// Noise of the thermometer, standard deviation of a sample in °C.
    pub temperature_noise_c: f64,
    /// The sensor's own oscillator, as its PLL on a gyroscope makes it (within ±1 % by
    /// the product specifications of the MPUs, ±1.5 % of the ICM-42688-P).
    pub own_clock: OscillatorConfig,
    /// Rate error of its internal oscillator (CLKSEL 0), in ppm; within
    /// ±5 % by the product specification (MPU-6500 ±2 %, ICM-42688-P ±3 %).
    pub internal_ppm: f64,
    /// How far from 19.2 MHz the PLL still locks, in ppm. Not documented; a
    /// setting of the model.
    pub lock_range_ppm: u32,
    /// From power-on or device reset until registers answer: 11 ms typical,
    /// 100 ms at most.
    pub start_up: SimDuration,
    /// From a new clock until the PLL has settled: 1 ms typical, 10 ms at most.
    pub pll_settling: SimDuration,
    /// From the end of sleep until the gyroscope's first sample: 30 ms typical.
    pub wake_up: SimDuration,
}

/// How the samples' times go wrong against the clock on CLKIN.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DataReady {
    /// Rate of the samples against that clock, parts per million.
    pub rate_ppm: f64,
    /// They wander by up to so many nanoseconds, to and fro.
    pub wander_ns: f64,
}

impl DataReady {
    /// Time in which the wander goes to and fro, seconds.
    const WANDER_S: f64 = 7.0;

    /// How much later than the exact division a sample is that comes after `since_s`
    /// seconds, in units of [`SimTime`].
    fn late(self, since_s: f64) -> i64 {
        let turn = 2.0 * core::f64::consts::PI * since_s / Self::WANDER_S;
        let late_s = self.wander_ns * 1e-9 * turn.sin() - self.rate_ppm * 1e-6 * since_s;
        (late_s * UNITS_PER_SECOND as f64) as i64
    }
}

/// Degrees a second in one rad/s.
const DEGREES: f64 = 180.0 / core::f64::consts::PI;

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
            lock_range_ppm: 10_000,
            start_up: SimDuration::from_millis(11),
            pll_settling: SimDuration::from_millis(10),
            wake_up: SimDuration::from_millis(30),
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
    pub fn of(mut self, model: SensorModel) -> Self {
        // Against the MPU-9150: noise of gyroscope and accelerometer, biases of both, own
        // clocks. MPU-6500 and MPU-9250 product specifications, 3.1, 3.2 and 3.3:
        // 0.01 °/s/√Hz, 300 µg/√Hz, ±5 °/s for ±20, ±60 mg for ±150 (z), ±2 % for ±5 %.
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

/// Where a transaction on the bus stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Transaction {
    /// The bus is idle, or talks to somebody else.
    #[default]
    Idle,
    /// Addressed for writing; the first byte is the register's address.
    Address,
    /// Addressed for writing, and the register's address is known.
    Writing,
    /// Addressed for reading.
    Reading,
}

/// The interrupt pin's state, as the sensor wants it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Interrupt {
    /// Data-ready is asserted.
    asserted: bool,
    /// When the pulse ends, if it is not latched.
    until: Option<SimTime>,
}

/// The sensor.
#[derive(Debug)]
pub struct SimImu {
    config: SimImuConfig,
    /// Registers but for the 14 bytes of data.
    map: Box<dyn RegisterMap>,
    /// Data bytes as a master reads them.
    shown: [u8; 14],
    /// Data bytes of the newest sample.
    internal: [u8; 14],
    powered: bool,
    /// Registers answer from here on.
    answers_from: SimTime,
    sampling: Sampling,
    interrupt: Interrupt,
    /// What the pin is driven with at present; nothing before power-on.
    driven: Option<Drive>,
    /// The pin must be looked at, at this time (it changed by a bus event).
    pin_due: Option<SimTime>,
    transaction: Transaction,
    pointer: u8,
    /// Acknowledged bytes of the transaction so far.
    byte: u32,
    faults: faults::Schedule,
    nack: Option<(u32, u32)>,
    /// Writes that select an external clock and are still to be lost.
    lost_at_clock: u32,
    /// What WHO_AM_I reads as, if a fault says so.
    identity: Option<u8>,
    sda_held: bool,
    sda_pulses_left: Option<u32>,
    clock_cut: bool,
    data_ready_cut: bool,
    /// Clock on the CLKIN pin's wire.
    clock_in: Option<Rate>,
    log: SampleLog,
    unmodelled: BTreeSet<u8>,
}

impl SimImu {
    /// A sensor on a rig that moves by `motion`, powered from time zero.
    #[must_use]
    pub fn new(config: SimImuConfig, motion: Arc<Motion>, board: BoardTime, seed: Seed) -> Self {
        let map = config.model.map();
        let mut sensor = Self {
            sampling: Sampling::new(&config, map.measuring().path, motion, board, seed),
            config,
            shown: map.no_data(),
            internal: map.no_data(),
            map,
            powered: true,
            answers_from: SimTime::ZERO + config.start_up,
            interrupt: Interrupt::default(),
            driven: None,
            pin_due: None,
            transaction: Transaction::Idle,
            pointer: 0,
            byte: 0,
            faults: faults::Schedule::default(),
            nack: None,
            lost_at_clock: 0,
            identity: None,
            sda_held: false,
            sda_pulses_left: None,
            clock_cut: false,
            data_ready_cut: false,
            clock_in: None,
            log: SampleLog::default(),
            unmodelled: BTreeSet::new(),
        };
        // Some are awake from the beginning.
        sensor.clock_changed(sensor.answers_from);
        sensor
    }

    /// The same, to be given to the bus and to the board's loop.
    #[must_use]
    pub fn shared(self) -> Shared<Self> {
        Arc::new(std::sync::Mutex::new(self))
    }

    /// Lets `fault` happen at `at` (at the next event if that has passed).
    pub fn schedule(&mut self, at: SimTime, fault: Fault) {
        self.faults.add(at, fault);
    }

    /// What was put into the registers.
    #[must_use]
    pub fn log(&self) -> &SampleLog {
        &self.log
    }

    /// The same, to take records out or to limit them.
    pub fn log_mut(&mut self) -> &mut SampleLog {
        &mut self.log
    }

    /// Registers that were given a value whose effect is not modelled.
    #[must_use]
    pub fn unmodelled(&self) -> &BTreeSet<u8> {
        &self.unmodelled
    }

    /// What it was made from.
    #[must_use]
    pub fn config(&self) -> &SimImuConfig {
        &self.config
    }

    /// A register as a master would read it now, without the read's effects.
    #[must_use]
    pub fn peek(&self, register: u8) -> u8 {
        match (register & 0x7f, self.identity) {
            (IDENTITY, Some(identity)) => identity,
            (register, _) => self.map.peek(register, &self.shown),
        }
    }

    /// Power-on reset or device reset.
    fn reset(&mut self, at: SimTime) {
        self.map.reset();
        self.shown = self.map.no_data();
        self.internal = self.map.no_data();
        self.answers_from = at + self.config.start_up;
        self.transaction = Transaction::Idle;
        self.interrupt = Interrupt::default();
        self.sampling.stop();
        self.clock_changed(self.answers_from);
        self.pin_due = Some(at);
    }

    fn power_off(&mut self, at: SimTime) {
        self.powered = false;
        self.reset(at);
        self.sda_held = false;
    }

    fn fault(&mut self, fault: Fault, at: SimTime) {
        match fault {
            Fault::PowerOff => self.power_off(at),
            Fault::PowerOn => {
                if !self.powered {
                    self.powered = true;
                    self.reset(at);
                    self.sampling.cold_start(at);
                }
            }
            Fault::Identity(id) => self.identity = Some(id),
            Fault::Nack { byte, times } => self.nack = (times > 0).then_some((byte, times)),
            Fault::HoldSda(pulses) => {
                // An unpowered sensor holds nothing.
                self.sda_held = self.powered && pulses != Some(0);
                self.sda_pulses_left = pulses;
                self.transaction = Transaction::Idle;
            }
            Fault::ReleaseSda => self.sda_held = false,
            Fault::ClockCut(cut) => {
                self.clock_cut = cut;
                self.clock_changed(at);
            }
            Fault::LostAtExternalClock(times) => self.lost_at_clock = times,
            Fault::DataReadyCut(cut) => {
                self.data_ready_cut = cut;
                self.pin_due = Some(at);
            }
        }
    }

    /// Something that decides the sample clock changed.
    fn clock_changed(&mut self, at: SimTime) {
        let mut measuring = self.map.measuring();
        measuring.awake &= self.powered;
        let clock_in = if self.clock_cut { None } else { self.clock_in };
        self.sampling.configure(at, &measuring, clock_in);
    }

    /// Clears data-ready, as a read does.
    fn clear_interrupt(&mut self, at: SimTime) {
        self.map.set_ready(false);
        if self.interrupt.asserted && self.interrupt.until.is_none() {
            self.interrupt.asserted = false;
            self.pin_due = Some(at);
        }
    }

    /// Takes the sample that is due.
    fn take_sample(&mut self, at: SimTime) {
        let values = self.sampling.take(at, &self.map.measuring());
        self.internal = self.map.bytes(&values);
        if self.transaction == Transaction::Idle {
            self.shown = self.internal;
        }
        self.map.set_ready(true);
        let pin = self.map.interrupt();
        let edge = pin.data_ready && !self.interrupt.asserted;
        if pin.data_ready {
            self.interrupt = Interrupt {
                asserted: true,
                until: pin.pulse.map(|pulse| at + pulse),
            };
        }
        self.log.push(SampleRecord {
            number: self.sampling.count() - 1,
            at,
            edge,
            values,
        });
    }

    /// What the sensor does to its interrupt pin now.
    fn pin_drive(&self) -> Drive {
        if !self.powered || self.data_ready_cut {
            return Drive::Floating;
        }
        let pin = self.map.interrupt();
        let high = self.interrupt.asserted == pin.active_high;
        match (high, pin.open_drain) {
            (true, true) => Drive::Floating,
            (true, false) => Drive::High,
            (false, _) => Drive::Low,
        }
    }

    fn update_pin(&mut self, io: &mut PinIo<'_>) {
        self.pin_due = None;
        let drive = self.pin_drive();
        if self.driven != Some(drive) {
            self.driven = Some(drive);
            io.drive(wiring::IMU_READY, drive);
        }
    }
}

impl PinModel for SimImu {
    fn name(&self) -> String {
        self.config.model.name().to_owned()
    }

    fn watched_pins(&self) -> Vec<Pin> {
        match self.config.model {
            SensorModel::Icm42688P => vec![wiring::IMU_RTC],
            _ => vec![wiring::IMU_CLOCK],
        }
    }

    fn inputs(&self) -> Vec<(Pin, f64)> {
        // Inputs: 0.7 · VLOGIC and more (product specification, 6.4), of a breakout at 3.3 V.
        vec![(wiring::IMU_CLOCK, 0.7 * 3.3)]
    }

    fn power_on(&mut self, io: &mut PinIo<'_>) {
        self.update_pin(io);
    }

    fn on_clock(&mut self, pin: Pin, rate: Option<Rate>, io: &mut PinIo<'_>) {
        if pin == wiring::IMU_CLOCK {
            self.clock_in = rate;
            self.clock_changed(io.now());
        }
    }

    fn on_pin_edge(&mut self, pin: Pin, level: Level, io: &mut PinIo<'_>) {
        if pin == wiring::IMU_RTC && level.is_high() && !self.clock_cut {
            self.sampling.clock_edge(io.now());
        }
    }

    fn next_event(&self) -> Option<SimTime> {
        [
            self.pin_due,
            self.faults.next(),
            self.interrupt.until,
            self.sampling.next(),
        ]
        .into_iter()
        .flatten()
        .min()
    }

    fn advance(&mut self, io: &mut PinIo<'_>) {
        let now = io.now();
        while let Some(fault) = self.faults.pop_due(now) {
            self.fault(fault, now);
        }
        if self.interrupt.until.is_some_and(|t| t <= now) {
            self.interrupt = Interrupt::default();
        }
        while self.sampling.next().is_some_and(|t| t <= now) {
            self.take_sample(now);
        }
        self.update_pin(io);
    }
}
