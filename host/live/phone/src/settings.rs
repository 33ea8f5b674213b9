//! Deadlines and cancellation of a client.

use std::time::Duration;

use system::Cancel;

/// Deadlines of a client, and its cancellation.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Longest time for connecting.
    pub connect: Duration,
    /// Longest wait for an answer beyond the time that the request itself takes, which is the
    /// duration of an IMU recording and up to 10 s for `video_start`. Also the longest pause
    /// within a download.
    pub margin: Duration,
    /// Time for which an IMU recording is retried while the app's sensors are busy. After a video
    /// they are, until its capture session closes, some time after `video_stop`.
    pub busy: Duration,
    /// Longest wait until the app is free for `get_video`, and again until it answers.
    pub video_ready: Duration,
    /// Ends a request with [`PhoneError::Cancelled`](crate::PhoneError::Cancelled) within about
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
