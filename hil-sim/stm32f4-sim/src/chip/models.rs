//! The parts of the board that are wired to the chip's pins.

use super::Soc;
use super::events::Source;
use crate::model::{PinIo, PinModel};
use crate::time::SimTime;

pub(super) struct Model {
    model: Box<dyn PinModel>,
    next: SimTime,
}

impl Soc {
    /// Adds a model and lets it drive its idle levels.
    pub(crate) fn add_model(&mut self, mut model: Box<dyn PinModel>) {
        let index = self.models.len();
        for pin in model.watched_pins() {
            if index < 64 {
                self.watchers[pin.index()] |= 1 << index;
            }
        }
        let mut drives = Vec::new();
        let mut io = PinIo::new(self.now, &self.gpio.levels, &mut drives);
        model.power_on(&mut io);
        let next = model.next_event().unwrap_or(SimTime::NEVER);
        self.models.push(Model { model, next });
        for (pin, drive) in drives {
            self.drive(pin, drive);
        }
        self.reschedule_models();
    }

    pub(super) fn call_model(
        &mut self,
        index: usize,
        at: SimTime,
        f: impl FnOnce(&mut dyn PinModel, &mut PinIo<'_>),
    ) {
        let mut drives = Vec::new();
        let levels = self.gpio.levels;
        if let Some(m) = self.models.get_mut(index) {
            let mut io = PinIo::new(at, &levels, &mut drives);
            f(m.model.as_mut(), &mut io);
            m.next = m.model.next_event().unwrap_or(SimTime::NEVER).max(at);
        }
        for (pin, drive) in drives {
            self.drive(pin, drive);
        }
        self.schedule_models();
    }

    fn schedule_models(&mut self) {
        let at = self
            .models
            .iter()
            .map(|m| m.next)
            .min()
            .unwrap_or(SimTime::NEVER);
        self.set_event(Source::Models, at);
    }

    /// Asks every model again when it wants to be called.
    pub(crate) fn reschedule_models(&mut self) {
        let now = self.now;
        for m in &mut self.models {
            m.next = m.model.next_event().unwrap_or(SimTime::NEVER).max(now);
        }
        self.schedule_models();
    }

    pub(super) fn step_models(&mut self, at: SimTime) {
        for index in 0..self.models.len() {
            if self.models.get(index).is_some_and(|m| m.next <= at) {
                self.call_model(index, at, |model, io| model.advance(io));
                // A model that asks for the same time again without an end
                // must not stop the board's time.
                let stuck = self.models.get(index).is_some_and(|m| m.next <= at);
                if stuck && let Some(m) = self.models.get_mut(index) {
                    m.next = SimTime::from_units(at.units() + 1);
                }
            }
        }
        self.schedule_models();
    }
}
