//! Actions that follow a moment after the answer to their command: failing on purpose, and
//! restarting into the ROM.

use core::sync::atomic::{AtomicBool, Ordering};

use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::Timer;
use firmware::config::SELF_TEST_DELAY_MS;
use protocol::Failure;

use crate::hardware::{faults, otg, stack, tim2};

/// A requested action.
pub(crate) enum Wanted {
    Failure(Failure),
    Rom,
}

static WANTED: Signal<CriticalSectionRawMutex, Wanted> = Signal::new();

/// The IMU's task shall stop being alive.
static STALLED: AtomicBool = AtomicBool::new(false);

pub(crate) fn request(wanted: Wanted) {
    WANTED.signal(wanted);
}

pub(crate) fn is_stalled() -> bool {
    STALLED.load(Ordering::Relaxed)
}

#[embassy_executor::task]
#[allow(clippy::panic, reason = "that is its purpose")]
pub(crate) async fn run() {
    loop {
        let wanted = WANTED.wait().await;
        Timer::after_millis(SELF_TEST_DELAY_MS).await;
        let Wanted::Failure(failure) = wanted else {
            otg::leave().await;
            faults::restart_into_rom();
        };
        match failure {
            Failure::Panic => panic!("self test: panic on request"),
            Failure::HardFault => faults::undefined_instruction(),
            Failure::StackOverflow => stack::overflow(0),
            Failure::HandlerOverflow => faults::overflow_in_handler(),
            Failure::SlowHandler => tim2::slow_down(),
            Failure::LeaveBus => otg::restart().await,
            Failure::Stall => STALLED.store(true, Ordering::Relaxed),
            Failure::Hang => loop {
                core::hint::spin_loop();
            },
        }
    }
}
