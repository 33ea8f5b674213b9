//! The loop that runs tasks and sleeps between them.
//!
//! The core sleeps with interrupts masked: one that comes wakes it, but its
//! handler runs only after the clock has been read. So handlers count as time
//! awake, and a wake-up that comes between the check and the sleep is not lost.
//! Unmasking costs a handler some ten cycles, nothing to edges that are armed
//! ahead.
//!
//! With debug in sleep (DBGMCU_CR) and the flash's prefetch on, the core may run wrong
//! instructions after a WFI, depending on its address (ES0182 2.1.3). So
//! [`super::clocks::config`] leaves debug in sleep off unless a debugger is there, and the WFI
//! is an aligned function of its own, whose address the linker checks (memory/checks.x).

#![allow(unsafe_code, reason = "the executor's platform")]

use core::cell::Cell;
use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::interrupt::{self, Mutex};
use embassy_executor::{Spawner, raw};
use firmware::load::LoadMeter;
use static_cell::StaticCell;

use crate::hardware::{stack, tim2};

core::arch::global_asm!(
    ".pushsection .text.wait_for_interrupt, \"ax\", %progbits",
    ".balign 8",
    ".global wait_for_interrupt",
    ".type wait_for_interrupt, %function",
    ".thumb_func",
    "wait_for_interrupt:",
    "wfi",
    "isb",
    "nop",
    "nop",
    "bx lr",
    ".size wait_for_interrupt, . - wait_for_interrupt",
    ".popsection",
);

unsafe extern "C" {
    safe fn wait_for_interrupt();
}

static EXECUTOR: StaticCell<raw::Executor> = StaticCell::new();
static WORK: AtomicBool = AtomicBool::new(false);
static LOAD: Mutex<Cell<LoadMeter>> = Mutex::new(Cell::new(LoadMeter::new(0)));

/// Called by the executor, from any context, when a task can go on.
#[unsafe(export_name = "__pender")]
fn pend(_: *mut ()) {
    WORK.store(true, Ordering::Release);
}

/// Runs the tasks that `spawn` starts, for ever, on their stack.
pub(crate) fn run(spawn: impl FnOnce(Spawner)) -> ! {
    let executor = EXECUTOR.init(raw::Executor::new(core::ptr::null_mut()));
    spawn(executor.spawner());
    stack::leave_to_handlers(run_tasks, executor)
}

extern "C" fn run_tasks(executor: &'static raw::Executor) -> ! {
    loop {
        interrupt::free(|token| {
            if !WORK.load(Ordering::Acquire) {
                let from = tim2::counter();
                cortex_m::asm::dsb();
                wait_for_interrupt();
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
