//! Critical sections that never mask the trigger.
//!
//! The usual one for a single core masks all interrupts (PRIMASK). This one
//! raises BASEPRI, so that interrupts of priority 2 and below wait and those of
//! TIM2 (priority 0) and of the auxiliary outputs (priority 1) do not: writing a
//! packet into USB's FIFO or a line of the log cannot delay an edge of a trigger.
//! The price is that their handlers must not touch what critical sections protect.

#![allow(unsafe_code, reason = "an implementation of the critical section")]

use core::sync::atomic::{AtomicU32, Ordering, compiler_fence};

use cortex_m::peripheral::DWT;
use cortex_m::register::{basepri, basepri_max};

use crate::hardware::masked;

/// Everything from this priority on waits: 2, in the upper 4 of 8 bits.
const CEILING: u8 = 2 << 4;

/// Count of cycles at which the outermost section began.
static SINCE: AtomicU32 = AtomicU32::new(0);

struct BelowTrigger;

critical_section::set_impl!(BelowTrigger);

// SAFETY: on this single core, everything that uses critical sections runs in
// thread mode or at priorities of 2 and below (`clocks::set_priorities`), all
// of which BASEPRI holds off. BASEPRI_MAX never lowers the ceiling, and release
// restores what was there, so sections nest.
unsafe impl critical_section::Impl for BelowTrigger {
    unsafe fn acquire() -> critical_section::RawRestoreState {
        let before = basepri::read();
        basepri_max::write(CEILING);
        if before == 0 {
            SINCE.store(DWT::cycle_count(), Ordering::Relaxed);
        }
        compiler_fence(Ordering::SeqCst);
        before
    }

    unsafe fn release(before: critical_section::RawRestoreState) {
        compiler_fence(Ordering::SeqCst);
        if before == 0 {
            masked::BELOW_TRIGGER.ended(SINCE.load(Ordering::Relaxed));
        }
        // SAFETY: back to what held before this section.
        unsafe { basepri::write(before) };
    }
}
