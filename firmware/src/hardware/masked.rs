//! Longest times for which interrupts are masked, by the core's cycle counter
//! ([`super::cycles`]).

use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::DWT;
use protocol::Masked;

/// All interrupts, by tasks, the sleep apart.
pub(super) static ALL: Longest = Longest(AtomicU32::new(0));

/// Those below the trigger's.
pub(super) static BELOW_TRIGGER: Longest = Longest(AtomicU32::new(0));

/// The longest of some stretches, in cycles.
pub(super) struct Longest(AtomicU32);

impl Longest {
    /// A stretch that began at this count is over.
    #[inline]
    pub(super) fn ended(&self, begin: u32) {
        let took = DWT::cycle_count().wrapping_sub(begin);
        if took > self.0.load(Ordering::Relaxed) {
            self.0.store(took, Ordering::Relaxed);
        }
    }

    /// Meters `work`, which is done with interrupts masked.
    #[inline]
    pub(super) fn measure<R>(&self, work: impl FnOnce() -> R) -> R {
        let begin = DWT::cycle_count();
        let result = work();
        self.ended(begin);
        result
    }
}

/// The longest since reset.
pub(crate) fn longest() -> Masked {
    Masked {
        all: ALL.0.load(Ordering::Relaxed),
        below_trigger: BELOW_TRIGGER.0.load(Ordering::Relaxed),
    }
}
