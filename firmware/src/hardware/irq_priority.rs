//! A mutex between tasks and the handlers of the second highest priority.
//!
//! It raises BASEPRI to hold off those handlers (and everything below them) and
//! never masks TIM2's, the camera trigger's. Those handlers do not preempt one
//! another, and critical sections do not hold them off either
//! ([`super::critical_section`]): they must not touch what critical sections
//! protect.

#![allow(unsafe_code, reason = "an implementation of a raw mutex")]

use core::sync::atomic::{Ordering, compiler_fence};

use cortex_m::register::{basepri, basepri_max};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;

/// Everything from this priority on waits: 1, in the upper 4 of 8 bits.
const CEILING: u8 = 1 << 4;

/// Priority of the handlers below the ceiling.
pub(crate) const PRIORITY: u8 = CEILING;

pub(crate) struct RawIrqPriorityMutex;

/// A mutex for tasks and handlers at priority 1 and below.
pub(crate) type IrqPriorityMutex<T> = Mutex<RawIrqPriorityMutex, T>;

// SAFETY: on this single core nothing of priority 1 or below runs while BASEPRI
// is at the ceiling, and nothing above uses this mutex. BASEPRI_MAX never lowers
// the ceiling, and what was there before is restored, so locks nest.
unsafe impl RawMutex for RawIrqPriorityMutex {
    const INIT: Self = Self;

    fn lock<R>(&self, work: impl FnOnce() -> R) -> R {
        let before = basepri::read();
        basepri_max::write(CEILING);
        compiler_fence(Ordering::SeqCst);
        let result = work();
        compiler_fence(Ordering::SeqCst);
        // SAFETY: back to what held before.
        unsafe { basepri::write(before) };
        result
    }
}
