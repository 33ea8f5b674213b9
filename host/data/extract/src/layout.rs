//! Data set formats: paths and contents of their files.
//!
//! A [`Layout`] defines names, headers and rows; it opens no input and makes no
//! decisions about time. Paths are relative to a sequence's folder. Index files
//! list only images that were written.

mod auxiliary;
mod euroc;
mod kalibr;
mod noise;
mod offset;
mod parts;
mod ros;
mod topics;
mod tum;

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::{Path, PathBuf};

use self::noise::Noise;
use crate::constants::Constants;
use crate::depth::depth_clock::PulseTime;
use crate::geometry::{Cameras, View};
use crate::inputs::board_data::{Reference, TimePair};
use crate::time::{BoardNanos, in_name};

/// Format of a data set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// EuRoC / ASL: `mav0/cam0`, `imu0`, `imu1`, `depth0`.
    Euroc,
    /// TUM RGB-D: `rgb`, `depth`, `associations.txt`.
    Tum,
    /// One folder per topic, like the published extractor.
    Topics,
    /// Input of Kalibr's bag creator: `kalibr/cam0`, `kalibr/imu0.csv`.
    Kalibr,
    /// A ROS 2 bag (MCAP) of images and samples.
    Ros2,
}

impl Format {
    /// Returns the name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Euroc => "euroc",
            Self::Tum => "tum",
            Self::Topics => "topics",
            Self::Kalibr => "kalibr",
            Self::Ros2 => "ros2",
        }
    }

    /// Returns the layout; `view` is the camera into whose view depth images are registered.
    pub(crate) fn layout(self, view: Option<View>) -> &'static dyn Layout {
        match self {
            Self::Euroc => &euroc::Euroc,
            Self::Tum if view == Some(View::Color) => &tum::OF_CAMERA,
            Self::Tum => &tum::OF_PHONE,
            Self::Topics => &topics::Topics,
            Self::Kalibr => &kalibr::Kalibr,
            Self::Ros2 => &ros::Ros2,
        }
    }
}

/// A row of the samples of an IMU.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ImuRow {
    /// Board time.
    pub(crate) at: BoardNanos,
    /// Rates of rotation, rad/s.
    pub(crate) gyro: [f64; 3],
    /// Accelerations, m/s².
    pub(crate) accel: [f64; 3],
    /// Temperature of the sensor, °C, if it is known.
    pub(crate) temperature: Option<f64>,
}

/// CSV file of an IMU's samples.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ImuTable {
    /// Path relative to a sequence's folder.
    pub(crate) path: &'static str,
    /// First lines with their line ends; may be empty.
    pub(crate) header: &'static str,
    /// True to subtract the low-pass delay from the times.
    pub(crate) subtract_delay: bool,
    /// Function that appends a row.
    pub(crate) row: fn(&mut String, &ImuRow),
}

impl ImuTable {
    /// Returns a table of times (less the low-pass delay), rates and accelerations.
    const fn plain(path: &'static str, header: &'static str) -> Self {
        Self {
            path,
            header,
            subtract_delay: true,
            row: imu_row,
        }
    }
}

/// Kind of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ImageKind {
    /// Image of the phone.
    Color,
    /// Depth image.
    Depth,
    /// Infrared image of the depth camera.
    Infrared,
    /// Colour image of the depth camera, one of its JPEG files.
    Camera,
}

/// Written image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ImageRow {
    /// Board time.
    pub(crate) at: BoardNanos,
    /// Stamp on its camera's own clock, ns.
    pub(crate) own: i64,
    /// File relative to the sequence's folder.
    pub(crate) path: PathBuf,
}

/// Facts about a data set, for the files that describe it.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct DataSetInfo {
    /// Rate of the phone's frames, Hz.
    pub(crate) color_rate: Option<f64>,
    /// Rate of the depth frames, Hz.
    pub(crate) depth_rate: Option<f64>,
    /// Rate of the board's IMU, Hz.
    pub(crate) board_imu_rate: Option<f64>,
    /// Rate of the phone's gyroscope, Hz.
    pub(crate) phone_imu_rate: Option<f64>,
    /// Width and height of the phone's images.
    pub(crate) color_size: Option<(u32, u32)>,
    /// Width and height of the depth images as written.
    pub(crate) depth_size: Option<(u32, u32)>,
    /// Width and height of the infrared images.
    pub(crate) infrared_size: Option<(u32, u32)>,
    /// True if depth is registered to the images that it is paired with.
    pub(crate) registered: bool,
    /// Lenses and poses of the cameras.
    pub(crate) cameras: Cameras,
    /// Rate of the depth camera's colour images, Hz.
    pub(crate) camera_rate: Option<f64>,
    /// Width and height of the depth camera's colour images.
    pub(crate) camera_size: Option<(u32, u32)>,
    /// Constants that went into the times.
    pub(crate) constants: Constants,
}

impl DataSetInfo {
    /// Returns name, rate (Hz) and noise of the IMUs of board and phone, with the names of most
    /// formats.
    fn imus(&self) -> [(&'static str, Option<f64>, Noise); 2] {
        [
            (
                "imu0",
                self.board_imu_rate,
                Noise::of_sensor(&self.constants.board_sensor),
            ),
            ("imu1", self.phone_imu_rate, noise::PHONE),
        ]
    }
}

/// Contents of a sequence's index files.
#[derive(Clone, Debug, Default)]
pub(crate) struct SequenceTables<'a> {
    /// The phone's images in order of time.
    pub(crate) color: Vec<ImageRow>,
    /// Depth images in order of time.
    pub(crate) depth: Vec<ImageRow>,
    /// Infrared images in order of time.
    pub(crate) infrared: Vec<ImageRow>,
    /// Colour images of the depth camera in order of time.
    pub(crate) camera: Vec<ImageRow>,
    /// Pairs, as indices into `color` and `depth`.
    pub(crate) pairs: Vec<(usize, usize)>,
    /// Pulses of the trigger, with their numbers in the whole recording.
    pub(crate) pulses: Vec<(usize, &'a PulseTime)>,
    /// Pairs of times in order of the recording.
    pub(crate) times: Vec<&'a TimePair>,
    /// Names of the files for pairs of times, for kinds that have a file.
    pub(crate) names: BTreeMap<&'a Reference, String>,
    /// True if the next run may write images that this one could not.
    pub(crate) unfinished: bool,
}

/// Names and contents of the files of a format.
pub(crate) trait Layout: Sync {
    /// Returns the folder of images, with forward slashes; `None` if the format has no place for
    /// them.
    fn folder(&self, kind: ImageKind) -> Option<&'static str>;

    /// Returns the name of an image's file without its extension.
    fn image_name(&self, at: BoardNanos) -> String {
        in_name(at)
    }

    /// Returns the file of an image; `None` if the format has no place for it.
    fn image_path(&self, kind: ImageKind, at: BoardNanos) -> Option<PathBuf> {
        let (folder, name) = (self.folder(kind)?, self.image_name(at));
        let ending = match kind {
            ImageKind::Camera => "jpg",
            ImageKind::Color | ImageKind::Depth | ImageKind::Infrared => "png",
        };
        Some(PathBuf::from(format!("{folder}/{name}.{ending}")))
    }

    /// Converts big-endian 16-bit millimetres to the format's unit. Also returns the number of
    /// pixels that did not fit.
    fn depth_pixels<'a>(&self, millimetres: &'a [u8]) -> (Cow<'a, [u8]>, u64) {
        (Cow::Borrowed(millimetres), 0)
    }

    /// Returns the file into which the images of a sequence are joined; `None` if they stay files.
    fn joined(&self) -> Option<&'static str> {
        None
    }

    /// Returns the table of the board's IMU.
    fn board_imu(&self) -> ImuTable;

    /// Returns the table of the phone's IMU; `None` if the format has no place for it.
    fn phone_imu(&self) -> Option<ImuTable>;

    /// Returns the name for a file or folder of pairs of times, not yet safe as a file name;
    /// `None` if the format has no place for them. `lidar` is the name of the lidar, if known.
    fn times_name(&self, of: &Reference, lidar: Option<&str>) -> Option<String> {
        of.sensor(lidar).map(str::to_owned)
    }

    /// Writes the index and description files of a sequence.
    ///
    /// # Errors
    ///
    /// Fails if a file cannot be written.
    fn finish(
        &self,
        folder: &Path,
        tables: &SequenceTables<'_>,
        facts: &DataSetInfo,
    ) -> io::Result<()>;
}

/// Returns the path of the camera's calibration, which is beside the depth images.
pub(crate) fn calibration_path(format: Format) -> &'static str {
    match format {
        Format::Euroc => "mav0/depth0/calibration.json",
        Format::Tum => "calibration.json",
        Format::Topics => "_azure_depth_image_raw/calibration.json",
        Format::Kalibr => "kalibr/depth0/calibration.json",
        Format::Ros2 => "calibration.json",
    }
}

/// Appends a sample's time, rates and accelerations, separated by commas.
fn push_sample(row: &mut String, sample: &ImuRow) {
    use std::fmt::Write;
    // Writing into a String cannot fail.
    let _ = write!(row, "{}", sample.at.0);
    for number in sample.gyro.iter().chain(&sample.accel) {
        // In the shortest form that parses to the same number.
        let _ = write!(row, ",{number}");
    }
}

/// Appends a sample's time, rates and accelerations as a line.
fn imu_row(row: &mut String, sample: &ImuRow) {
    push_sample(row, sample);
    row.push('\n');
}

/// Returns a unique, safe file name for each kind of pairs of times. Also returns the original
/// names that had to be made longer for that, with the results.
pub(crate) fn file_names<'a>(
    layout: &dyn Layout,
    references: &BTreeSet<&'a Reference>,
    lidar: Option<&str>,
) -> (BTreeMap<&'a Reference, String>, Vec<(String, String)>) {
    let mut taken = BTreeSet::new();
    let (mut names, mut longer) = (BTreeMap::new(), Vec::new());
    for &of in references {
        let Some(original) = layout.times_name(of, lidar) else {
            continue;
        };
        let plain = safe_name(&original);
        let mut name = plain.clone();
        while !taken.insert(name.clone()) {
            name.push('_');
        }
        if name != plain {
            longer.push((original, name.clone()));
        }
        names.insert(of, name);
    }
    (names, longer)
}

/// Replaces everything but ASCII letters and digits in a name that comes from a file.
fn safe_name(name: &str) -> String {
    let safe = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    name.chars().take(120).map(safe).collect()
}

/// Formats a number with at most `digits` digits after the point and no trailing zeros.
pub(crate) fn number(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}
