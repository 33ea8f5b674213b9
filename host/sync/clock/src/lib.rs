//! The clocks of board and phone: their relation, the alignment of the trigger to the phone's
//! frames, and its steering. No I/O and no state of a session.
//!
//! The times of phone and board are types that do not mix: integers at the edges ([`Ticks`] of the board, [`PhoneNanos`]), seconds in
//! f64 inside the math. An f64 second holds 0.12 ns at 10⁶ s (twelve days of
//! uptime), far below one tick (20.8 ns). The only way from one clock to the
//! other is [`BoardToPhone`].
//!
//! | module | content |
//! |---|---|
//! | [`twists`] | several twists joined, and the estimator's findings about one |
//! | [`rates`] | the rate of the clocks and its change, predicted from twists |
//! | [`frames`] | the period of the phone's frames |
//! | [`alignment`] | the grid of trigger edges on the phone's frames |
//! | [`steering`] | the period that keeps the trigger on that grid |
//! | [`tracker`] | a known offset, followed by exchanges with the clocks |
//! | [`coach`] | the accuracy of a twist, predicted while it is made |

pub mod alignment;
pub mod coach;
pub mod frames;
pub mod rates;
mod relation;
pub mod steering;
pub mod tracker;
mod tracks;
pub mod twists;

pub use relation::BoardToPhone;
pub use tracks::{board_track, phone_track, push_board_sample};
pub use twist_sync::{ClockRelation, Wander, WithSigma};

use protocol::units::{TICK_HZ, Ticks};
use serde::{Deserialize, Serialize};

/// An instant of the phone's boot clock in nanoseconds
/// (`SystemClock.elapsedRealtimeNanos`).
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
#[serde(transparent)]
pub struct PhoneNanos(pub i64);

/// An instant of the phone's boot clock in seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(transparent)]
pub struct PhoneSeconds(pub f64);

/// An instant of board time in seconds since the board's reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(transparent)]
pub struct BoardSeconds(pub f64);

impl PhoneNanos {
    /// Returns the same instant in seconds.
    #[must_use]
    pub fn seconds(self) -> PhoneSeconds {
        // Whole seconds and remainder apart: the quotient is exact, so the sum
        // is rounded once only.
        let whole = self.0.div_euclid(1_000_000_000);
        let rest = self.0.rem_euclid(1_000_000_000);
        PhoneSeconds(whole as f64 + rest as f64 * 1e-9)
    }
}

impl PhoneSeconds {
    /// Returns the nearest nanosecond; saturates at the ends of i64, not-a-number becomes 0.
    #[must_use]
    pub fn nanos(self) -> PhoneNanos {
        PhoneNanos((self.0 * 1e9).round() as i64)
    }
}

impl BoardSeconds {
    /// Returns the nearest tick; times before reset become tick 0.
    #[must_use]
    pub fn ticks(self) -> Ticks {
        Ticks((self.0 * f64::from(TICK_HZ)).round() as u64)
    }
}

impl From<Ticks> for BoardSeconds {
    fn from(ticks: Ticks) -> Self {
        Self(ticks.as_secs_f64())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conversions_round_to_nearest() {
        let late = PhoneNanos(949_113_215_987_860);
        assert!((late.seconds().0 - 949_113.215_987_86).abs() < 1.2e-10);
        assert!((late.seconds().nanos().0 - late.0).abs() <= 1);
        assert_eq!(PhoneNanos(-1).seconds().nanos(), PhoneNanos(-1));
        assert_eq!(BoardSeconds(1.0).ticks(), Ticks(48_000_000));
        assert_eq!(BoardSeconds(-3.0).ticks(), Ticks(0));
        assert_eq!(BoardSeconds::from(Ticks(24_000_000)).0, 0.5);
    }
}
