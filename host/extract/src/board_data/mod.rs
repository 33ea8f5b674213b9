//! What the board recorded, from our own recordings and from the published
//! system's bags, as one stream of events in board time.
//!
//! A stream is read front to back and can be opened again ([`BoardInput::open`]):
//! the extraction goes over it more than once instead of keeping it in memory.

mod bag;
mod mcap;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::depth_clock::PulseTime;
use super::time::BoardNanos;
use timebase::ClockModel;
use twist_sync::tracker::{Asked, Exchange};

/// Topics of further outputs begin so; the sensor's name follows.
pub(crate) const OUTPUT_TOPICS: &str = "/output/";

/// Pulses per second with the UTC that a lidar was told.
pub(crate) const LIDAR_TOPIC: &str = "/mcu_lidar_ts";

/// One sample of the board's IMU.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ImuRow {
    /// The data-ready edge; the filter's delay is not subtracted.
    pub(crate) at: BoardNanos,
    /// rad/s.
    pub(crate) gyro: [f64; 3],
    /// m/s².
    pub(crate) accel: [f64; 3],
    /// °C.
    pub(crate) temperature: Option<f64>,
}

/// A pair of times of one instant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct TimePair {
    /// The topic that it came on.
    pub(crate) topic: Arc<str>,
    /// Counted by the publisher.
    pub(crate) seq: u32,
    /// Board time.
    pub(crate) stamp: BoardNanos,
    /// The other time, in ns.
    pub(crate) other: i64,
}

/// A depth image of a bag.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct BagImage {
    /// Its stamp: the depth camera's clock, as the driver gives it.
    pub(crate) stamp: i64,
    /// Pixels in a row.
    pub(crate) width: u32,
    /// Rows.
    pub(crate) height: u32,
    /// Big-endian 16-bit pixels in mm.
    pub(crate) pixels: Vec<u8>,
}

/// Something that the board recorded.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum BoardEvent {
    /// A sample of the IMU.
    Imu(ImuRow),
    /// A trigger pulse.
    Pulse(PulseTime),
    /// The beginning of a sequence.
    Mark(BoardNanos),
    /// A pair of times.
    Times(TimePair),
    /// A relation of phone and board that the session found: of the phone that the
    /// trigger was aligned to, or of a further one by its name.
    Clock(Option<String>, ClockModel),
    /// A clock was asked for its time: the phone's or, as a, the board's.
    Exchange(Asked, Exchange),
    /// A depth image (bags only).
    Image(BagImage),
}

/// Why a recording cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum BoardError {
    /// It cannot be opened.
    #[error("opening {path}: {error}")]
    Open {
        /// Which.
        path: PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// A bag that cannot be read.
    #[error("{path}: {error}")]
    Bag {
        /// Which.
        path: PathBuf,
        /// Why.
        error: super::bag::reader::BagError,
    },
    /// Our own recording cannot be read.
    #[error(transparent)]
    Recording(#[from] recording::RecordingError),
    /// A topic with another type than the published system's.
    #[error("topic {topic} has type {found}; expected {expected}")]
    OtherType {
        /// The topic.
        topic: String,
        /// Its type.
        found: String,
        /// The published system's type.
        expected: &'static str,
    },
}

/// Where the board's recording lies.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum BoardInput {
    /// Our own `recording.mcap`.
    Mcap(PathBuf),
    /// A ROS 1 bag of the published system.
    Bag(PathBuf),
}

/// Events one after the other.
pub(crate) trait BoardStream: Send {
    /// The next event; `None` at the end.
    ///
    /// # Errors
    ///
    /// Reading fails. Damage is no error: see [`BoardStream::damage`].
    fn next_event(&mut self) -> Result<Option<BoardEvent>, BoardError>;

    /// What could not be read so far, in words.
    fn damage(&self) -> Vec<String>;

    /// Bytes read so far.
    fn position(&self) -> u64;
}

/// What is wanted of a stream: images are large.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Images {
    /// Images with pixels.
    Pixels,
    /// Images with their stamps only.
    Stamps,
    /// No images.
    Skip,
}

impl BoardInput {
    /// The file.
    pub(crate) fn path(&self) -> &Path {
        match self {
            Self::Mcap(path) | Self::Bag(path) => path,
        }
    }

    /// Opens the recording at its beginning.
    ///
    /// # Errors
    ///
    /// It cannot be opened or is of another kind.
    pub(crate) fn open(&self, images: Images) -> Result<Box<dyn BoardStream>, BoardError> {
        match self {
            Self::Mcap(path) => Ok(Box::new(mcap::McapStream::open(path)?)),
            Self::Bag(path) => Ok(Box::new(bag::BagStream::open(path, images)?)),
        }
    }
}
