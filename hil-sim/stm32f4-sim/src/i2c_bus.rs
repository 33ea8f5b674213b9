//! The wires of the I2C bus, its targets, and a fault that a test puts on it.

use crate::i2c::{Ack, Direction, I2cTarget};
use crate::time::SimTime;

/// Targets of one bus.
#[derive(Default)]
pub(crate) struct I2cBus {
    targets: Vec<Box<dyn I2cTarget>>,
    /// The target that acknowledged its address.
    selected: Option<usize>,
    sda_held: bool,
}

impl core::fmt::Debug for I2cBus {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(
            f,
            "I2cBus({} targets, stuck: {})",
            self.targets.len(),
            self.is_stuck()
        )
    }
}

impl I2cBus {
    /// Adds a target.
    pub(crate) fn add(&mut self, target: Box<dyn I2cTarget>) {
        self.targets.push(target);
    }

    /// Holds SDA low from outside, or lets it go. Clock pulses do not free it.
    pub(crate) fn hold_sda(&mut self, held: bool) {
        self.sda_held = held;
    }

    /// True if somebody holds SDA low outside of a transfer.
    pub(crate) fn is_stuck(&self) -> bool {
        self.sda_held || self.targets.iter().any(|t| t.holds_sda_low())
    }

    fn selected(&mut self) -> Option<&mut Box<dyn I2cTarget>> {
        self.targets.get_mut(self.selected?)
    }

    pub(crate) fn start(&mut self, address: u8, direction: Direction, at: SimTime) -> Ack {
        self.selected = None;
        for (n, target) in self.targets.iter_mut().enumerate() {
            if target.start(address, direction, at) == Ack::Ack && self.selected.is_none() {
                self.selected = Some(n);
            }
        }
        match self.selected {
            Some(_) => Ack::Ack,
            None => Ack::Nack,
        }
    }

    pub(crate) fn write(&mut self, byte: u8, at: SimTime) -> Ack {
        match self.selected() {
            Some(target) => target.write(byte, at),
            None => Ack::Nack,
        }
    }

    pub(crate) fn read(&mut self, at: SimTime) -> u8 {
        match self.selected() {
            Some(target) => target.read(at),
            // Nobody pulls the line down.
            None => 0xff,
        }
    }

    pub(crate) fn read_acknowledged(&mut self, ack: Ack, at: SimTime) {
        if let Some(target) = self.selected() {
            target.read_acknowledged(ack, at);
        }
    }

    pub(crate) fn stop(&mut self, at: SimTime) {
        self.selected = None;
        for target in &mut self.targets {
            target.stop(at);
        }
    }

    /// A clock pulse made by software on the pins.
    pub(crate) fn pulse(&mut self, at: SimTime) {
        for target in &mut self.targets {
            target.bus_clear_pulse(at);
        }
    }
}
