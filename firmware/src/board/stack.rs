//! The deepest stack so far, by paint.

#![allow(unsafe_code, reason = "looks at the stack's memory")]

use core::sync::atomic::{AtomicUsize, Ordering};

use firmware::load::stack_used;

unsafe extern "C" {
    /// Highest address of the stack, exclusive; its address is its value.
    static _stack_start: u32;
    /// Lowest address of the stack; its address is its value.
    static _stack_end: u32;
}

/// What is written into unused stack.
const PAINT: u32 = 0xC0DE_CAFE;

/// Stack left alone below the stack pointer while painting, in words: the
/// frames of the painting itself.
const KEEP_WORDS: usize = 64;

static USED_WORDS: AtomicUsize = AtomicUsize::new(0);

/// Lowest address of the stack, and its size in words.
fn bounds() -> (*mut u32, usize) {
    let low = (&raw const _stack_end).cast_mut();
    let words = (&raw const _stack_start as usize - low as usize) / 4;
    (low, words)
}

/// Size of the stack, in bytes.
pub(crate) fn size() -> u32 {
    (bounds().1 * 4) as u32
}

/// Fills the unused stack. To be called early in `main`, while no interrupt is
/// enabled.
pub(crate) fn paint() {
    let (low, _) = bounds();
    let top = cortex_m::register::msp::read() as usize;
    let words = ((top - low as usize) / 4).saturating_sub(KEEP_WORDS);
    for word in 0..words {
        // SAFETY: between the end of the statics and the stack pointer, with
        // room for the frames of this function and of interrupts (none are
        // enabled yet).
        unsafe { low.add(word).write_volatile(PAINT) };
    }
}

/// Most stack ever used, in bytes.
pub(crate) fn used() -> u32 {
    let (low, words) = bounds();
    let known = USED_WORDS.load(Ordering::Relaxed);
    // SAFETY: the whole stack is readable RAM. Volatile: handlers write there.
    let read = |word: usize| unsafe { low.add(word).read_volatile() };
    let used = stack_used(words, read, PAINT, known);
    USED_WORDS.store(used, Ordering::Relaxed);
    (used * 4) as u32
}
