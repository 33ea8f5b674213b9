//! The IMU on the board's I2C bus: registers, interrupt pin, clock, faults.
//!
//! [`SimImu`] is one state machine with two sides: an [`I2cTarget`](stm32f4_sim::i2c::I2cTarget)
//! at address 0x68 and a [`PinModel`] that drives the data-ready pin (PA1) and listens to
//! the reference clocks (PA8, PB0). It is shared by both through
//! [`stm32f4_sim::shared::Shared`]. Which sensor it is, is its register map's business
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
//! `PLL_SETTLING` to lock, and a sample clock begins with
//! its first whole period after that; in which phase a real sensor begins is not
//! documented. A changed divider takes effect after the sample under way.

mod bus;
mod config;
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

use crate::clocks::oscillator::BoardTime;
use crate::motion::Motion;
use crate::random::Seed;
use crate::wiring;
use stm32f4_sim::clock::Rate;
use stm32f4_sim::model::{PinIo, PinModel};
use stm32f4_sim::pin::{Drive, Level, Pin};
use stm32f4_sim::shared::Shared;
use stm32f4_sim::time::SimTime;

pub use config::{DataReady, SensorModel, SimImuConfig};
pub use faults::Fault;
pub use log::{SampleRecord, Values};
use map::RegisterMap;
use sampling::Sampling;

/// Address on the I2C bus with AD0 low.
pub(crate) const ADDRESS: u8 = 0x68;

/// Address of the identity in all maps.
const IDENTITY: u8 = 0x75;

/// State of a transaction on the bus.
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

/// State of the interrupt pin as the sensor drives it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Interrupt {
    /// Data-ready is asserted.
    asserted: bool,
    /// End of the pulse, unless it is latched.
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
    /// Time from which registers answer.
    answers_from: SimTime,
    sampling: Sampling,
    interrupt: Interrupt,
    /// Present drive of the pin; `None` before power-on.
    driven: Option<Drive>,
    /// Time at which the pin must be updated after a bus event.
    pin_due: Option<SimTime>,
    transaction: Transaction,
    pointer: u8,
    /// Acknowledged bytes of the transaction so far.
    byte: u32,
    faults: faults::Schedule,
    nack: Option<(u32, u32)>,
    /// Number of writes that select an external clock and are still to be lost.
    lost_at_clock: u32,
    /// Content of WHO_AM_I under a fault.
    identity: Option<u8>,
    sda_held: bool,
    sda_pulses_left: Option<u32>,
    clock_cut: bool,
    data_ready_cut: bool,
    /// Clock on the CLKIN pin's wire.
    clock_in: Option<Rate>,
    log: Vec<SampleRecord>,
    /// Registers that were given a value whose effect is not modelled.
    pub unmodelled: BTreeSet<u8>,
}

impl SimImu {
    /// Creates a sensor on a rig that moves by `motion`, powered from time zero.
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
            log: Vec::new(),
            unmodelled: BTreeSet::new(),
        };
        // Some sensors are awake after power-on.
        sensor.clock_changed(sensor.answers_from);
        sensor
    }

    /// Creates the same sensor, shared between the bus and the board's loop.
    #[must_use]
    pub fn shared(self) -> Shared<Self> {
        Arc::new(std::sync::Mutex::new(self))
    }

    /// Schedules `fault` at `at`, or at the next event if that has passed.
    pub fn schedule(&mut self, at: SimTime, fault: Fault) {
        self.faults.add(at, fault);
    }

    /// Returns the samples that were written into the registers.
    #[must_use]
    pub fn log(&self) -> &[SampleRecord] {
        &self.log
    }

    /// Removes and returns these samples.
    pub fn take_log(&mut self) -> Vec<SampleRecord> {
        std::mem::take(&mut self.log)
    }

    /// Returns the configuration.
    #[must_use]
    pub fn config(&self) -> &SimImuConfig {
        &self.config
    }

    /// Returns a register as a master would read it now, without the side effects of a read.
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
                // An unpowered sensor keeps no state.
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

    /// Updates the sample clock after a change of something that decides it.
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

    /// Returns the present drive of the interrupt pin.
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
        // 0.7 · VLOGIC and more (product specification, 6.4), of a breakout at 3.3 V.
        let high = 0.7 * 3.3;
        self.watched_pins()
            .into_iter()
            .map(|pin| (pin, high))
            .collect()
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
