//! Captured edges: which way they went, and how many are taken.

use protocol::Edge;

/// The direction of an edge of an input that captures both.
///
/// `level` is the pin's level after the capture, `more` whether another edge
/// was captured by then. Without one the level is what this edge led to; with
/// one it is what the next led to. (More than one is an over-capture, for
/// which this edge and the next are marked.)
#[must_use]
pub const fn direction(level: bool, more: bool) -> Edge {
    if level != more {
        Edge::Rising
    } else {
        Edge::Falling
    }
}

/// Limits how many edges are taken: a bucket that holds `burst` and regains one
/// every `refill` ticks. An input that oscillates can so never keep the core
/// busy with its handler.
#[derive(Clone, Copy, Debug)]
pub struct Bucket {
    tokens: u32,
    /// Counter value up to which tokens were regained.
    at: u32,
    burst: u32,
    refill: u32,
}

impl Bucket {
    /// A full bucket.
    #[must_use]
    pub const fn new(burst: u32, refill: u32) -> Self {
        Self {
            tokens: burst,
            at: 0,
            burst,
            refill,
        }
    }

    /// Takes a token at counter value `now`. Returns false if none was left: the edge is still
    /// valid, but the input must then be switched off for a while.
    pub const fn take(&mut self, now: u32) -> bool {
        let gained = now.wrapping_sub(self.at) / self.refill;
        self.at = self.at.wrapping_add(gained.wrapping_mul(self.refill));
        self.tokens = self.tokens.saturating_add(gained);
        if self.tokens > self.burst {
            self.tokens = self.burst;
        }
        match self.tokens.checked_sub(1) {
            Some(rest) => {
                self.tokens = rest;
                rest > 0
            }
            None => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{MUTE_MS, STROBE_BURST, STROBE_REFILL, TICKS_PER_US};

    #[test]
    fn the_level_tells_the_direction() {
        assert_eq!(direction(true, false), Edge::Rising);
        assert_eq!(direction(false, false), Edge::Falling);
        assert_eq!(direction(false, true), Edge::Rising);
        assert_eq!(direction(true, true), Edge::Falling);
    }

    /// 9 pulses of 125 µs at a pitch of 1,575 µs, at 30 fps and over a wrap.
    #[test]
    fn the_cameras_pulses_never_empty_the_bucket() {
        let mut bucket = Bucket::new(STROBE_BURST, STROBE_REFILL);
        let mut frame = u32::MAX - 100_000_000;
        for _ in 0..1000 {
            for pulse in 0..9 {
                let rise = frame.wrapping_add(pulse * 1_575 * TICKS_PER_US);
                assert!(bucket.take(rise));
                assert!(bucket.take(rise.wrapping_add(125 * TICKS_PER_US)));
            }
            frame = frame.wrapping_add(1_600_000);
        }
    }

    #[test]
    fn a_flood_is_cut_to_the_rate_of_refill() {
        let mut bucket = Bucket::new(STROBE_BURST, STROBE_REFILL);
        let mut now = 0_u32;
        let mut taken = 0;
        let mute = MUTE_MS as u32 * 1000 * TICKS_PER_US;
        let second = 48_000_000;
        while now < 2 * second {
            // 100 kHz, both edges.
            now += 5 * TICKS_PER_US;
            taken += 1;
            if !bucket.take(now) {
                now += mute;
            }
        }
        assert!(taken <= 2 * 2_000 + STROBE_BURST + 100, "{taken}");
        assert!(taken > 3_000, "{taken}");
    }
}
