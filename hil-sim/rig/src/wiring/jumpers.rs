//! The wires of a bring-up: the board's outputs back to its own inputs, and the gates between.
//!
//! A piece of wire carries an edge in some 5 ns a metre, well below a tick: none is
//! modelled.

use stm32f4_sim::model::{PinIo, PinModel};
use stm32f4_sim::pin::{Drive, Level, Pin};
use stm32f4_sim::time::{SimDuration, SimTime};

use crate::wiring;

/// By how many ticks an edge is late at an input that comes from a pin, of the pulse with this
/// number, from 1, that goes that way.
pub type Late = fn(Pin, Pin, Level, u64) -> u64;

/// Wires that a person has put on the board's pins, and moves.
#[derive(Clone, Copy, Debug)]
pub struct Jumpers {
    /// The trigger is wired to the read-back input.
    pub readback: bool,
    /// The pin that is wired to the strobe input.
    pub strobe: Option<Pin>,
    /// An inverting gate is in the wire to the strobe input.
    pub inverted: bool,
    /// A buffer and a divider are between the trigger and the read-back input: how long a rising
    /// and a falling edge take. Both are shorter than a pulse.
    pub buffer: Option<[SimDuration; 2]>,
    /// Board or wires make edges late by less than a pulse.
    pub late: Option<Late>,
    /// The edges that are on their way to the tap and to the strobe input.
    pub on_its_way: [Option<(SimTime, Level)>; 2],
    /// Pulses that went there.
    pub pulses: [u64; 2],
}

impl Default for Jumpers {
    /// As a bring-up begins.
    fn default() -> Self {
        Self {
            readback: true,
            strobe: Some(wiring::TRIGGER),
            inverted: false,
            buffer: None,
            late: None,
            on_its_way: [None; 2],
            pulses: [0; 2],
        }
    }
}

const TAP: usize = 0;
const STROBE: usize = 1;

impl Jumpers {
    /// Schedules an edge of a pin, delayed by its gate and by the pin's own lateness.
    fn sets_out(&mut self, to: usize, from: Pin, level: Level, now: SimTime, held: SimDuration) {
        self.pulses[to] += u64::from(level.is_high());
        let input = [wiring::READBACK, wiring::STROBE][to];
        let late = (self.late).map_or(0, |late| late(input, from, level, self.pulses[to]));
        let late = SimDuration::from_units(late * wiring::UNITS_PER_TICK);
        self.on_its_way[to] = Some((now + held + late, level));
    }
}

impl PinModel for Jumpers {
    fn name(&self) -> String {
        "jumper wires".into()
    }

    fn watched_pins(&self) -> Vec<Pin> {
        let others = [wiring::TRIGGER, wiring::PPS, wiring::NMEA];
        [&others[..], &wiring::OUTPUTS].concat()
    }

    fn outputs(&self) -> Vec<(Pin, f64)> {
        let divided = self
            .buffer
            .map(|_| (wiring::READBACK, wiring::DIVIDED_HIGH));
        divided.into_iter().collect()
    }

    fn on_pin_edge(&mut self, pin: Pin, level: Level, io: &mut PinIo<'_>) {
        if pin == wiring::TRIGGER {
            let [rise, fall] = self.buffer.unwrap_or([SimDuration::ZERO; 2]);
            let held = if level.is_high() { rise } else { fall };
            self.sets_out(TAP, pin, level, io.now(), held);
        }
        if self.strobe == Some(pin) {
            let level = Level::from(level.is_high() != self.inverted);
            self.sets_out(STROBE, pin, level, io.now(), SimDuration::ZERO);
        }
        self.advance(io);
    }

    fn next_event(&self) -> Option<SimTime> {
        self.on_its_way.iter().flatten().map(|(at, _)| *at).min()
    }

    fn advance(&mut self, io: &mut PinIo<'_>) {
        for to in [TAP, STROBE] {
            let Some((_, level)) = self.on_its_way[to].take_if(|(at, _)| *at <= io.now()) else {
                continue;
            };
            if to == TAP && self.readback {
                io.drive(wiring::READBACK, Drive::from(level));
            }
            if to == STROBE || self.strobe == Some(wiring::READBACK) {
                io.drive(wiring::STROBE, Drive::from(level));
            }
        }
    }
}
