//! The gyroscope of any recording, by what the file begins with:
//!
//! | file | what is read |
//! |---|---|
//! | CSV | [`phone::gyro_csv`]: a header in any of many forms (EuRoC's `imu.csv` and Sensor Logger's `Gyroscope.csv` among them), or the phone app's |
//! | MCAP (ours, ROS 2 bags) | messages of type `sensor_msgs/msg/Imu` in CDR |
//! | ROS 1 bag | messages of type `sensor_msgs/Imu` |
//! | Matroska of the Azure Kinect | its IMU track |
//!
//! Times are those in the messages' headers, in the device's own clock, never when a
//! recorder received them. Of a folder the one recording in it is read. Everything is
//! in memory: 32 bytes a sample.
//!
//! Limits: no `sqlite3` bags.

mod ros;

use std::io::Read as _;
use std::path::{Path, PathBuf};

use extract::mkv::k4a::{Content, K4aError, Recording as Kinect};
use phone::gyro_csv::{self, CsvError};
use twist_sync::GyroTrack;

/// A gyroscope's recording.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GyroRecording {
    /// What the file was, in words.
    pub form: String,
    /// Times in nanoseconds of the device's clock.
    pub times: Vec<i64>,
    /// Angular rates about x, y, z in rad/s; as many as times.
    pub rates: Vec<[f64; 3]>,
    /// What could not be read of it.
    pub damage: Vec<String>,
}

impl GyroRecording {
    /// The first time, nanoseconds; 0 without samples.
    #[must_use]
    pub fn first(&self) -> i64 {
        self.times.first().copied().unwrap_or(0)
    }

    /// The samples with times from the first one on, so that no digits are lost in a clock
    /// that counts from 1970.
    #[must_use]
    pub fn track(&self) -> GyroTrack {
        let since = |time: &i64| time.saturating_sub(self.first());
        let times: Vec<i64> = self.times.iter().map(since).collect();
        GyroTrack::from_nanos(&times, self.rates.clone())
    }
}

/// Why a file gives no gyroscope.
#[derive(Debug, thiserror::Error)]
pub enum GyroFileError {
    /// It cannot be opened or read.
    #[error("{0}")]
    Io(#[from] std::io::Error),
    /// CSV that is not as expected.
    #[error(transparent)]
    Csv(CsvError),
    /// No ROS 1 bag.
    #[error(transparent)]
    Bag(#[from] extract::bag::reader::BagError),
    /// No recording of an Azure Kinect.
    #[error(transparent)]
    Kinect(#[from] K4aError),
    /// No MCAP file, or one that breaks off at once.
    #[error("this MCAP file cannot be read: {0}")]
    Mcap(String),
    /// There are no samples of a gyroscope in it.
    #[error("{form} without samples of a gyroscope: {found}")]
    None {
        /// What the file is.
        form: &'static str,
        /// What is in it instead.
        found: String,
    },
    /// There are several gyroscopes in it.
    #[error("several gyroscopes: {}", .0.join(", "))]
    Several(Vec<String>),
    /// A kind of file that is known, but not read.
    #[error("{0} is not read")]
    NotRead(&'static str),
}

impl From<CsvError> for GyroFileError {
    fn from(error: CsvError) -> Self {
        match error {
            CsvError::Io(error) => Self::Io(error),
            other => Self::Csv(other),
        }
    }
}

/// Reads a recording. `topic` chooses one where there are several; of files without
/// topics it is ignored.
///
/// # Errors
///
/// The file cannot be read, is of no known kind, or holds none or several gyroscopes.
pub fn read(path: &Path, topic: Option<&str>) -> Result<GyroRecording, GyroFileError> {
    if path.is_dir() {
        return read(&only_recording(path)?, topic);
    }
    let mut first = Vec::new();
    files::open(path)?.take(16).read_to_end(&mut first)?;
    if first.starts_with(mcap::MAGIC) {
        ros::mcap(path, topic)
    } else if first.starts_with(b"#ROSBAG V") {
        ros::bag(path, topic)
    } else if first.starts_with(&[0x1a, 0x45, 0xdf, 0xa3]) {
        kinect(path)
    } else if first.starts_with(b"SQLite format 3") {
        Err(GyroFileError::NotRead("a ROS 2 bag of storage sqlite3"))
    } else if first.get(4..8) == Some(b"ftyp") {
        Err(GyroFileError::NotRead(
            "a video with the metadata of its camera",
        ))
    } else {
        csv(path)
    }
}

/// The one recording in a folder: ours, or a bag.
fn only_recording(folder: &Path) -> Result<PathBuf, GyroFileError> {
    let ours = folder.join(recording::MCAP_FILE);
    if ours.is_file() {
        return Ok(ours);
    }
    let is_recording = |path: &PathBuf| {
        let extension = path.extension().and_then(|text| text.to_str());
        matches!(extension, Some("mcap" | "bag" | "mkv"))
    };
    let entries = std::fs::read_dir(folder)?;
    let paths: Result<Vec<PathBuf>, _> = entries.map(|e| e.map(|e| e.path())).collect();
    let mut found: Vec<PathBuf> = paths?.into_iter().filter(is_recording).collect();
    found.sort();
    match found.as_slice() {
        [only] => Ok(only.clone()),
        [] => Err(GyroFileError::None {
            form: "a folder",
            found: String::from("expected one file .mcap, .bag or .mkv"),
        }),
        several => {
            let names = several.iter().map(|path| path.display().to_string());
            Err(GyroFileError::Several(names.collect()))
        }
    }
}

fn csv(path: &Path) -> Result<GyroRecording, GyroFileError> {
    let file = gyro_csv::read_file(path)?;
    Ok(GyroRecording {
        form: file.form.to_string(),
        times: file.times,
        rates: file.track.w,
        damage: Vec::new(),
    })
}

fn kinect(path: &Path) -> Result<GyroRecording, GyroFileError> {
    let mut file = Kinect::open(path)?;
    let mut out = GyroRecording {
        form: String::from("Azure Kinect: its IMU track, in device time"),
        ..GyroRecording::default()
    };
    while let Some(batch) = file.next_batch(Content::Times)? {
        for sample in batch.imu {
            out.times.push(sample.gyro_at.0);
            out.rates.push(sample.gyro.map(f64::from));
        }
    }
    out.damage = file.damage().iter().map(ToString::to_string).collect();
    if out.times.is_empty() {
        return Err(GyroFileError::None {
            form: "an Azure Kinect recording",
            found: String::from("it has no IMU track (record with --imu ON)"),
        });
    }
    Ok(out)
}
