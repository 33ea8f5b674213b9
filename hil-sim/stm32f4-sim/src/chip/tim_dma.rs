//! Transfers that the timers ask the DMA controllers for.

use super::events::Source;
use super::{Soc, TIM1, TIM2, TIM3, TIM4, TIM5};
use crate::time::{SimDuration, SimTime};

/// From a request to the write into the peripheral's register. On an idle bus that is 11
/// clocks of the core at a quarter of it for APB1: arbitration, address, two of APB1,
/// synchronisation (AN4031 table 4). Behind the core's access and those of two other
/// streams, some 45: half of this.
const LATENCY: SimDuration = SimDuration::from_micros(1);

/// Timer and channel, and the controller, stream and channel that serve it (RM0090
/// tables 42 and 43, of the requests of one channel alone).
const REQUESTS: &[(usize, usize, usize, usize, u32)] = &[
    (TIM1, 0, 1, 1, 6),
    (TIM1, 0, 1, 3, 6),
    (TIM1, 1, 1, 2, 6),
    (TIM1, 2, 1, 6, 6),
    (TIM1, 3, 1, 4, 6),
    (TIM2, 0, 0, 5, 3),
    (TIM2, 1, 0, 6, 3),
    (TIM2, 2, 0, 1, 3),
    (TIM2, 3, 0, 6, 3),
    (TIM2, 3, 0, 7, 3),
    (TIM3, 0, 0, 4, 5),
    (TIM3, 1, 0, 5, 5),
    (TIM3, 2, 0, 7, 5),
    (TIM3, 3, 0, 2, 5),
    (TIM4, 0, 0, 0, 2),
    (TIM4, 1, 0, 3, 2),
    (TIM4, 2, 0, 7, 2),
    (TIM5, 0, 0, 2, 6),
    (TIM5, 1, 0, 4, 6),
    (TIM5, 2, 0, 0, 6),
    (TIM5, 3, 0, 1, 6),
    (TIM5, 3, 0, 3, 6),
];

impl Soc {
    /// A request of a timer that an enabled stream can serve: timer, channel,
    /// controller and stream.
    fn timer_request(&self) -> Option<(usize, usize, usize, usize)> {
        REQUESTS
            .iter()
            .find(|(tim, ch, dma, stream, channel)| {
                self.tim[*tim].requests() & (1 << ch) != 0
                    && self.dma[*dma].armed(*stream, *channel)
            })
            .map(|&(tim, ch, dma, stream, _)| (tim, ch, dma, stream))
    }

    /// A timer, or a stream, changed: the transfer that is wanted takes its time.
    pub(super) fn ask_for_timers(&mut self) {
        let asked = self.events.is_set(Source::TimDma);
        if !asked && self.timer_request().is_some() {
            self.set_event(Source::TimDma, self.now + LATENCY);
        }
    }

    /// Does the transfer.
    pub(super) fn serve_timers(&mut self) {
        self.set_event(Source::TimDma, SimTime::NEVER);
        // The stream may have been disabled meanwhile.
        let Some((tim, ch, dma, stream)) = self.timer_request() else {
            return;
        };
        let transfer = self.dma[dma].transfer(stream);
        self.tim[tim].acknowledge(ch);
        if transfer.to_peripheral {
            let value = self.next_item(dma, stream);
            self.write_register(transfer.peripheral, value);
        } else {
            let value = self.read_register(transfer.peripheral).unwrap_or(0);
            self.dma[dma].item_done(stream);
            self.store(&transfer, value);
        }
        self.after_dma();
        self.ask_for_timers();
    }
}
