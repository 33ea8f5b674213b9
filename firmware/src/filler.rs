//! Paces filler to a rate in bytes a second.

use protocol::{TICK_HZ, TickDelta, Ticks};

/// Most bytes that a pause saves up.
const BURST: u64 = 4096;

/// A bucket of bytes that fills with time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Pacer {
    last: Option<Ticks>,
    /// Bytes times [`TICK_HZ`]: whole numbers at any rate.
    saved: u64,
}

impl Pacer {
    /// Empty.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            last: None,
            saved: 0,
        }
    }

    /// Lets time pass at `rate` bytes a second; `u32::MAX` is without limit.
    pub fn advance(&mut self, now: Ticks, rate: u32) {
        let elapsed = self.last.map_or(0, |last| (now - last).unsigned_abs());
        self.last = Some(now);
        let gained = elapsed.saturating_mul(u64::from(rate));
        let most = BURST * u64::from(TICK_HZ);
        self.saved = if rate == u32::MAX {
            most
        } else {
            self.saved.saturating_add(gained).min(most)
        };
    }

    /// Takes `bytes` if they are there.
    pub fn take(&mut self, bytes: u32) -> bool {
        let cost = u64::from(bytes) * u64::from(TICK_HZ);
        match self.saved.checked_sub(cost) {
            Some(rest) => {
                self.saved = rest;
                true
            }
            None => false,
        }
    }

    /// How long until `bytes` will be there at `rate`.
    #[must_use]
    pub fn time_until(&self, bytes: u32, rate: u32) -> TickDelta {
        let missing = (u64::from(bytes) * u64::from(TICK_HZ)).saturating_sub(self.saved);
        TickDelta(missing.div_ceil(u64::from(rate.max(1))) as i64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Woken when it asks to be, it keeps the rate exactly in the long run.
    #[test]
    fn the_rate_is_kept() {
        for rate in [1, 999, 100_000, 777_777] {
            let mut pacer = Pacer::new();
            let mut now = Ticks(12_345);
            let mut sent = 0_u64;
            pacer.advance(now, rate);
            for _ in 0..1000 {
                now = now + pacer.time_until(240, rate);
                pacer.advance(now, rate);
                while pacer.take(240) {
                    sent += 240;
                }
            }
            let due = (now.0 - 12_345) * u64::from(rate) / u64::from(TICK_HZ);
            assert!(due.abs_diff(sent) <= 240, "{rate}: {sent} of {due}");
        }
    }

    #[test]
    fn a_pause_saves_up_no_more_than_a_burst() {
        let mut pacer = Pacer::new();
        pacer.advance(Ticks(0), 1_000_000);
        pacer.advance(Ticks(480_000_000), 1_000_000);
        let bursts = (0..1000).filter(|_| pacer.take(240)).count();
        assert_eq!(bursts, 17);
    }

    #[test]
    fn without_limit_it_never_waits() {
        let mut pacer = Pacer::new();
        pacer.advance(Ticks(5), u32::MAX);
        assert_eq!(pacer.time_until(240, u32::MAX), TickDelta::ZERO);
        assert!(pacer.take(240));
    }
}
