//! Consequences of a change of a clock: everybody's rate, and the clock on PA8.

use super::gpio::Mode;
use super::{Soc, TIM1, TIMERS};
use crate::clock::{Clock, Rate};
use crate::pin::Pin;

impl Soc {
    pub(super) fn apply_clocks(&mut self) {
        let clocks = self.rcc.clocks(self.now);
        if clocks.hclk != self.clocks.hclk {
            // The present cycle is the first of the new rate.
            self.core_clock =
                Clock::new(clocks.hclk, self.core_clock.time_of(self.cycle), self.cycle);
            self.event_cycle = self.cycle_at(self.events.next());
        }
        let before = std::mem::replace(&mut self.clocks, clocks);
        for n in 0..TIMERS {
            let (old, rate) = if n == TIM1 {
                (before.timers2, clocks.timers2)
            } else {
                (before.timers1, clocks.timers1)
            };
            // A clock that goes on keeps its phase.
            if rate != old {
                self.tim[n].set_clock(rate, self.now);
            }
            self.reschedule_tim(n);
        }
        self.i2c.set_clock(clocks.pclk1);
        self.uart.set_clock(clocks.pclk1);
        self.update_mco();
        self.update_waits();
        self.require_clocks();
    }

    /// Rate of the clock that PA8 carries.
    pub(crate) fn mco1(&self) -> Option<Rate> {
        (self.gpio.mode(Pin::PA8) == Mode::Alternate(0))
            .then_some(self.clocks.mco1)
            .flatten()
    }

    pub(super) fn update_mco(&mut self) {
        let rate = self.mco1();
        if rate == self.mco_told {
            return;
        }
        self.mco_told = rate;
        for index in 0..self.models.len() {
            if self.watchers[Pin::PA8.index()] & (1 << index) != 0 {
                self.call_model(index, self.now, |model, io| {
                    model.on_clock(Pin::PA8, rate, io)
                });
            }
        }
    }
}
