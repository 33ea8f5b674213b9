//! The wires of a bring-up: the trigger back to the board's own inputs.
//!
//! A piece of wire carries an edge in some 5 ns a metre, well below a tick: none is
//! modelled.

use stm32f4_sim::model::{PinIo, PinModel};
use stm32f4_sim::pin::{Drive, Level, Pin};

use crate::wiring;

/// Wires that a person has put on the board's pins, and moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Jumpers {
    /// The trigger is wired to the read-back input.
    pub readback: bool,
    /// The pin that is wired to the strobe input.
    pub strobe: Option<Pin>,
}

impl Default for Jumpers {
    /// As a bring-up begins.
    fn default() -> Self {
        Self {
            readback: true,
            strobe: Some(wiring::TRIGGER),
        }
    }
}

impl PinModel for Jumpers {
    fn name(&self) -> String {
        "jumper wires".into()
    }

    fn watched_pins(&self) -> Vec<Pin> {
        [&[wiring::TRIGGER][..], &wiring::OUTPUTS].concat()
    }

    fn on_pin_edge(&mut self, pin: Pin, level: Level, io: &mut PinIo<'_>) {
        if self.readback && pin == wiring::TRIGGER {
            io.drive(wiring::READBACK, Drive::from(level));
        }
        if self.strobe == Some(pin) {
            io.drive(wiring::STROBE, Drive::from(level));
        }
    }
}
