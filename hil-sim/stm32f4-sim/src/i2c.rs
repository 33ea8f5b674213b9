//! The I2C bus between the microcontroller and its targets.
//!
//! A target is called once for every event on the bus, at the virtual time at
//! which the event ends on the wire (the ninth clock of a byte). Addresses are
//! 7 bit. Targets do not stretch the clock.

use crate::time::SimTime;

/// True if the receiver of a byte pulled SDA low in the ninth clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ack {
    /// Acknowledged.
    Ack,
    /// Not acknowledged.
    Nack,
}

/// Direction of a transfer, as the controller's address byte says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// The controller sends bytes.
    Write,
    /// The controller reads bytes.
    Read,
}

/// A device on the I2C bus.
///
/// Order of calls in a register read: `start(Write)`, `write(register)`,
/// `start(Read)` (a repeated start: no `stop` between), `read()`... each
/// followed by `read_acknowledged()`, `stop()`.
pub trait I2cTarget: Send {
    /// Start or repeated start followed by an address byte. Called for every
    /// address on the bus; answer [`Ack::Nack`] if it is not this device's
    /// (then no further call comes before the next start or stop).
    fn start(&mut self, address: u8, direction: Direction, at: SimTime) -> Ack;

    /// A byte from the controller.
    fn write(&mut self, byte: u8, at: SimTime) -> Ack;

    /// The next byte for the controller, at the time its first bit is put on the wire.
    fn read(&mut self, at: SimTime) -> u8;

    /// Takes the controller's answer to the byte last read: [`Ack::Nack`] ends the read.
    fn read_acknowledged(&mut self, ack: Ack, at: SimTime) {
        let _ = (ack, at);
    }

    /// Stop condition; called for targets whether they were addressed or not.
    fn stop(&mut self, at: SimTime);

    /// True if the device holds SDA low outside of a transfer (a hung device).
    fn holds_sda_low(&self) -> bool {
        false
    }

    /// A clock pulse outside of a transfer (nine of them free a hung device).
    fn bus_clear_pulse(&mut self, at: SimTime) {
        let _ = at;
    }
}
