//! 64-bit board time from a 32-bit counter.
//!
//! TIM2 counts 2³² ticks in 89.5 s and wraps. The upper half of the time is
//! not counted by an overflow interrupt: reading such a count and the counter
//! is a race around every wrap, and a captured value (which may lie on either
//! side of a wrap when it is read) makes it two.
//!
//! Instead a hint says roughly what time it is: the number of half periods
//! (2³¹ ticks, 44.7 s) that have passed. A counter or capture value then means
//! the one instant with these low 32 bits that lies in a window of exactly 2³²
//! ticks around the hinted half period:
//!
//! ```text
//!            hint · 2³¹                 (hint + 1) · 2³¹
//! ──[───2³⁰───┼───────────2³¹────────────┼───2³⁰───)──
//! ```
//!
//! So the hint may be off by 22.4 s in either direction. It is refreshed by
//! every interrupt of TIM2 and once a second by the status task, without which
//! the watchdog resets the board. It is one atomic 32-bit word: nobody can read
//! half of it, and it never goes back.
//!
//! Limit: 2³² half periods, 6,000 years.

use core::sync::atomic::{AtomicU32, Ordering};

use protocol::Ticks;

/// Log₂ of the ticks in a half period of the counter.
const HALF_BITS: u32 = 31;

/// Farthest that a value may lie outside of the hinted half period, in ticks.
const MARGIN: u32 = 1 << 30;

/// The instant that the counter value `low` means, if the half period `hint`
/// is the current one to within 2³⁰ ticks (22.4 s) on either side.
///
/// Before time zero there is nothing: in half period 0, values from 3 · 2³⁰ on
/// mean the end of the first full period.
const fn extend(hint: u32, low: u32) -> Ticks {
    let base = (hint as u64) << HALF_BITS;
    let above_window = low.wrapping_sub(base as u32).wrapping_add(MARGIN);
    match (base + above_window as u64).checked_sub(MARGIN as u64) {
        Some(ticks) => Ticks(ticks),
        None => Ticks(low as u64),
    }
}

/// The hint, shared by interrupts and tasks.
#[derive(Debug)]
pub struct Timebase {
    hint: AtomicU32,
}

impl Timebase {
    /// At time zero.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            hint: AtomicU32::new(0),
        }
    }

    /// The instant of a counter or capture value of the last or next 22.4 s.
    #[inline]
    #[must_use]
    pub fn extend(&self, low: u32) -> Ticks {
        extend(self.hint.load(Ordering::Relaxed), low)
    }

    /// Takes the counter's present value: keeps the hint fresh, and returns now.
    #[inline]
    pub fn refresh(&self, counter: u32) -> Ticks {
        let now = self.extend(counter);
        let half = (now.0 >> HALF_BITS) as u32;
        self.hint.fetch_max(half, Ordering::Relaxed);
        now
    }
}

impl Default for Timebase {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every instant that may go with a hint comes out, at every place of the
    /// counter where something changes and a sweep of all others.
    #[test]
    fn every_instant_in_the_window_of_its_hint_is_found() {
        for hint in [1_u32, 2, 3, 4, 5, 1_000_001, u32::MAX - 1, u32::MAX] {
            let base = i128::from(hint) << 31;
            let first = base - (1 << 30);
            let last = base + 3 * (1 << 30) - 1;
            let mut times: Vec<i128> = (0..4096).map(|i| first + i * (1 << 20)).collect();
            for edge in [first, base, base + (1 << 30), base + (1 << 31), last] {
                times.extend((-70..=70).map(|d| edge + d));
            }
            for t in times.into_iter().filter(|t| (first..=last).contains(t)) {
                let t = u64::try_from(t).unwrap();
                assert_eq!(extend(hint, t as u32), Ticks(t), "hint {hint}");
            }
        }
    }

    #[test]
    fn the_first_period_has_nothing_before_it() {
        for low in [0, 1, (1 << 31) - 1, 1 << 31, 3 << 30, u32::MAX] {
            assert_eq!(extend(0, low), Ticks(u64::from(low)));
        }
    }

    /// Time goes on over twenty wraps, refreshed at any interval up to 22 s,
    /// with captures read up to 22 s late.
    #[test]
    fn time_is_continuous_and_monotonic_over_wraps() {
        let timebase = Timebase::new();
        let mut t = 0_u64;
        let mut step = 1_u64;
        while t < 20 << 32 {
            assert_eq!(timebase.refresh(t as u32), Ticks(t));
            let captured = t.saturating_sub(22 * 48_000_000);
            assert_eq!(timebase.extend(captured as u32), Ticks(captured));
            step = (step * 5 + 77_777_777) % (22 * 48_000_000);
            t += step;
        }
    }

    /// Two contexts that refresh in any interleaving never set the hint back.
    #[test]
    fn a_late_refresh_does_not_set_the_hint_back() {
        let timebase = Timebase::new();
        let before = (1_u64 << 31) - 10;
        let after = (1_u64 << 31) + 10;
        assert_eq!(timebase.refresh(after as u32), Ticks(after));
        assert_eq!(timebase.refresh(before as u32), Ticks(before));
        assert_eq!(timebase.hint.load(Ordering::Relaxed), 1);
    }
}
