//! The MPU-9150 on the board's I2C bus: registers, interrupt pin, clock, faults.
//!
//! [`Mpu9150`] is one state machine with two sides: an [`I2cTarget`](stm32f4_sim::i2c::I2cTarget)
//! at address 0x68 and a [`PinModel`] that drives the data-ready pin (PA1) and listens to
//! the reference clock (PA8). It is shared by both through
//! [`stm32f4_sim::i2c::Shared`].
//!
//! # What is modelled
//!
//! - All registers with their reset values; single and burst access with the
//!   address moving on; read-only registers stay as they are.
//! - Sleep, device reset, and the time after power-on in which nothing answers.
//! - Clock selection. With CLKSEL = 5 the sample clock is the frequency on PA8
//!   divided by 19,200 (2,400 with the low-pass off), exactly: at 19.2 MHz a
//!   sample every 96,000 ticks of the board's timer. The PLL locks only near
//!   19.2 MHz. Without a clock there are no samples, and no data-ready. With
//!   CLKSEL = 0 to 3 the sensor's own oscillator runs in true time, with its own
//!   rate error and wander.
//! - SMPLRT_DIV, DLPF_CFG (bandwidth, delay, internal rate), full scales,
//!   standby of axes, temperature.
//! - Data-ready: the pulse of 50 µs or the latched level, either polarity, push
//!   pull or open drain, cleared by INT_STATUS or by any read.
//! - Burst consistency: the registers that a master sees are refreshed only
//!   while the bus is idle (registers 59 to 64); a sample that falls into a
//!   transaction shows after its stop condition.
//!
//! # What is not
//!
//! FIFO, auxiliary bus and magnetometer, self-test, motion detection, CYCLE,
//! FSYNC. Their registers can be written and read; [`Mpu9150::unmodelled`]
//! tells which were given a value that the model ignores. The PLL takes
//! [`Mpu9150Config::pll_settling`] to lock, and a sample clock begins with
//! its first whole period after that; in which phase a real sensor begins is not
//! documented. A changed divider takes effect after the sample under way.

mod bus;
mod faults;
mod log;
pub mod registers;
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
use stm32f4_sim::pin::{Drive, Pin};
use stm32f4_sim::time::{SimDuration, SimTime, UNITS_PER_SECOND};

pub use faults::Fault;
pub use log::{SampleLog, SampleRecord, Values};
use registers::{DATA_RDY, address, int_pin, power};
use sampling::Sampling;

/// Address on the I2C bus with AD0 low.
pub(crate) const ADDRESS: u8 = 0x68;

/// Length of the data-ready pulse if it is not latched (register 55).
pub const PULSE: SimDuration = SimDuration::from_micros(50);

/// A sensor's imperfections and times.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mpu9150Config {
    /// Gyroscope, in rad/s.
    pub gyro: ChannelConfig,
    /// Accelerometer, in m/s².
    pub accel: ChannelConfig,
    /// Die temperature when the sensor was off for long, in °C.
    pub temperature_c: f64,
    /// By how much it is warmer after running for long, in °C (with a time
    /// constant of [`Mpu9150Config::warm_up_s`]).
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
    /// The sensor's own oscillator, as its PLL on a gyroscope makes it (CLKSEL 1
    /// to 3; within ±1 % by the product specification).
    pub own_clock: OscillatorConfig,
    /// Rate error of its internal 8 MHz oscillator (CLKSEL 0), in ppm; within
    /// ±5 % by the product specification.
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

impl Mpu9150Config {
    /// A perfect sensor along the rig's axes, with the times of a real one.
    #[must_use]
    pub fn ideal() -> Self {
        Self {
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
pub struct Mpu9150 {
    config: Mpu9150Config,
    /// Registers but for the 14 bytes of data.
    registers: [u8; registers::REGISTERS],
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
    identity: u8,
    sda_held: bool,
    sda_pulses_left: Option<u32>,
    clock_cut: bool,
    data_ready_cut: bool,
    /// Clock on the CLKIN pin's wire.
    clock_in: Option<Rate>,
    log: SampleLog,
    unmodelled: BTreeSet<u8>,
}

impl Mpu9150 {
    /// A sensor on a rig that moves by `motion`, powered from time zero.
    #[must_use]
    pub fn new(config: Mpu9150Config, motion: Arc<Motion>, board: BoardTime, seed: Seed) -> Self {
        Self {
            sampling: Sampling::new(&config, motion, board, seed),
            config,
            registers: registers::reset_values(),
            shown: [0; 14],
            internal: [0; 14],
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
            identity: 0x68,
            sda_held: false,
            sda_pulses_left: None,
            clock_cut: false,
            data_ready_cut: false,
            clock_in: None,
            log: SampleLog::default(),
            unmodelled: BTreeSet::new(),
        }
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
    pub fn config(&self) -> &Mpu9150Config {
        &self.config
    }

    /// A register as a master would read it now, without the read's effects.
    #[must_use]
    pub fn peek(&self, register: u8) -> u8 {
        let register = register & 0x7f;
        match register {
            address::ACCEL_XOUT_H..=address::GYRO_ZOUT_L => {
                self.shown[usize::from(register - address::ACCEL_XOUT_H)]
            }
            address::WHO_AM_I => self.identity,
            _ => self.registers[usize::from(register)],
        }
    }

    fn register(&self, register: u8) -> u8 {
        self.registers[usize::from(register)]
    }

    /// Power-on reset or device reset.
    fn reset(&mut self, at: SimTime) {
        self.registers = registers::reset_values();
        self.shown = [0; 14];
        self.internal = [0; 14];
        self.answers_from = at + self.config.start_up;
        self.transaction = Transaction::Idle;
        self.interrupt = Interrupt::default();
        self.sampling.stop();
        self.pin_due = Some(at);
    }

    fn power_off(&mut self, at: SimTime) {
        self.reset(at);
        self.powered = false;
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
            Fault::Identity(id) => self.identity = id,
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
        let awake = self.powered && self.register(address::PWR_MGMT_1) & power::SLEEP == 0;
        let clock_in = if self.clock_cut { None } else { self.clock_in };
        let (pwr, config) = (
            self.register(address::PWR_MGMT_1),
            self.register(address::CONFIG),
        );
        self.sampling.configure(at, awake, pwr, config, clock_in);
    }

    /// Clears data-ready, as a read does.
    fn clear_interrupt(&mut self, at: SimTime) {
        self.registers[usize::from(address::INT_STATUS)] = 0;
        if self.interrupt.asserted && self.interrupt.until.is_none() {
            self.interrupt.asserted = false;
            self.pin_due = Some(at);
        }
    }

    /// Takes the sample that is due.
    fn take_sample(&mut self, at: SimTime) {
        let values = self.sampling.take(at, &self.registers);
        self.internal = values.bytes();
        if self.transaction == Transaction::Idle {
            self.shown = self.internal;
        }
        self.registers[usize::from(address::INT_STATUS)] |= DATA_RDY;
        let enabled = self.register(address::INT_ENABLE) & DATA_RDY != 0;
        let edge = enabled && !self.interrupt.asserted;
        if enabled {
            let latched = self.register(address::INT_PIN_CFG) & int_pin::LATCH_INT_EN != 0;
            self.interrupt = Interrupt {
                asserted: true,
                until: (!latched).then(|| at + PULSE),
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
        let config = self.register(address::INT_PIN_CFG);
        let high = self.interrupt.asserted == (config & int_pin::INT_LEVEL == 0);
        match (high, config & int_pin::INT_OPEN != 0) {
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

impl PinModel for Mpu9150 {
    fn name(&self) -> String {
        "MPU-9150".to_owned()
    }

    fn watched_pins(&self) -> Vec<Pin> {
        vec![wiring::IMU_CLOCK]
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
