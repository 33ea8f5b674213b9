//! The wires of a bring-up: the board's outputs back to its own inputs, and the gates between.
//!
//! A piece of wire carries an edge in some 5 ns a metre, well below a tick: none is
//! modelled.

use stm32f4_sim::model::{PinIo, PinModel};
use stm32f4_sim::pin::{Drive, Level, Pin};
use stm32f4_sim::time::{SimDuration, SimTime};

use crate::wiring;

/// Wires that a person has put on the board's pins, and moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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
    /// The edge that is on its way through them.
    pub on_its_way: Option<(SimTime, Level)>,
}

impl Default for Jumpers {
    /// As a bring-up begins.
    fn default() -> Self {
        Self {
            readback: true,
            strobe: Some(wiring::TRIGGER),
            inverted: false,
            buffer: None,
            on_its_way: None,
        }
    }
}

impl Jumpers {
    fn at_tap(&self, level: Level, io: &mut PinIo<'_>) {
        if self.readback {
            io.drive(wiring::READBACK, Drive::from(level));
        }
        if self.strobe == Some(wiring::READBACK) {
            io.drive(wiring::STROBE, Drive::from(level));
        }
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

    fn on_pin_edge(&mut self, pin: Pin, level: Level, io: &mut PinIo<'_>) {
        if pin == wiring::TRIGGER {
            match self.buffer {
                None => self.at_tap(level, io),
                Some([rise, fall]) => {
                    let delay = if level.is_high() { rise } else { fall };
                    self.on_its_way = Some((io.now() + delay, level));
                }
            }
        }
        if self.strobe == Some(pin) {
            let level = Level::from(level.is_high() != self.inverted);
            io.drive(wiring::STROBE, Drive::from(level));
        }
    }

    fn next_event(&self) -> Option<SimTime> {
        self.on_its_way.map(|(at, _)| at)
    }

    fn advance(&mut self, io: &mut PinIo<'_>) {
        if let Some((at, level)) = self.on_its_way
            && at <= io.now()
        {
            self.on_its_way = None;
            self.at_tap(level, io);
        }
    }
}
