//! The settings of a session.

use std::path::PathBuf;
use std::time::Duration;

use protocol::TICK_HZ;

/// Time for which a calibration flashes the LED at the phone, ticks.
pub const LED_TICKS: u64 = seconds(60);

/// The settings of a session. Times are ticks of board time.
#[derive(Clone, Debug)]
pub struct Options {
    /// Folder in which the recording's folder is created.
    pub out: PathBuf,
    /// Name of the recording's folder; `None` for date and time.
    pub name: Option<String>,
    /// Length of the recording, ticks; `None` to record until stopped.
    pub duration: Option<u64>,
    /// Longest wait for a lost link, on the link's clock.
    pub link_patience: Duration,
    /// Marks to set, each as the time since the start of the recording, ticks.
    pub markers: Vec<u64>,
    /// The condition for following the phone's clock.
    pub track: Track,
    /// Number of twists before the recording.
    pub twists: u32,
    /// Pause between two of these twists, ticks.
    pub twist_gap: u64,
    /// Time for which the LED of a calibration flashes at the phone, ticks; 0 for none.
    pub led: u64,
    /// True to twist again at the end.
    pub second_twist: bool,
    /// True to download the phones' videos at the end.
    pub fetch_video: bool,
    /// True to copy the phones' other files at the end.
    pub fetch_files: bool,
    /// True to record every raw frame of the link too, for the report of a fault.
    pub raw_link: bool,
    /// Number of the first command to the board, for a simulation that must repeat to the byte;
    /// `None` for any number.
    pub first_command: Option<u32>,
}

impl Options {
    /// Returns the settings for one twist, and a recording into this folder until stopped.
    #[must_use]
    pub const fn into_folder(out: PathBuf) -> Self {
        Self {
            out,
            name: None,
            duration: None,
            link_patience: Duration::from_secs(60),
            markers: Vec::new(),
            track: Track::IfThere,
            twists: 1,
            twist_gap: seconds(60),
            led: 0,
            second_twist: false,
            fetch_video: false,
            fetch_files: true,
            raw_link: false,
            first_command: None,
        }
    }
}

/// The condition for following the phone's clock during a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Track {
    /// Follow it if it can be read.
    #[default]
    IfThere,
    /// Follow it, and fail if it cannot be read.
    Always,
    /// Do not follow it.
    Never,
}

/// Converts seconds of board time to ticks.
#[must_use]
pub const fn seconds(seconds: u64) -> u64 {
    seconds.saturating_mul(TICK_HZ as u64)
}
