//! The I2C bus between the microcontroller and its targets.
//!
//! A target is called once for every event on the bus, at the virtual time at
//! which the event ends on the wire (the ninth clock of a byte). Addresses are
//! 7 bit. Targets do not stretch the clock.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::time::SimTime;

/// Whether the receiver of a byte pulled SDA low in the ninth clock.
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

    /// How the controller answered the byte last read: [`Ack::Nack`] ends the read.
    fn read_acknowledged(&mut self, ack: Ack, at: SimTime) {
        let _ = (ack, at);
    }

    /// Stop condition; called for targets whether they were addressed or not.
    fn stop(&mut self, at: SimTime);

    /// Whether the device holds SDA low outside of a transfer (a hung device).
    fn holds_sda_low(&self) -> bool {
        false
    }

    /// A clock pulse outside of a transfer (nine of them free a hung device).
    fn bus_clear_pulse(&mut self, at: SimTime) {
        let _ = at;
    }
}

/// A target that is shared between the I2C bus, the board's event loop
/// ([`crate::model::PinModel`]) and a test that looks at its state.
pub type Shared<T> = Arc<Mutex<T>>;

impl<T: I2cTarget> I2cTarget for Shared<T> {
    fn start(&mut self, address: u8, direction: Direction, at: SimTime) -> Ack {
        lock(self).start(address, direction, at)
    }
    fn write(&mut self, byte: u8, at: SimTime) -> Ack {
        lock(self).write(byte, at)
    }
    fn read(&mut self, at: SimTime) -> u8 {
        lock(self).read(at)
    }
    fn read_acknowledged(&mut self, ack: Ack, at: SimTime) {
        lock(self).read_acknowledged(ack, at);
    }
    fn stop(&mut self, at: SimTime) {
        lock(self).stop(at);
    }
    fn holds_sda_low(&self) -> bool {
        lock(self).holds_sda_low()
    }
    fn bus_clear_pulse(&mut self, at: SimTime) {
        lock(self).bus_clear_pulse(at);
    }
}

impl<T: crate::model::PinModel> crate::model::PinModel for Shared<T> {
    fn name(&self) -> String {
        lock(self).name()
    }
    fn watched_pins(&self) -> Vec<crate::pin::Pin> {
        lock(self).watched_pins()
    }
    fn inputs(&self) -> Vec<(crate::pin::Pin, f64)> {
        lock(self).inputs()
    }
    fn power_on(&mut self, io: &mut crate::model::PinIo<'_>) {
        lock(self).power_on(io);
    }
    fn on_pin_edge(
        &mut self,
        pin: crate::pin::Pin,
        level: crate::pin::Level,
        io: &mut crate::model::PinIo<'_>,
    ) {
        lock(self).on_pin_edge(pin, level, io);
    }
    fn on_clock(
        &mut self,
        pin: crate::pin::Pin,
        rate: Option<crate::clock::Rate>,
        io: &mut crate::model::PinIo<'_>,
    ) {
        lock(self).on_clock(pin, rate, io);
    }
    fn next_event(&self) -> Option<SimTime> {
        lock(self).next_event()
    }
    fn advance(&mut self, io: &mut crate::model::PinIo<'_>) {
        lock(self).advance(io);
    }
}

/// Locks what is shared. A panic elsewhere while it was locked is not hidden
/// (the test that panicked has failed already), but does not cascade.
pub fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}
