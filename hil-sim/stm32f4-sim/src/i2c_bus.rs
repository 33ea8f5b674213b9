//! The wires of the I2C bus, its targets and the faults that a test puts on it.

use crate::i2c::{Ack, Direction, I2cTarget};
use crate::time::SimTime;

/// Faults and targets of one bus.
pub struct I2cBus {
    targets: Vec<Box<dyn I2cTarget>>,
    /// The target that acknowledged its address.
    selected: Option<usize>,
    sda_held: bool,
    /// Clock pulses that free a held SDA; 0 for never.
    sda_pulses: u32,
    connected: bool,
    /// Acknowledge bits to let pass before one is withheld.
    nack_in: Option<u32>,
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

impl Default for I2cBus {
    fn default() -> Self {
        Self::new()
    }
}

impl I2cBus {
    /// A bus without targets.
    #[must_use]
    pub fn new() -> Self {
        Self {
            targets: Vec::new(),
            selected: None,
            sda_held: false,
            sda_pulses: 0,
            connected: true,
            nack_in: None,
        }
    }

    /// Adds a target.
    pub fn add(&mut self, target: Box<dyn I2cTarget>) {
        self.targets.push(target);
    }

    /// Holds SDA low from outside, or lets it go. Clock pulses do not free it.
    pub fn hold_sda(&mut self, held: bool) {
        self.sda_held = held;
        self.sda_pulses = 0;
    }

    /// Holds SDA low like a target that lost count: `pulses` clock pulses free it.
    pub fn hold_sda_for_pulses(&mut self, pulses: u32) {
        self.sda_held = pulses > 0;
        self.sda_pulses = pulses;
    }

    /// Cuts the wires to all targets (they keep their state), or joins them again.
    pub fn set_connected(&mut self, connected: bool) {
        self.connected = connected;
        if !connected {
            self.selected = None;
        }
    }

    /// Withholds one acknowledge: the one after `after` more acknowledge bits
    /// of targets (address bytes count).
    pub fn withhold_ack(&mut self, after: u32) {
        self.nack_in = Some(after);
    }

    /// Whether a withheld acknowledge is still to come.
    #[must_use]
    pub fn ack_is_due(&self) -> bool {
        self.nack_in.is_some()
    }

    /// Whether somebody holds SDA low outside of a transfer.
    #[must_use]
    pub fn is_stuck(&self) -> bool {
        self.sda_held || (self.connected && self.targets.iter().any(|t| t.holds_sda_low()))
    }

    fn filter_ack(&mut self, ack: Ack) -> Ack {
        if ack == Ack::Ack
            && let Some(left) = self.nack_in
        {
            if left == 0 {
                self.nack_in = None;
                return Ack::Nack;
            }
            self.nack_in = Some(left - 1);
        }
        ack
    }

    pub(crate) fn start(&mut self, address: u8, direction: Direction, at: SimTime) -> Ack {
        self.selected = None;
        if !self.connected {
            return Ack::Nack;
        }
        for (n, target) in self.targets.iter_mut().enumerate() {
            if target.start(address, direction, at) == Ack::Ack && self.selected.is_none() {
                self.selected = Some(n);
            }
        }
        let ack = if self.selected.is_some() {
            Ack::Ack
        } else {
            Ack::Nack
        };
        self.filter_ack(ack)
    }

    pub(crate) fn write(&mut self, byte: u8, at: SimTime) -> Ack {
        let ack = match self.selected.and_then(|n| self.targets.get_mut(n)) {
            Some(target) => target.write(byte, at),
            None => Ack::Nack,
        };
        self.filter_ack(ack)
    }

    pub(crate) fn read(&mut self, at: SimTime) -> u8 {
        match self.selected.and_then(|n| self.targets.get_mut(n)) {
            Some(target) => target.read(at),
            // Nobody pulls the line down.
            None => 0xff,
        }
    }

    pub(crate) fn read_acknowledged(&mut self, ack: Ack, at: SimTime) {
        if let Some(target) = self.selected.and_then(|n| self.targets.get_mut(n)) {
            target.read_acknowledged(ack, at);
        }
    }

    pub(crate) fn stop(&mut self, at: SimTime) {
        self.selected = None;
        if self.connected {
            for target in &mut self.targets {
                target.stop(at);
            }
        }
    }

    /// A clock pulse made by software on the pins.
    pub(crate) fn pulse(&mut self, at: SimTime) {
        if self.sda_pulses > 0 {
            self.sda_pulses -= 1;
            if self.sda_pulses == 0 {
                self.sda_held = false;
            }
        }
        if self.connected {
            for target in &mut self.targets {
                target.bus_clear_pulse(at);
            }
        }
    }
}
