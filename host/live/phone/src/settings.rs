//! How long a client waits, and what ends its waiting.

use std::time::Duration;

use system::Cancel;

/// Deadlines and limits of a client.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Longest time to connect.
    pub connect: Duration,
    /// Patience beyond the time that a request takes by its nature: an IMU
    /// recording its duration, `video_start` the app's own 10 s. Also the
    /// longest pause within a download.
    pub margin: Duration,
    /// How long an IMU recording is tried again while the app's sensors are still those of
    /// a video: they end when its capture session closes, a while after `video_stop`.
    pub busy: Duration,
    /// How long the app may take to be free for `get_video`, and then to begin it.
    pub video_ready: Duration,
    /// Ends a request under way, with [`PhoneError::Cancelled`](crate::PhoneError::Cancelled), within about
    /// 100 ms.
    pub cancel: Cancel,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            connect: Duration::from_secs(5),
            margin: Duration::from_secs(15),
            busy: Duration::from_secs(6),
            video_ready: Duration::from_secs(120),
            cancel: Cancel::default(),
        }
    }
}
