//! The wishes for a session.

use std::path::PathBuf;
use std::time::Duration;

use protocol::TICK_HZ;

/// What a session is asked to do. Times are ticks of board time.
#[derive(Clone, Debug)]
pub struct Options {
    /// Folder in which the recording's folder is made.
    pub out: PathBuf,
    /// Name of the recording's folder; date and time if there is none.
    pub name: Option<String>,
    /// How long to record, ticks; until stopped if there is none.
    pub duration: Option<u64>,
    /// How long to wait for a lost link to come back, on the link's clock.
    pub link_patience: Duration,
    /// Marks to set so long after the start, ticks.
    pub markers: Vec<u64>,
    /// Whether the phone's clock is to be followed.
    pub track: Track,
    /// Twists before the recording.
    pub twists: u32,
    /// Between two of these twists, ticks.
    pub twist_gap: u64,
    /// Twist again at the end.
    pub second_twist: bool,
    /// Download the phones' videos at the end.
    pub fetch_video: bool,
    /// Copy the phones' other files at the end.
    pub fetch_files: bool,
    /// Record every frame of the link as it came, for the report of a fault.
    pub raw_link: bool,
    /// Number of the first command to the board, for a simulation that is to repeat to the
    /// byte; any number if there is none.
    pub first_command: Option<u32>,
}

impl Options {
    /// One twist, and a recording into this folder until it is stopped.
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
            second_twist: false,
            fetch_video: false,
            fetch_files: true,
            raw_link: false,
            first_command: None,
        }
    }
}

/// Whether the phone's clock is to be followed while it records.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Track {
    /// Where it can be.
    #[default]
    IfThere,
    /// It is an error if it cannot be.
    Always,
    /// Never.
    Never,
}

/// Seconds of board time as ticks.
#[must_use]
pub const fn seconds(seconds: u64) -> u64 {
    seconds.saturating_mul(TICK_HZ as u64)
}
