//! The relation of board time and phone time: the only way from one to the other.
//!
//! The convention of the whole project:
//! `phone = board + offset + skew · (board − reference)`. The arithmetic is
//! [`ClockRelation`]'s, with the board as clock a and the phone as clock b.

use protocol::units::Ticks;
use serde::{Deserialize, Serialize};
use twist_sync::{ClockRelation, Wander, WithSigma};

use crate::{BoardSeconds, PhoneNanos, PhoneSeconds};

/// The relation of board time and phone time with its uncertainty.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ClockModel {
    /// The board time at which `offset` holds.
    pub reference: BoardSeconds,
    /// Phone minus board at the reference, in seconds.
    pub offset: f64,
    /// Rate of the phone's clock relative to the board's, minus one.
    pub skew: f64,
    /// Covariance of (offset, skew): s², s; s, 1.
    pub covariance: [[f64; 2]; 2],
    /// How much the skew may change from now on.
    pub wander: Wander,
}

impl From<ClockRelation> for ClockModel {
    fn from(relation: ClockRelation) -> Self {
        Self {
            reference: BoardSeconds(relation.reference),
            offset: relation.offset,
            skew: relation.skew,
            covariance: relation.covariance,
            wander: relation.wander,
        }
    }
}

impl From<ClockModel> for ClockRelation {
    fn from(model: ClockModel) -> Self {
        Self {
            reference: model.reference.0,
            offset: model.offset,
            skew: model.skew,
            covariance: model.covariance,
            wander: model.wander,
        }
    }
}

impl ClockModel {
    fn relation(&self) -> ClockRelation {
        (*self).into()
    }

    /// The offset (phone − board) at a board time, with a sigma that grows with
    /// the distance from the reference.
    #[must_use]
    pub fn offset_at(&self, board: BoardSeconds) -> WithSigma {
        self.relation().offset_at(board.0)
    }

    /// Sigma of the skew at a board time, with the wander since the reference.
    #[must_use]
    pub fn skew_sigma_at(&self, board: BoardSeconds) -> f64 {
        self.relation().skew_sigma_at(board.0)
    }

    /// The phone's time at a board time.
    #[must_use]
    pub fn to_phone(&self, board: BoardSeconds) -> PhoneSeconds {
        PhoneSeconds(self.relation().a_to_b(board.0))
    }

    /// The phone's nanoseconds at a tick of the board.
    #[must_use]
    pub fn ticks_to_phone(&self, ticks: Ticks) -> PhoneNanos {
        self.to_phone(ticks.into()).nanos()
    }

    /// The board time at a phone time (exact inverse of [`Self::to_phone`]).
    #[must_use]
    pub fn to_board(&self, phone: PhoneSeconds) -> BoardSeconds {
        BoardSeconds(self.relation().b_to_a(phone.0))
    }

    /// The same relation with its reference moved to `board`: a prediction, with
    /// the covariance grown by the wander over the distance.
    #[must_use]
    pub fn referenced_at(&self, board: BoardSeconds) -> Self {
        self.relation().referenced_at(board.0).into()
    }

    /// Joins two estimates of the same pair of clocks taken at different times: see
    /// [`ClockRelation::joined`].
    #[must_use]
    pub fn joined(&self, other: &Self) -> Self {
        self.relation().joined(&other.relation()).into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_two_directions_are_inverse_to_a_tick() {
        let m = ClockModel {
            reference: BoardSeconds(1264.0),
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
