//! Run times of handlers, by the core's cycle counter (DWT_CYCCNT, ARMv7-M C1.8). The counter
//! stops while the core sleeps, when no handler runs.
//!
//! A probe that is detached switches the debug unit off (TRCENA, C1.6.5), and the counter with
//! it: [`keep_running`] switches it on again each second.

use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::DWT;
use protocol::{HandlerTime, Handlers};

use crate::hardware::leds::{self, Led};

pub(crate) static TRIGGER_TIME: Meter = Meter::new(Led::Pulse);
pub(crate) static OUTPUTS_TIME: Meter = Meter::new(Led::Imu);
pub(crate) static HANDOVER_TIME: Meter = Meter::new(Led::Fault);
pub(crate) static USB_TIME: Meter = Meter::new(Led::Link);

/// Starts the counter, again if it was stopped.
#[allow(unsafe_code, reason = "nobody else uses the debug unit")]
pub(crate) fn keep_running() {
    // SAFETY: called by `main` and one task, and no handler touches these registers.
    let mut core = unsafe { cortex_m::Peripherals::steal() };
    core.DCB.enable_trace();
    core.DWT.enable_cycle_counter();
}

/// Run time of one handler, or of several of one priority: the sum since the last reading, and
/// the longest single run since reset.
pub(crate) struct Meter {
    calls: AtomicU32,
    cycles: AtomicU32,
    worst: AtomicU32,
    /// Pin that is high meanwhile, with the feature `scope`.
    led: Led,
}

impl Meter {
    const fn new(led: Led) -> Self {
        Self {
            led,
            calls: AtomicU32::new(0),
            cycles: AtomicU32::new(0),
            worst: AtomicU32::new(0),
        }
    }

    /// Runs a handler. Nothing interrupts it that runs under the same meter, so plain
    /// loads and stores do.
    pub(crate) fn measure(&self, handler: impl FnOnce()) {
        let show = |on| {
            if cfg!(feature = "scope") {
                leds::drive(self.led, on);
            }
        };
        let begin = DWT::cycle_count();
        show(true);
        handler();
        show(false);
        let took = DWT::cycle_count().wrapping_sub(begin);
        let add = |counter: &AtomicU32, more: u32| {
            let sum = counter.load(Ordering::Relaxed).wrapping_add(more);
            counter.store(sum, Ordering::Relaxed);
        };
        add(&self.calls, 1);
        add(&self.cycles, took);
        self.worst.fetch_max(took, Ordering::Relaxed);
    }

    fn take(&self) -> HandlerTime {
        HandlerTime {
            calls: self.calls.swap(0, Ordering::Relaxed),
            cycles: self.cycles.swap(0, Ordering::Relaxed),
            worst: self.worst.load(Ordering::Relaxed),
        }
    }
}

/// Returns the run times of the handlers and starts new sums.
pub(crate) fn take() -> Handlers {
    Handlers {
        trigger: TRIGGER_TIME.take(),
        outputs: OUTPUTS_TIME.take(),
        handover: HANDOVER_TIME.take(),
        usb: USB_TIME.take(),
    }
}
