//! A strobe on the trigger, for tests.

use std::collections::VecDeque;

use stm32f4_sim::model::{PinIo, PinModel};
use stm32f4_sim::pin::{Drive, Level, Pin};
use stm32f4_sim::time::{SimDuration, SimTime};

/// Pulses on the strobe input, `count` of them at each trigger pulse.
pub(crate) struct Strobe {
    count: u32,
    high: SimDuration,
    pitch: SimDuration,
    /// Excursions to the other level after each edge, and how long each lasts.
    pub(crate) ringing: Option<(u32, SimDuration)>,
    coming: VecDeque<(SimTime, Level)>,
}

impl Strobe {
    /// The depth camera's: 9 pulses of 125 µs, 1,575 µs apart.
    pub(crate) fn flashes() -> Self {
        Self {
            pitch: SimDuration::from_micros(1_575),
            ..Self::pulses(9, SimDuration::from_micros(125))
        }
    }

    /// As long low as high.
    pub(crate) fn pulses(count: u32, high: SimDuration) -> Self {
        Self {
            count,
            high,
            pitch: high + high,
            ringing: None,
            coming: VecDeque::new(),
        }
    }
}

impl Strobe {
    /// An edge to come, with its ringing: as long at the new level as at the old.
    fn edge(&mut self, mut at: SimTime, level: Level) {
        let other = if level.is_high() {
            Level::Low
        } else {
            Level::High
        };
        let (count, length) = self.ringing.unwrap_or((0, SimDuration::ZERO));
        for _ in 0..count {
            self.coming.push_back((at, level));
            self.coming.push_back((at + length, other));
            at += length + length;
        }
        self.coming.push_back((at, level));
    }
}

impl PinModel for Strobe {
    fn name(&self) -> String {
        "strobe".into()
    }
    fn watched_pins(&self) -> Vec<Pin> {
        vec![Pin::PA5]
    }
    fn power_on(&mut self, io: &mut PinIo<'_>) {
        io.drive(Pin::PA2, Drive::Low);
    }
    fn on_pin_edge(&mut self, _: Pin, level: Level, io: &mut PinIo<'_>) {
        if level.is_high() {
            // Not on a whole tick, so that captures have something to round.
            let mut at = io.now() + SimDuration::from_nanos(500_007);
            for _ in 0..self.count {
                self.edge(at, Level::High);
                self.edge(at + self.high, Level::Low);
                at += self.pitch;
            }
        }
    }
    fn next_event(&self) -> Option<SimTime> {
        self.coming.front().map(|next| next.0)
    }
    fn advance(&mut self, io: &mut PinIo<'_>) {
        while let Some(&(at, level)) = self.coming.front()
            && at <= io.now()
        {
            self.coming.pop_front();
            io.drive(Pin::PA2, Drive::from(level));
        }
    }
}
