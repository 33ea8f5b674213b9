//! Load of the core and depth of its stack.

/// Adds up the time asleep.
///
/// The idle loop sleeps with interrupts masked and unmasks them after it has
/// read the clock, so that handlers count as time awake.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LoadMeter {
    asleep: u32,
    since: u32,
}

impl LoadMeter {
    /// Counts from the counter value `now` on.
    #[must_use]
    pub const fn new(now: u32) -> Self {
        Self {
            asleep: 0,
            since: now,
        }
    }

    /// The core slept from counter value `from` to `to`.
    pub const fn slept(&mut self, from: u32, to: u32) {
        self.asleep = self.asleep.saturating_add(to.wrapping_sub(from));
    }

    /// Share of time awake since the last call, in 1/1000, rounded up to the
    /// next; at most 2³² ticks (89 s) may lie between calls.
    pub const fn permille(&mut self, now: u32) -> u16 {
        let total = now.wrapping_sub(self.since);
        let awake = total.saturating_sub(self.asleep) as u64;
        *self = Self::new(now);
        if total == 0 {
            return 0;
        }
        (awake * 1000).div_ceil(total as u64) as u16
    }
}

/// Words of a stack that are examined at once: 1 KiB, which takes 60 µs, in which no task runs.
/// A frame that leaves more than that unwritten hides what is below it.
const LOOK_WORDS: usize = 256;

/// Words of a stack of `words` words that have ever been used, if it was filled
/// with `paint` and the `known` topmost ones are known to be used, as far as one look
/// reaches; the next one goes on from there. `read` gives the word at an index, 0 being the
/// lowest address.
pub fn stack_used(words: usize, read: impl Fn(usize) -> u32, paint: u32, known: usize) -> usize {
    let known = known.min(words);
    let until = words.min(known + LOOK_WORDS);
    let mut depths = (known..until).rev();
    depths
        .find(|depth| read(words - 1 - depth) != paint)
        .map_or(known, |deepest| deepest + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn load_is_the_time_not_asleep() {
        let mut meter = LoadMeter::new(u32::MAX - 99);
        meter.slept(u32::MAX - 89, 50);
        meter.slept(100, 810);
        assert_eq!(meter.permille(900), 150);
        meter.slept(900, 1900);
        assert_eq!(meter.permille(1900), 0);
        assert_eq!(meter.permille(1900), 0);
        assert_eq!(meter.permille(2000), 1000);
    }

    #[test]
    fn the_deepest_word_counts_and_paint_below_it_does_not() {
        let mut stack = [0xCCCC_CCCC_u32; 2000];
        let used = |stack: &[u32], known| stack_used(stack.len(), |i| stack[i], 0xCCCC_CCCC, known);
        assert_eq!(used(&stack, 0), 0);
        stack[1990..].fill(1);
        assert_eq!(used(&stack, 0), 10);
        stack[1800] = 7;
        assert_eq!(used(&stack, 10), 200);
        // Too far below the rest to belong to it.
        stack[100] = 7;
        assert_eq!(used(&stack, 200), 200);
        stack.fill(0);
        let mut known = 0;
        for looked in [256, 512, 768] {
            known = used(&stack, known);
            assert_eq!(known, looked);
        }
        assert_eq!(used(&stack, 1_900), 2_000);
        assert_eq!(used(&stack, 2_000), 2_000);
    }
}
