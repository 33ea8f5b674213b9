//! The depth camera's flashes as they happened, for the cameras that see them.

use std::sync::{Arc, Mutex};

use crate::clocks::oscillator::TrueTime;
use stm32f4_sim::shared::lock;

/// One flash of infrared light, in true time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TrueFlash {
    /// When the light goes on.
    pub start: TrueTime,
    /// When it goes off.
    pub end: TrueTime,
}

/// All flashes since power-on. Clones share them. (16 bytes a flash: at 30
/// exposures of 9 flashes a second, 16 MB an hour.)
#[derive(Clone, Debug, Default)]
pub struct FlashLog(Arc<Mutex<Vec<TrueFlash>>>);

impl FlashLog {
    /// Adds a flash, which must not begin before the one that was added last.
    pub fn push(&self, flash: TrueFlash) {
        lock(&self.0).push(flash);
    }

    /// The flashes that overlap `from..to`, in order. Complete for times that
    /// have been published as passed.
    #[must_use]
    pub fn flashes(&self, from: TrueTime, to: TrueTime) -> Vec<TrueFlash> {
        let all = lock(&self.0);
        let begin = all.partition_point(|f| f.end <= from);
        all.iter()
            .skip(begin)
            .take_while(|f| f.start < to)
            .copied()
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gives_what_overlaps() {
        let at = TrueTime::from_nanos;
        let log = FlashLog::default();
        for k in 0..10 {
            log.push(TrueFlash {
                start: at(k * 100),
                end: at(k * 100 + 10),
            });
        }
        let starts = |from, to| -> Vec<u64> {
            let seen = log.flashes(at(from), at(to));
            seen.iter().map(|f| f.start.as_nanos()).collect()
        };
        assert_eq!(starts(205, 400), [200, 300]);
        assert_eq!(starts(210, 401), [300, 400]);
        assert_eq!(starts(2000, 3000), [0u64; 0]);
    }
}
