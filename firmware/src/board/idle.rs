//! The loop that runs tasks and sleeps between them.
//!
//! The core sleeps with interrupts masked: one that comes wakes it, but its
//! handler runs only after the clock has been read. So handlers count as time
//! awake, and a wake-up that comes between the check and the sleep is not lost.
//! Unmasking costs a handler some ten cycles, nothing to edges that are armed
//! ahead.

#![allow(unsafe_code, reason = "the executor's platform")]

use core::cell::Cell;
use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::interrupt::{self, Mutex};
use embassy_executor::{Spawner, raw};
use firmware::load::LoadMeter;
use static_cell::StaticCell;

use crate::board::tim2;

static EXECUTOR: StaticCell<raw::Executor> = StaticCell::new();
static WORK: AtomicBool = AtomicBool::new(false);
static LOAD: Mutex<Cell<LoadMeter>> = Mutex::new(Cell::new(LoadMeter::new(0)));

/// Called by the executor, from any context, when a task can go on.
#[unsafe(export_name = "__pender")]
fn pend(_: *mut ()) {
    WORK.store(true, Ordering::Release);
}

/// Runs the tasks that `spawn` starts, for ever.
pub(crate) fn run(spawn: impl FnOnce(Spawner)) -> ! {
    let executor = EXECUTOR.init(raw::Executor::new(core::ptr::null_mut()));
    spawn(executor.spawner());
    loop {
        interrupt::free(|token| {
            if !WORK.load(Ordering::Acquire) {
                let from = tim2::counter();
                cortex_m::asm::dsb();
                cortex_m::asm::wfi();
                let to = tim2::counter();
                let load = LOAD.borrow(token);
                let mut meter = load.get();
                meter.slept(from, to);
                load.set(meter);
            }
        });
        if WORK.swap(false, Ordering::AcqRel) {
            // SAFETY: this is the only call, and not from within itself.
            unsafe { executor.poll() };
        }
    }
}

/// Share of time awake since the last call, in 1/1000.
pub(crate) fn load_permille() -> u16 {
    // The division takes longer than interrupts may be masked.
    let (mut meter, now) = interrupt::free(|token| {
        let now = tim2::counter();
        (LOAD.borrow(token).replace(LoadMeter::new(now)), now)
    });
    meter.permille(now)
}
