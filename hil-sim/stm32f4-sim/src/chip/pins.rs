//! Pins: who drives them, who hears of their edges.

use super::gpio::Mode;
use super::{I2cWires, Soc, TIM1, TIM2, TIM3, TIM4, TIM5, uart};
use crate::pin::{Drive, Level, Pin};
use crate::time::SimTime;

/// Timer, channel and alternate function of the pins that have one
/// (DS8626 table 9; those of the LQFP100 package).
const TIMER_PINS: &[(Pin, u8, usize, usize)] = &[
    (Pin::PA0, 1, TIM2, 0),
    (Pin::PA1, 1, TIM2, 1),
    (Pin::PA2, 1, TIM2, 2),
    (Pin::PA3, 1, TIM2, 3),
    (Pin::PA5, 1, TIM2, 0),
    (Pin::PA15, 1, TIM2, 0),
    (Pin::PB3, 1, TIM2, 1),
    (Pin::PB10, 1, TIM2, 2),
    (Pin::PB11, 1, TIM2, 3),
    (Pin::PA8, 1, TIM1, 0),
    (Pin::PA9, 1, TIM1, 1),
    (Pin::PA10, 1, TIM1, 2),
    (Pin::PA11, 1, TIM1, 3),
    (Pin::PE9, 1, TIM1, 0),
    (Pin::PE11, 1, TIM1, 1),
    (Pin::PE13, 1, TIM1, 2),
    (Pin::PE14, 1, TIM1, 3),
    (Pin::PA6, 2, TIM3, 0),
    (Pin::PA7, 2, TIM3, 1),
    (Pin::PB0, 2, TIM3, 2),
    (Pin::PB1, 2, TIM3, 3),
    (Pin::PB4, 2, TIM3, 0),
    (Pin::PB5, 2, TIM3, 1),
    (Pin::PC6, 2, TIM3, 0),
    (Pin::PC7, 2, TIM3, 1),
    (Pin::PC8, 2, TIM3, 2),
    (Pin::PC9, 2, TIM3, 3),
    (Pin::PB6, 2, TIM4, 0),
    (Pin::PB7, 2, TIM4, 1),
    (Pin::PB8, 2, TIM4, 2),
    (Pin::PB9, 2, TIM4, 3),
    (Pin::PD12, 2, TIM4, 0),
    (Pin::PD13, 2, TIM4, 1),
    (Pin::PD14, 2, TIM4, 2),
    (Pin::PD15, 2, TIM4, 3),
    (Pin::PA0, 2, TIM5, 0),
    (Pin::PA1, 2, TIM5, 1),
    (Pin::PA2, 2, TIM5, 2),
    (Pin::PA3, 2, TIM5, 3),
];

impl Soc {
    /// Drive of the microcontroller on a pin.
    fn own_drive(&self, pin: Pin) -> Option<bool> {
        match self.gpio.mode(pin) {
            Mode::Input | Mode::Analog => None,
            Mode::Output => Some(self.gpio.odr(pin)),
            Mode::Alternate(af) => {
                let timer = TIMER_PINS.iter().find(|(p, f, _, _)| *p == pin && *f == af);
                if let Some((_, _, tim, ch)) = timer {
                    return self.tim[*tim].output(*ch);
                }
                ((pin, af) == uart::TX).then(|| self.uart.line())
            }
        }
    }

    /// Something outside drives a pin from now on.
    pub(crate) fn drive(&mut self, pin: Pin, drive: Drive) {
        if self.gpio.outside(pin) != drive {
            self.gpio.drive(pin, drive);
            self.update_pin(pin);
        }
    }

    pub(super) fn update_port(&mut self, port: usize, pins: u16) {
        let mut pins = pins;
        while pins != 0 {
            let n = pins.trailing_zeros();
            pins &= pins - 1;
            if let Some(pin) = Pin::new(port as u8, n as u8) {
                self.update_pin(pin);
            }
        }
    }

    pub(super) fn update_timer_pins(&mut self, tim: usize) {
        for (pin, af, t, _) in TIMER_PINS {
            if *t == tim && self.gpio.mode(*pin) == Mode::Alternate(*af) {
                self.update_pin(*pin);
            }
        }
    }

    /// Computes a pin's level, and tells of its edge if it changed.
    pub(super) fn update_pin(&mut self, pin: Pin) {
        let mut own = self.own_drive(pin);
        let is_sda = self.i2c_wires.is_some_and(|wires| wires.sda == pin);
        if is_sda && own != Some(false) && self.i2c_bus.is_stuck() {
            own = Some(false);
        }
        let level = self.gpio.resolve(pin, own);
        if level {
            self.require_voltage(pin);
        }
        if !self.gpio.set_level(pin, level) {
            return;
        }
        self.edge_queue.push((pin, level, self.now));
        if !self.delivering {
            self.delivering = true;
            let mut done = 0;
            // Models may cause further edges while they hear of one.
            while let Some((pin, level, at)) = self.edge_queue.get(done).copied() {
                done += 1;
                self.deliver(pin, level, at);
            }
            self.edge_queue.clear();
            self.delivering = false;
        }
    }

    fn deliver(&mut self, pin: Pin, high: bool, at: SimTime) {
        self.edge_counts[pin.index()] += 1;
        if self.logged[pin.port()] & (1 << pin.number()) != 0 {
            self.edge_log.push((pin, Level::from(high), at));
        }
        // Timer inputs.
        if let Mode::Alternate(af) = self.gpio.mode(pin)
            && let Some((_, _, tim, ti)) =
                TIMER_PINS.iter().find(|(p, f, _, _)| *p == pin && *f == af)
        {
            let (tim, ti) = (*tim, *ti);
            self.tim[tim].input_edge(ti, high, at);
            self.after_capture(tim);
        }
        // The I2C wires moved by software.
        if let Some(wires) = self.i2c_wires {
            self.bus_by_hand(wires, pin, high);
        }
        let watchers = self.watchers[pin.index()];
        for index in 0..self.models.len().min(64) {
            if watchers & (1 << index) != 0 {
                self.call_model(index, at, |model, io| {
                    model.on_pin_edge(pin, Level::from(high), io);
                });
            }
        }
    }

    /// A bus clear: software clocks SCL, or makes a stop condition.
    fn bus_by_hand(&mut self, wires: I2cWires, pin: Pin, high: bool) {
        if self.i2c.owns_bus() || (pin != wires.scl && pin != wires.sda) {
            return;
        }
        let stuck = self.i2c_bus.is_stuck();
        if pin == wires.scl && high {
            self.i2c_bus.pulse(self.now);
        } else if pin == wires.sda && high && self.gpio.level(wires.scl) {
            self.i2c_bus.stop(self.now);
        }
        if stuck && !self.i2c_bus.is_stuck() {
            self.i2c_bus_changed();
        }
        self.reschedule_models();
    }
}
