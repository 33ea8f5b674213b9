//! Typed access to the relation of board time and phone time: the only way from one to the other.
//!
//! The convention of the whole project, with the board as clock a of a [`ClockRelation`] and the
//! phone as clock b: `phone = board + offset + skew · (board − reference)`.

use protocol::units::Ticks;
use twist_sync::ClockRelation;

use crate::{BoardSeconds, PhoneNanos, PhoneSeconds};

/// Conversions by a relation whose clock a is the board's and whose clock b is a phone's.
pub trait BoardToPhone {
    /// Returns the phone's time at a board time.
    #[must_use]
    fn to_phone(&self, board: BoardSeconds) -> PhoneSeconds;

    /// Returns the phone's time at a tick of the board.
    #[must_use]
    fn ticks_to_phone(&self, ticks: Ticks) -> PhoneNanos {
        self.to_phone(ticks.into()).nanos()
    }

    /// Returns the board time at a phone time, as the exact inverse of [`Self::to_phone`].
    #[must_use]
    fn to_board(&self, phone: PhoneSeconds) -> BoardSeconds;
}

impl BoardToPhone for ClockRelation {
    fn to_phone(&self, board: BoardSeconds) -> PhoneSeconds {
        PhoneSeconds(self.a_to_b(board.0))
    }

    fn to_board(&self, phone: PhoneSeconds) -> BoardSeconds {
        BoardSeconds(self.b_to_a(phone.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Wander;

    #[test]
    fn the_two_directions_are_inverse_to_a_tick() {
        let m = ClockRelation {
            reference: 1264.0,
            offset: 947_848.638,
            skew: 40e-6,
            covariance: [[4e-12, 0.0], [0.0, 4e-12]],
            wander: Wander::from_ppm(0.02),
        };
        for ticks in [0, 1, 48_000_000 * 60, 48_000_000 * 86_400] {
            let there = m.ticks_to_phone(Ticks(ticks));
            let back = m.to_board(there.seconds()).ticks();
            assert!((back - Ticks(ticks)).unsigned_abs() <= 1, "{ticks}");
        }
    }
}
