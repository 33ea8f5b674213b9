//! The two stacks, and how deep each has been, by paint.
//!
//! Tasks run on the process stack, handlers and start-up on the main one (ARMv7-M B1.4.1), so
//! that a task that overflows its stack leaves the fault's handler one to report it from.

#![allow(
    unsafe_code,
    reason = "the stacks' memory, and the switch between them"
)]

use core::ops::Range;
use core::sync::atomic::{AtomicUsize, Ordering};

use embassy_executor::raw::Executor;
use firmware::load::stack_used;

// Addresses of the linker script (memory.x).
unsafe extern "C" {
    /// Above the handlers' stack.
    static _stack_start: u32;
    /// The handlers' stack begins here.
    static _handler_stack_end: u32;
    /// Above the tasks' stack, which is below the handlers' and 1 KiB.
    static _task_stack_start: u32;
    /// The tasks' stack begins here.
    static _stack_end: u32;
}

/// Pattern that fills unused stack.
const PAINT: u32 = 0xC0DE_CAFE;

/// Stack left alone below the stack pointer while painting, in words: the
/// frames of the painting itself.
const KEEP_WORDS: usize = 64;

/// A stack, and how much of it was ever used.
struct Stack {
    low: fn() -> *const u32,
    high: fn() -> *const u32,
    used_words: AtomicUsize,
}

static TASKS: Stack = Stack {
    low: || &raw const _stack_end,
    high: || &raw const _task_stack_start,
    used_words: AtomicUsize::new(0),
};

static HANDLERS: Stack = Stack {
    low: || &raw const _handler_stack_end,
    high: || &raw const _stack_start,
    used_words: AtomicUsize::new(0),
};

impl Stack {
    fn addresses(&self) -> Range<usize> {
        (self.low)() as usize..(self.high)() as usize
    }

    /// Fills it below an address in it.
    fn paint(&self, below: usize) {
        let words = (below - self.addresses().start) / 4;
        for word in 0..words {
            // SAFETY: within the stack, and below what is in use.
            unsafe { (self.low)().cast_mut().add(word).write_volatile(PAINT) };
        }
    }

    fn words(&self) -> usize {
        self.addresses().len() / 4
    }

    /// Looks how deep it is painted over by now.
    fn look(&self) {
        let known = self.used_words.load(Ordering::Relaxed);
        // SAFETY: the whole stack is readable RAM. Volatile: handlers write there.
        let read = |word: usize| unsafe { (self.low)().add(word).read_volatile() };
        let used = stack_used(self.words(), read, PAINT, known);
        self.used_words.store(used, Ordering::Relaxed);
    }

    fn depth(&self) -> Depth {
        Depth {
            used: self.used_words.load(Ordering::Relaxed) as u32 * 4,
            size: self.words() as u32 * 4,
        }
    }
}

/// Deepest use of a stack and its size, in bytes.
#[derive(Clone, Copy)]
pub(crate) struct Depth {
    pub(crate) used: u32,
    pub(crate) size: u32,
}

/// Fills both stacks where they are unused. To be called early in `main`, on the handlers'
/// stack, while no interrupt is enabled.
pub(crate) fn paint() {
    let used = cortex_m::register::msp::read() as usize - 4 * KEEP_WORDS;
    HANDLERS.paint(used);
    TASKS.paint(TASKS.addresses().end);
}

/// The stack of which the larger share was ever used. Looks at one of them at each call.
pub(crate) fn fullest(call: u32) -> Depth {
    [&TASKS, &HANDLERS][call as usize % 2].look();
    let (tasks, handlers) = (TASKS.depth(), HANDLERS.depth());
    // Both lie within 128 KiB, so that a product is below 2³².
    let tasks_are = tasks.used * handlers.size >= handlers.used * tasks.size;
    if tasks_are { tasks } else { handlers }
}

/// Has a handler that overflows its stack fault at once: nothing may access the memory below it,
/// but for the fault's handler, for which the MPU is off (ARMv7-M B3.5). To be called once.
pub(crate) fn guard() {
    const ENABLE_WITH_DEFAULT_MAP: u32 = 0b101;
    let guarded = TASKS.addresses().end..HANDLERS.addresses().start;
    let size_field = guarded.len().ilog2() - 1;
    // SAFETY: nobody else uses the MPU, and nothing lies in that memory.
    unsafe {
        let core = cortex_m::Peripherals::steal();
        // Regions that an earlier program has left; the last one is this one's.
        for region in (0..8).rev() {
            core.MPU.rnr.write(region);
            core.MPU.rasr.write(0);
        }
        core.MPU.rbar.write(guarded.start as u32);
        core.MPU.rasr.write(size_field << 1 | 1);
        core.MPU.ctrl.write(ENABLE_WITH_DEFAULT_MAP);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

/// Returns the stack that has ended if an exception frame at this address lies within none.
pub(crate) fn overflowed(at: usize) -> Option<&'static str> {
    const LAST_WORD: usize = 28;
    let holds = |stack: &Stack| {
        let addresses = stack.addresses();
        addresses.contains(&at) && addresses.contains(&(at + LAST_WORD))
    };
    if holds(&TASKS) || holds(&HANDLERS) {
        None
    } else if at < TASKS.addresses().start {
        Some("tasks'")
    } else {
        Some("handlers'")
    }
}

/// Calls itself until the stack ends.
#[allow(unconditional_recursion, reason = "that is its purpose")]
pub(crate) fn overflow(depth: u32) {
    let frame = core::hint::black_box([depth; 64]);
    overflow(frame[0].wrapping_add(1));
    core::hint::black_box(frame);
}

/// Goes on with `run` on the tasks' stack, and leaves this one to handlers. To be called once,
/// by `main`.
pub(crate) fn leave_to_handlers(
    run: extern "C" fn(&'static Executor) -> !,
    executor: &'static Executor,
) -> ! {
    let top = TASKS.addresses().end;
    // SAFETY: the process stack is the tasks' memory, which nothing else uses. Nothing of this
    // frame is used after the switch, and `run` never returns.
    unsafe {
        core::arch::asm!(
            "msr PSP, {top}",
            "msr CONTROL, {process_stack}",
            "isb",
            "bx {run}",
            top = in(reg) top,
            process_stack = in(reg) 2_u32,
            run = in(reg) run,
            in("r0") executor,
            options(noreturn),
        )
    }
}
