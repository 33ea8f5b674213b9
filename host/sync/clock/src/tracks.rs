//! Gyroscope recordings of board and phone as the estimator takes them. Differences of
//! times are taken in integers.

use protocol::units::Ticks;
use twist_sync::GyroTrack;

use crate::PhoneNanos;

/// The phone's recording: as many rates (rad/s about x, y, z) as times.
#[must_use]
pub fn phone_track(times: &[PhoneNanos], w: Vec<[f64; 3]>) -> GyroTrack {
    let nanos: Vec<i64> = times.iter().map(|time| time.0).collect();
    GyroTrack::from_nanos(&nanos, w)
}

/// The board's recording: as many rates (rad/s about x, y, z) as times.
#[must_use]
pub fn board_track(times: &[Ticks], w: Vec<[f64; 3]>) -> GyroTrack {
    let epoch = times.first().copied().unwrap_or_default();
    GyroTrack {
        epoch_s: epoch.as_secs_f64(),
        t: times.iter().map(|&t| (t - epoch).as_secs_f64()).collect(),
        w,
    }
}
