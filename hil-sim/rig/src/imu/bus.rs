//! The sensor's side of the I2C bus (product specification, section 9).

use super::{ADDRESS, SimImu, Transaction};
use stm32f4_sim::i2c::{Ack, Direction, I2cTarget};
use stm32f4_sim::time::SimTime;

impl SimImu {
    /// Acknowledges a byte, unless a fault says otherwise.
    fn acknowledge(&mut self) -> Ack {
        let byte = self.byte;
        self.byte += 1;
        if let Some((at, times)) = self.nack
            && at == byte
        {
            self.nack = (times > 1).then_some((at, times - 1));
            self.transaction = Transaction::Idle;
            return Ack::Nack;
        }
        Ack::Ack
    }

    /// True if the write of an external clock is lost.
    fn loses_clock(&mut self, value: u8) -> bool {
        let lost = self.lost_at_clock > 0 && self.map.selects_clock(self.pointer, value);
        if lost {
            self.lost_at_clock -= 1;
            self.transaction = Transaction::Idle;
        }
        lost
    }

    /// Next address of the register after an access.
    fn step_pointer(&mut self) {
        self.pointer = self.map.after(self.pointer);
    }

    /// A byte from the master for the register that the pointer stands on.
    fn store(&mut self, value: u8, at: SimTime) {
        let stored = self.map.store(self.pointer, value);
        if stored.reset {
            self.reset(at);
            return;
        }
        if stored.clear {
            self.sampling.clear();
            self.internal = self.map.no_data();
        }
        if stored.ignored {
            self.unmodelled.insert(self.pointer);
        }
        self.clock_changed(at);
        if !self.map.interrupt().data_ready {
            self.interrupt = super::Interrupt::default();
        }
        self.pin_due = Some(at);
    }

    /// The bus is idle again: the registers that a master sees are refreshed.
    fn end_transaction(&mut self) {
        if self.transaction != Transaction::Idle {
            self.transaction = Transaction::Idle;
        }
        self.shown = self.internal;
    }
}

impl I2cTarget for SimImu {
    fn start(&mut self, address: u8, direction: Direction, at: SimTime) -> Ack {
        let repeated = self.transaction != Transaction::Idle;
        if !repeated {
            self.byte = 0;
        }
        if address != ADDRESS || !self.powered || self.sda_held || at < self.answers_from {
            self.transaction = Transaction::Idle;
            return Ack::Nack;
        }
        self.transaction = match direction {
            Direction::Write => Transaction::Address,
            Direction::Read => Transaction::Reading,
        };
        self.acknowledge()
    }

    fn write(&mut self, byte: u8, at: SimTime) -> Ack {
        if !self.powered || self.sda_held {
            self.transaction = Transaction::Idle;
        }
        match self.transaction {
            Transaction::Idle | Transaction::Reading => Ack::Nack,
            Transaction::Address => {
                let ack = self.acknowledge();
                if ack == Ack::Ack {
                    self.pointer = byte & 0x7f;
                    self.transaction = Transaction::Writing;
                }
                ack
            }
            Transaction::Writing => {
                let ack = if self.loses_clock(byte) {
                    Ack::Nack
                } else {
                    self.acknowledge()
                };
                if ack == Ack::Ack {
                    self.store(byte, at);
                    self.step_pointer();
                }
                ack
            }
        }
    }

    fn read(&mut self, at: SimTime) -> u8 {
        if self.transaction != Transaction::Reading || !self.powered {
            // Nobody pulls SDA low.
            return 0xff;
        }
        if self.sda_held {
            return 0x00;
        }
        let register = self.pointer;
        let value = self.peek(register);
        if self.map.clears(register) {
            self.clear_interrupt(at);
        }
        self.step_pointer();
        value
    }

    fn stop(&mut self, _at: SimTime) {
        if self.powered {
            self.end_transaction();
        }
    }

    fn holds_sda_low(&self) -> bool {
        self.sda_held
    }

    fn bus_clear_pulse(&mut self, _at: SimTime) {
        if let Some(left) = &mut self.sda_pulses_left {
            *left = left.saturating_sub(1);
            if *left == 0 {
                self.sda_held = false;
                self.sda_pulses_left = None;
            }
        }
    }
}
