//! Gyroscope recordings of board and phone for the estimator. Differences of
//! times are taken in integers.

use protocol::units::Ticks;
use twist_sync::GyroTrack;

use crate::PhoneNanos;

/// Returns the track of the phone's samples: times, and rates in rad/s about x, y, z.
#[must_use]
pub fn phone_track(samples: impl IntoIterator<Item = (PhoneNanos, [f64; 3])>) -> GyroTrack {
    let samples = samples.into_iter().map(|(time, rate)| (time.0, rate));
    let (nanos, rates): (Vec<i64>, Vec<[f64; 3]>) = samples.unzip();
    GyroTrack::from_nanos(&nanos, rates)
}

/// Returns the track of the board's samples: times, and rates in rad/s about x, y, z.
#[must_use]
pub fn board_track(samples: impl IntoIterator<Item = (Ticks, [f64; 3])>) -> GyroTrack {
    let mut track = GyroTrack::default();
    let mut first = None;
    for (at, rate) in samples {
        push_board_sample(&mut track, *first.get_or_insert(at), at, rate);
    }
    track
}

/// Appends a sample to a track of the board whose first sample is at `first`; rates in rad/s about
/// x, y, z.
pub fn push_board_sample(track: &mut GyroTrack, first: Ticks, at: Ticks, rate: [f64; 3]) {
    track.epoch_s = first.as_secs_f64();
    track.t.push((at - first).as_secs_f64());
    track.w.push(rate);
}
