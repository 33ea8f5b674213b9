//! Rising edges at pins with their times, for the ground truth.

use stm32f4_sim::model::{PinIo, PinModel};
use stm32f4_sim::pin::{Level, Pin};
use stm32f4_sim::time::SimTime;

/// Notes every rising edge at its pins.
#[derive(Clone, Debug, Default)]
pub struct PinLog {
    pins: Vec<Pin>,
    edges: Vec<(Pin, SimTime)>,
}

impl PinLog {
    /// A log of these pins.
    #[must_use]
    pub fn new(pins: &[Pin]) -> Self {
        Self {
            pins: pins.to_vec(),
            edges: Vec::new(),
        }
    }

    /// The rising edges of a pin so far, in order.
    #[must_use]
    pub fn rising(&self, pin: Pin) -> Vec<SimTime> {
        let of_pin = self.edges.iter().filter(|edge| edge.0 == pin);
        of_pin.map(|edge| edge.1).collect()
    }
}

impl PinModel for PinLog {
    fn name(&self) -> String {
        "pin log".to_owned()
    }

    fn watched_pins(&self) -> Vec<Pin> {
        self.pins.clone()
    }

    fn on_pin_edge(&mut self, pin: Pin, level: Level, io: &mut PinIo<'_>) {
        if level.is_high() {
            self.edges.push((pin, io.now()));
        }
    }
}
