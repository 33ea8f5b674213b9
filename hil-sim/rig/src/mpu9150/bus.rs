//! The sensor's side of the I2C bus (product specification, section 9).

use super::registers::{self, ClockSource, DATA_RDY, address, int_pin, power};
use super::{ADDRESS, Mpu9150, Transaction};
use stm32f4_sim::i2c::{Ack, Direction, I2cTarget};
use stm32f4_sim::time::SimTime;

impl Mpu9150 {
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

    /// Whether the write of an external clock is lost.
    fn loses_clock(&mut self, value: u8) -> bool {
        let external = matches!(
            registers::clock_source(value),
            ClockSource::External32k | ClockSource::External19M2
        );
        let lost = self.pointer == address::PWR_MGMT_1 && external && self.lost_at_clock > 0;
        if lost {
            self.lost_at_clock -= 1;
            self.transaction = Transaction::Idle;
        }
        lost
    }

    /// Where the register's address goes after an access.
    fn step_pointer(&mut self) {
        if self.pointer != address::FIFO_R_W {
            self.pointer = (self.pointer + 1) & 0x7f;
        }
    }

    /// A byte from the master for the register that the pointer stands on.
    fn store(&mut self, value: u8, at: SimTime) {
        let register = self.pointer;
        if !registers::writable(register) {
            return;
        }
        match register {
            address::PWR_MGMT_1 if value & power::DEVICE_RESET != 0 => {
                self.reset(at);
                return;
            }
            address::SIGNAL_PATH_RESET => {
                // Resets filters of which the model has no state; reads as zero.
                return;
            }
            address::USER_CTRL => {
                if value & registers::SIG_COND_RESET != 0 {
                    self.sampling.clear();
                    self.internal = [0; 14];
                }
                // Reset bits clear themselves.
                self.registers[usize::from(register)] = value & 0xf0;
            }
            _ => self.registers[usize::from(register)] = value,
        }
        let ignored = match register {
            address::SMPLRT_DIV | address::PWR_MGMT_2 => 0,
            // EXT_SYNC_SET.
            address::CONFIG => value & 0x38,
            // Self-test.
            address::GYRO_CONFIG | address::ACCEL_CONFIG => value & 0xe7,
            // FSYNC and bypass.
            address::INT_PIN_CFG => value & 0x0f,
            address::INT_ENABLE => value & !DATA_RDY,
            address::PWR_MGMT_1 => value & power::CYCLE,
            _ => value,
        };
        if ignored != 0 {
            self.unmodelled.insert(register);
        }
        match register {
            address::PWR_MGMT_1 | address::CONFIG => self.clock_changed(at),
            address::INT_PIN_CFG => self.pin_due = Some(at),
            address::INT_ENABLE if value & DATA_RDY == 0 => {
                self.interrupt = super::Interrupt::default();
                self.pin_due = Some(at);
            }
            _ => {}
        }
    }

    /// The bus is idle again: the registers that a master sees are refreshed.
    fn end_transaction(&mut self) {
        if self.transaction != Transaction::Idle {
            self.transaction = Transaction::Idle;
        }
        self.shown = self.internal;
    }
}

impl I2cTarget for Mpu9150 {
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
        let any_read_clears = self.register(address::INT_PIN_CFG) & int_pin::INT_RD_CLEAR != 0;
        if any_read_clears || register == address::INT_STATUS {
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
