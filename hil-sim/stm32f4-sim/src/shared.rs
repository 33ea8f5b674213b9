//! Shared ownership of a model on the board's wires, for code that looks at it meanwhile.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::clock::Rate;
use crate::i2c::{Ack, Direction, I2cTarget};
use crate::model::{PinIo, PinModel};
use crate::pin::{Level, Pin};
use crate::time::SimTime;

/// A target that is shared between the I2C bus, the board's event loop
/// ([`PinModel`]) and a test that looks at its state.
pub type Shared<T> = Arc<Mutex<T>>;

/// Locks what is shared. A panic elsewhere while it was locked is not hidden
/// (the test that panicked has failed already), but does not cascade.
pub fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

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

impl<T: PinModel> PinModel for Shared<T> {
    fn name(&self) -> String {
        lock(self).name()
    }
    fn watched_pins(&self) -> Vec<Pin> {
        lock(self).watched_pins()
    }
    fn outputs(&self) -> Vec<(Pin, f64)> {
        lock(self).outputs()
    }

    fn inputs(&self) -> Vec<(Pin, f64)> {
        lock(self).inputs()
    }
    fn power_on(&mut self, io: &mut PinIo<'_>) {
        lock(self).power_on(io);
    }
    fn on_pin_edge(&mut self, pin: Pin, level: Level, io: &mut PinIo<'_>) {
        lock(self).on_pin_edge(pin, level, io);
    }
    fn on_clock(&mut self, pin: Pin, rate: Option<Rate>, io: &mut PinIo<'_>) {
        lock(self).on_clock(pin, rate, io);
    }
    fn next_event(&self) -> Option<SimTime> {
        lock(self).next_event()
    }
    fn advance(&mut self, io: &mut PinIo<'_>) {
        lock(self).advance(io);
    }
}
