//! The times of the phone and of the board as types that do not mix.

use serde::{Deserialize, Serialize};

/// An instant of the phone's boot clock in nanoseconds
/// (`SystemClock.elapsedRealtimeNanos`).
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
#[serde(transparent)]
pub struct PhoneNanos(pub i64);
