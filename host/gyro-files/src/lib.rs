//! The gyroscope of any recording, by what the file begins with:
//!
//! | file | what is read |
//! |---|---|
//! | CSV | [`phone::gyro_csv`]: a header in any of many forms (EuRoC's `imu.csv` and Sensor Logger's `Gyroscope.csv` among them), or the phone app's |
//! | MCAP (ours, ROS 2 bags) | messages of type `sensor_msgs/msg/Imu` in CDR |
//! | Matroska of the Azure Kinect | its IMU track |
//! | MP4 of GoPro cameras | the gyroscope's stream, and times and exposures of the frames |
//! | videos and logs of other makers | what the Python package `telemetry-parser` finds |
//!
//! Times are those in the messages' headers, in the device's own clock, never when a
//! recorder received them. Of a folder the one recording in it is read. Everything is
//! in memory: 32 bytes a sample.

mod gopro;
mod mp4;
mod ros;
mod telemetry;

use std::io::Read as _;
use std::path::{Path, PathBuf};

use formats::k4a::{Content, K4aError, Recording as Kinect};
use phone::gyro_csv::{self, CsvError};
use recording::RecordingError;
use recording::bag::{foreign, is_bag};
use twist_sync::GyroTrack;

pub use telemetry::TelemetryError;

/// A gyroscope's recording.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GyroRecording {
    /// What the file was, in words.
    pub form: String,
    /// Times in nanoseconds of the device's clock.
    pub times: Vec<i64>,
    /// Angular rates about x, y, z in rad/s; as many as times.
    pub rates: Vec<[f64; 3]>,
    /// Frames of the camera, if the file has their exposure and read-out.
    pub frames: Vec<Frame>,
    /// The times follow from a first and a last one that are whole multiples of this,
    /// nanoseconds, and so is what the clock is known to.
    pub stamp_step_ns: Option<i64>,
    /// What could not be read of it.
    pub damage: Vec<String>,
}

/// A frame of a rolling shutter, in nanoseconds of the device's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    /// When its first row begins to be exposed.
    pub start_ns: i64,
    /// How long each row is exposed.
    pub exposure_ns: i64,
    /// From the first row to the last.
    pub readout_ns: i64,
}

impl Frame {
    /// Middle of exposure of its first, middle and last row, nanoseconds.
    #[must_use]
    pub const fn rows_ns(&self) -> [i64; 3] {
        let first = self.start_ns.saturating_add(self.exposure_ns / 2);
        [
            first,
            first.saturating_add(self.readout_ns / 2),
            first.saturating_add(self.readout_ns),
        ]
    }
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
    /// No recording of ours and no bag that is read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// No recording of an Azure Kinect.
    #[error(transparent)]
    Kinect(#[from] K4aError),
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
    /// There are several recordings in the folder.
    #[error("several recordings: {}", .0.join(", "))]
    SeveralFiles(Vec<String>),
    /// A kind of file that is known, but not read.
    #[error("{0} is not read")]
    NotRead(&'static str),
    /// A recording that [`read_alone`] leaves to another program.
    #[error("{what} is not read without another program")]
    OtherMaker {
        /// The file; of a folder, the one in it.
        path: PathBuf,
        /// What it seems to be.
        what: &'static str,
    },
    /// The other program gives none.
    #[error("{what}: {error}")]
    Telemetry {
        /// What the file seems to be.
        what: &'static str,
        /// Why.
        error: TelemetryError,
    },
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
/// topics it is ignored. Those of makers whose form this crate does not know go to
/// `python3` with the package `telemetry-parser`.
///
/// # Errors
///
/// The file cannot be read, is of no known kind, or holds none or several gyroscopes; or
/// there is no such Python, or it does not give them.
pub fn read(path: &Path, topic: Option<&str>) -> Result<GyroRecording, GyroFileError> {
    match read_alone(path, topic) {
        Err(GyroFileError::OtherMaker { path, what }) => telemetry::read(&path, what),
        read => read,
    }
}

/// As [`read`], but starts no other program.
///
/// # Errors
///
/// Those of [`read`], and [`GyroFileError::OtherMaker`].
pub fn read_alone(path: &Path, topic: Option<&str>) -> Result<GyroRecording, GyroFileError> {
    if path.is_dir() && !is_bag(path) {
        return read_alone(&only_recording(path)?, topic);
    }
    let mut read = read_any(path, topic)?;
    let samples = read.times.len();
    let all = std::mem::take(&mut read.times)
        .into_iter()
        .zip(std::mem::take(&mut read.rates));
    let finite = all.filter(|(_, rate)| rate.iter().all(|rate| rate.is_finite()));
    (read.times, read.rates) = finite.unzip();
    let left_out = samples - read.times.len();
    if left_out > 0 {
        let text = format!("{left_out} samples are no numbers and are left out");
        read.damage.push(text);
    }
    Ok(read)
}

fn read_any(path: &Path, topic: Option<&str>) -> Result<GyroRecording, GyroFileError> {
    let mut first = Vec::new();
    if path.is_file() {
        files::open(path)?.take(16).read_to_end(&mut first)?;
    }
    if path.is_dir() || first.starts_with(mcap::MAGIC) {
        ros::bag(path, topic)
    } else if first.starts_with(b"#ROSBAG V") {
        Err(foreign(path, "a ROS 1 bag").into())
    } else if first.starts_with(b"SQLite format 3\0") {
        Err(foreign(path, "a ROS 2 bag in sqlite3").into())
    } else if first.starts_with(&[0x1a, 0x45, 0xdf, 0xa3]) {
        kinect(path)
    } else if first.get(4..8) == Some(b"ftyp") {
        gopro::read(path)
    } else if telemetry::is_known(&first) {
        Err(GyroFileError::OtherMaker {
            path: path.to_owned(),
            what: "a recording of another maker",
        })
    } else if first.starts_with(b"PK\x03\x04") {
        Err(GyroFileError::NotRead("a zip archive"))
    } else {
        csv(path)
    }
}

/// The one recording in a folder that is no bag: ours, what Sensor Logger exports, or any.
fn only_recording(folder: &Path) -> Result<PathBuf, GyroFileError> {
    for name in [recording::MCAP_FILE, "Gyroscope.csv"] {
        let file = folder.join(name);
        if file.is_file() {
            return Ok(file);
        }
    }
    let entries = std::fs::read_dir(folder)?;
    let paths: Result<Vec<PathBuf>, _> = entries.map(|e| e.map(|e| e.path())).collect();
    let paths = paths?;
    let with = |endings: &[&str]| {
        let is_one = |path: &&PathBuf| {
            let extension = path.extension().and_then(|text| text.to_str());
            let extension = extension.unwrap_or_default().to_ascii_lowercase();
            endings.contains(&extension.as_str())
        };
        paths.iter().filter(is_one).cloned().collect::<Vec<_>>()
    };
    let mut found = with(&["mcap", "mkv"]);
    // A phone's video lies beside many a recording.
    if found.is_empty() {
        found = with(&["mp4"]);
    }
    found.sort();
    match found.as_slice() {
        [only] => Ok(only.clone()),
        [] => Err(GyroFileError::None {
            form: "a folder",
            found: String::from("expected one file .mcap, .mkv or .mp4, or Gyroscope.csv"),
        }),
        several => {
            let names = several.iter().map(|path| path.display().to_string());
            Err(GyroFileError::SeveralFiles(names.collect()))
        }
    }
}

fn csv(path: &Path) -> Result<GyroRecording, GyroFileError> {
    let file = gyro_csv::read_file(path)?;
    Ok(GyroRecording {
        form: file.form.to_string(),
        times: file.times,
        rates: file.track.w,
        ..GyroRecording::default()
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
    out.damage = file.damage().to_vec();
    if out.times.is_empty() {
        return Err(GyroFileError::None {
            form: "an Azure Kinect recording",
            found: String::from("it has no IMU track (record with --imu ON)"),
        });
    }
    Ok(out)
}
