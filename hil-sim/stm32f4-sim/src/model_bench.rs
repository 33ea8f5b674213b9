//! A board that is not there: runs one model alone, for its tests, and notes what it
//! drives.

use crate::clock::Rate;
use crate::i2c::{Ack, Direction, I2cTarget};
use crate::model::{PinIo, PinModel};
use crate::pin::{Drive, Level, Pin};
use crate::time::{SimDuration, SimTime};

/// One model on the bench.
#[derive(Debug)]
pub struct ModelBench<M> {
    /// The model.
    pub model: M,
    /// Time since power-on.
    pub now: SimTime,
    levels: [u16; Pin::PORTS],
    /// Drives so far, in order.
    pub driven: Vec<(SimTime, Pin, Drive)>,
}

impl<M: PinModel> ModelBench<M> {
    /// Powers the model on, with all pins low.
    pub fn new(model: M) -> Self {
        let mut bench = Self {
            model,
            now: SimTime::ZERO,
            levels: [0; Pin::PORTS],
            driven: Vec::new(),
        };
        bench.call(|model, io| model.power_on(io));
        bench
    }

    fn call(&mut self, f: impl FnOnce(&mut M, &mut PinIo<'_>)) {
        let mut drives = Vec::new();
        f(
            &mut self.model,
            &mut PinIo::new(self.now, &self.levels, &mut drives),
        );
        for (pin, drive) in drives {
            self.driven.push((self.now, pin, drive));
        }
    }

    /// Lets the model do all that it wants until `until`.
    pub fn run_until(&mut self, until: SimTime) {
        while let Some(at) = self.model.next_event().filter(|t| *t <= until) {
            self.now = self.now.max(at);
            self.call(|model, io| model.advance(io));
        }
        self.now = until;
    }

    /// Lets the model run for a time.
    pub fn run(&mut self, time: SimDuration) {
        self.run_until(self.now + time);
    }

    /// The board changes a pin, now.
    pub fn set_pin(&mut self, pin: Pin, level: Level) {
        let bit = 1 << pin.number();
        self.levels[pin.port()] &= !bit;
        if level.is_high() {
            self.levels[pin.port()] |= bit;
        }
        self.call(|model, io| model.on_pin_edge(pin, level, io));
    }

    /// The board puts a clock on a pin, now.
    pub fn set_clock(&mut self, pin: Pin, rate: Option<Rate>) {
        self.call(|model, io| model.on_clock(pin, rate, io));
    }

    /// Times at which `pin` was driven to `drive`.
    #[must_use]
    pub fn times(&self, pin: Pin, drive: Drive) -> Vec<SimTime> {
        self.driven
            .iter()
            .filter(|(_, p, d)| *p == pin && *d == drive)
            .map(|(t, _, _)| *t)
            .collect()
    }
}

/// Length of a byte on a bus of 400 kHz.
const BYTE: SimDuration = SimDuration::from_nanos(22_500);

impl<M: PinModel + I2cTarget> ModelBench<M> {
    fn byte(&mut self) -> SimTime {
        self.run(BYTE);
        self.now
    }

    /// The bus makes a start condition and sends an address.
    pub fn start(&mut self, address: u8, direction: Direction) -> Ack {
        let at = self.byte();
        self.model.start(address, direction, at)
    }

    /// The bus sends a byte.
    pub fn write_byte(&mut self, byte: u8) -> Ack {
        let at = self.byte();
        self.model.write(byte, at)
    }

    /// The bus reads a byte, and acknowledges it unless it is the last.
    pub fn read_byte(&mut self, last: bool) -> u8 {
        let value = self.model.read(self.now);
        let at = self.byte();
        let ack = if last { Ack::Nack } else { Ack::Ack };
        self.model.read_acknowledged(ack, at);
        value
    }

    /// The bus makes a stop condition.
    pub fn stop(&mut self) {
        self.model.stop(self.now);
    }

    /// Writes registers from `register` on.
    ///
    /// # Errors
    ///
    /// The number of the byte that was not acknowledged; 0 is the address.
    pub fn write(&mut self, address: u8, register: u8, values: &[u8]) -> Result<(), usize> {
        let mut bytes = vec![register];
        bytes.extend_from_slice(values);
        let mut result = Ok(());
        if self.start(address, Direction::Write) == Ack::Nack {
            result = Err(0);
        } else {
            for (i, byte) in bytes.into_iter().enumerate() {
                if self.write_byte(byte) == Ack::Nack {
                    result = Err(i + 1);
                    break;
                }
            }
        }
        self.stop();
        result
    }

    /// Reads `n` registers from `register` on.
    ///
    /// # Errors
    ///
    /// The number of the byte that was not acknowledged; 0 is the address.
    pub fn read(&mut self, address: u8, register: u8, n: usize) -> Result<Vec<u8>, usize> {
        let begun = if self.start(address, Direction::Write) == Ack::Nack {
            Err(0)
        } else if self.write_byte(register) == Ack::Nack {
            Err(1)
        } else if self.start(address, Direction::Read) == Ack::Nack {
            Err(2)
        } else {
            Ok(())
        };
        let result = begun.map(|()| (0..n).map(|i| self.read_byte(i + 1 == n)).collect());
        self.stop();
        result
    }
}
