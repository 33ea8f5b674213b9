//! The next event of each part of the chip, and the earliest of all.

use super::TIMERS;
use crate::time::SimTime;

/// Whose event it is. Those of one time are done in the order given here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Source {
    Tim(usize),
    /// A transfer that a timer asked the DMA for.
    TimDma,
    I2c,
    Uart,
    Usb,
    Watchdog,
    /// A clock that changes without a register access (an oscillator gets ready).
    Clock,
    Models,
}

const TIM_DMA: usize = TIMERS;
const I2C: usize = TIM_DMA + 1;
const UART: usize = I2C + 1;
const USB: usize = UART + 1;
const WATCHDOG: usize = USB + 1;
const CLOCK: usize = WATCHDOG + 1;
const MODELS: usize = CLOCK + 1;
const SOURCES: usize = MODELS + 1;

impl Source {
    fn index(self) -> usize {
        match self {
            Self::Tim(n) => n,
            Self::TimDma => TIM_DMA,
            Self::I2c => I2C,
            Self::Uart => UART,
            Self::Usb => USB,
            Self::Watchdog => WATCHDOG,
            Self::Clock => CLOCK,
            Self::Models => MODELS,
        }
    }

    fn of(index: usize) -> Self {
        match index {
            TIM_DMA => Self::TimDma,
            I2C => Self::I2c,
            UART => Self::Uart,
            USB => Self::Usb,
            WATCHDOG => Self::Watchdog,
            CLOCK => Self::Clock,
            n if n < TIMERS => Self::Tim(n),
            _ => Self::Models,
        }
    }
}

#[derive(Debug)]
pub(super) struct Events {
    at: [SimTime; SOURCES],
    next: SimTime,
}

impl Events {
    pub(super) fn new() -> Self {
        Self {
            at: [SimTime::NEVER; SOURCES],
            next: SimTime::NEVER,
        }
    }

    /// Time of the earliest event.
    pub(super) fn next(&self) -> SimTime {
        self.next
    }

    /// Whose event is the earliest.
    pub(super) fn first(&self) -> Source {
        let index = self.at.iter().position(|at| *at == self.next);
        Source::of(index.unwrap_or(MODELS))
    }

    /// True if `source` has an event to come.
    pub(super) fn is_set(&self, source: Source) -> bool {
        self.at[source.index()] != SimTime::NEVER
    }

    /// Says when the next event of `source` is. Returns whether that changed the
    /// time of the earliest.
    pub(super) fn set(&mut self, source: Source, at: SimTime) -> bool {
        let slot = &mut self.at[source.index()];
        if *slot == at {
            return false;
        }
        *slot = at;
        let next = self.at.iter().copied().min().unwrap_or(SimTime::NEVER);
        let changed = next != self.next;
        self.next = next;
        changed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_source_has_a_place_of_its_own() {
        for index in 0..SOURCES {
            assert_eq!(Source::of(index).index(), index);
        }
    }
}
