//! I2C1 and UART5: DMA requests, interrupts and wires.

use super::events::Source;
use super::gpio::Mode;
use super::{Soc, uart};
use crate::time::SimTime;

impl Soc {
    pub(super) fn after_i2c(&mut self) {
        self.serve_i2c_dma();
        let (event, error) = self.i2c.irq();
        self.set_irq(31, event);
        self.set_irq(32, error);
        let at = self.i2c.next_event();
        self.set_event(Source::I2c, at);
    }

    pub(super) fn after_uart(&mut self) {
        // Stream 7 of DMA1, channel 4 (RM0090 table 42).
        while self.uart.wants_tx() && self.dma[0].armed(7, 4) {
            let byte = self.next_item(0, 7);
            self.uart.write_dr(byte, self.now);
            self.after_dma();
        }
        self.set_irq(uart::IRQ, self.uart.irq());
        let at = self.uart.next_event();
        self.set_event(Source::Uart, at);
        let (pin, function) = uart::TX;
        if self.gpio.mode(pin) == Mode::Alternate(function) {
            self.update_pin(pin);
        }
    }

    /// Streams of DMA1 that serve I2C1 (RM0090 table 42, channel 1).
    fn i2c_stream(&self, receive: bool) -> Option<usize> {
        let streams = if receive { [0, 5] } else { [6, 7] };
        streams.into_iter().find(|s| self.dma[0].armed(*s, 1))
    }

    pub(super) fn step_i2c(&mut self, at: SimTime) {
        let remaining = match self.i2c_stream(true) {
            Some(s) => self.dma[0].remaining(s),
            None => u32::MAX,
        };
        self.i2c.advance(at, &mut self.i2c_bus, remaining);
        self.after_i2c();
        // A target may want to change a pin, such as its interrupt.
        if !self.models.is_empty() {
            self.reschedule_models();
        }
    }

    fn serve_i2c_dma(&mut self) {
        let mut served = false;
        for _ in 0..4 {
            if self.i2c.wants_rx()
                && let Some(s) = self.i2c_stream(true)
            {
                let t = self.dma[0].transfer(s);
                let byte = self.i2c.dma_read(self.now, &mut self.i2c_bus);
                self.dma[0].item_done(s);
                self.store(&t, u32::from(byte));
            } else if self.i2c.wants_tx()
                && let Some(s) = self.i2c_stream(false)
            {
                let byte = self.next_item(0, s);
                self.i2c.write_dr(byte as u8, self.now);
            } else {
                break;
            }
            served = true;
        }
        if served {
            self.after_dma();
        }
    }

    /// The I2C bus was touched from outside (a fault was put on or taken off).
    pub(crate) fn i2c_bus_changed(&mut self) {
        if !self.i2c_bus.is_stuck() {
            self.i2c.bus_released(self.now);
        }
        self.after_i2c();
        if let Some(wires) = self.i2c_wires {
            self.update_pin(wires.sda);
        }
    }
}
