//! The way of an edge from a pin to a capture: the synchroniser, then the digital filter
//! (RM0090 18.3.5 and figure 146; ICxF in 18.4.7).
//!
//! The first clock after the edge samples the new level. The synchroniser hands it on
//! some clocks later. The filter takes a new level when it has seen N samples of it in a
//! row: an excursion of fewer never happened.

use std::collections::VecDeque;

/// The slowest filter that samples at the timer's clock; those that divide it are not
/// modelled.
pub(crate) const MAX_FILTER: u32 = 3;

/// Samples that the filter `ICxF` takes in a row, at the timer's clock; none without it
/// (18.4.7).
pub(crate) fn filter_clocks(icf: u32) -> u64 {
    match icf {
        0 => 0,
        1 => 2,
        2 => 4,
        _ => 8,
    }
}

/// Edges of one input that are on their way: the timer's clock at or before each, and
/// its level.
#[derive(Clone, Debug, Default)]
pub(crate) struct Input(VecDeque<(u64, bool)>);

impl Input {
    /// The pin changed between clock `clock` and the next; the filter takes `samples`.
    pub(crate) fn edge(&mut self, clock: u64, rising: bool, samples: u64) {
        match self.0.back() {
            Some(&(since, _)) if clock - since < samples => {
                self.0.pop_back();
            }
            _ => self.0.push_back((clock, rising)),
        }
    }

    /// The clock at which the next edge is through.
    pub(crate) fn next(&self, through: u64) -> Option<u64> {
        self.0.front().map(|(clock, _)| clock + through)
    }

    /// Takes the edge that is through by `clock`: whether it rises.
    pub(crate) fn pop(&mut self, clock: u64, through: u64) -> Option<bool> {
        if self.next(through)? > clock {
            return None;
        }
        self.0.pop_front().map(|(_, rising)| rising)
    }
}
