//! The formats that people load: where each file goes and what is in it.
//!
//! A [`Layout`] knows names, headers and rows; it opens no input and decides
//! nothing about time. Paths are relative to a sequence's folder. Index files
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
use crate::geometry::{Cameras, View};
use crate::inputs::board_data::{ImuRow, Reference, TimePair};
use crate::time::{BoardNanos, in_name};

/// Which format.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// EuRoC / ASL: `mav0/cam0`, `imu0`, `imu1`, `depth0`.
    Euroc,
    /// TUM RGB-D: `rgb`, `depth`, `associations.txt`.
    Tum,
    /// One folder a topic, as the published extractor has it.
    Topics,
    /// What Kalibr's bag creator takes: `kalibr/cam0`, `kalibr/imu0.csv`.
    Kalibr,
    /// A ROS 2 bag (MCAP) of images and samples.
    Ros2,
}

impl Format {
    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Euroc => "euroc",
            Self::Tum => "tum",
            Self::Topics => "topics",
            Self::Kalibr => "kalibr",
            Self::Ros2 => "ros2",
        }
    }

    /// Its layout.
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

/// A stream of samples as a CSV file.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ImuTable {
    /// Where, relative to a sequence's folder.
    pub(crate) path: &'static str,
    /// First line with its line end; may be empty.
    pub(crate) header: &'static str,
    /// Whether the low-pass delay is subtracted from the times.
    pub(crate) subtract_delay: bool,
    /// Appends a row.
    pub(crate) row: fn(&mut String, &ImuRow),
}

impl ImuTable {
    /// Times less the low-pass delay, rates and accelerations.
    const fn plain(path: &'static str, header: &'static str) -> Self {
        Self {
            path,
            header,
            subtract_delay: true,
            row: imu_row,
        }
    }
}

/// Images that formats have places for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ImageKind {
    /// The phone's.
    Color,
    /// Depth.
    Depth,
    /// Infrared of the depth camera.
    Infrared,
    /// Colour of the depth camera, as its JPEG files.
    Camera,
}

/// A written image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ImageRow {
    /// Board time.
    pub(crate) at: BoardNanos,
    /// The stamp that it had in its own clock, ns.
    pub(crate) own: i64,
    /// Its file, relative to the sequence's folder.
    pub(crate) path: PathBuf,
}

/// What is known about the data, for the files beside it.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct DataSetInfo {
    /// Phone frames a second.
    pub(crate) color_rate: Option<f64>,
    /// Depth frames a second.
    pub(crate) depth_rate: Option<f64>,
    /// Samples a second of the board's IMU.
    pub(crate) board_imu_rate: Option<f64>,
    /// Samples a second of the phone's gyroscope.
    pub(crate) phone_imu_rate: Option<f64>,
    /// Width and height of the phone's images.
    pub(crate) color_size: Option<(u32, u32)>,
    /// Width and height of depth as it is written.
    pub(crate) depth_size: Option<(u32, u32)>,
    /// Width and height of infrared.
    pub(crate) infrared_size: Option<(u32, u32)>,
    /// Whether depth is reprojected into the images that it is paired with.
    pub(crate) registered: bool,
    /// How the cameras see and where they are.
    pub(crate) cameras: Cameras,
    /// The depth camera's colour images a second.
    pub(crate) camera_rate: Option<f64>,
    /// Width and height of them.
    pub(crate) camera_size: Option<(u32, u32)>,
    /// What went into its times.
    pub(crate) constants: Constants,
}

impl DataSetInfo {
    /// The IMUs of board and phone, as most formats call them: samples a second, and noise.
    fn imus(&self) -> [(&'static str, Option<f64>, Noise); 2] {
        [
            (
                "imu0",
                self.board_imu_rate,
                Noise::of(&self.constants.board_sensor),
            ),
            ("imu1", self.phone_imu_rate, noise::PHONE),
        ]
    }
}

/// What a sequence's index files are made of.
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
    /// Pairs as indices into `color` and `depth`.
    pub(crate) pairs: Vec<(usize, usize)>,
    /// Pairs of times.
    pub(crate) times: Vec<&'a TimePair>,
    /// Names for the files of those that have one of their own.
    pub(crate) names: BTreeMap<&'a Reference, String>,
    /// Whether the next run writes images that this one could not.
    pub(crate) unfinished: bool,
}

/// A format.
pub(crate) trait Layout: Sync {
    /// The folder of images, with forward slashes; `None` if the format has no place for
    /// them.
    fn folder(&self, kind: ImageKind) -> Option<&'static str>;

    /// What the file of an image is called, without its ending.
    fn image_name(&self, at: BoardNanos) -> String {
        in_name(at)
    }

    /// The file of an image; `None` if the format has no place for it.
    fn image_path(&self, kind: ImageKind, at: BoardNanos) -> Option<PathBuf> {
        let (folder, name) = (self.folder(kind)?, self.image_name(at));
        let ending = match kind {
            ImageKind::Camera => "jpg",
            ImageKind::Color | ImageKind::Depth | ImageKind::Infrared => "png",
        };
        Some(PathBuf::from(format!("{folder}/{name}.{ending}")))
    }

    /// Depth in the format's unit from big-endian millimetres, and how many pixels
    /// did not fit.
    fn depth_pixels<'a>(&self, millimetres: &'a [u8]) -> (Cow<'a, [u8]>, u64) {
        (Cow::Borrowed(millimetres), 0)
    }

    /// The board's IMU.
    fn board_imu(&self) -> ImuTable;

    /// The phone's IMU; `None` if the format has no place for it.
    fn phone_imu(&self) -> Option<ImuTable>;

    /// What the file or folder of pairs of times is called after; `None` if the format has no
    /// place for them. `lidar` is what the lidar is called, if that is known.
    fn called_after(&self, of: &Reference, lidar: Option<&str>) -> Option<String> {
        of.sensor(lidar).map(str::to_owned)
    }

    /// Writes what stands beside the data of a sequence.
    ///
    /// # Errors
    ///
    /// Writing fails.
    fn finish(
        &self,
        folder: &Path,
        tables: &SequenceTables<'_>,
        facts: &DataSetInfo,
    ) -> io::Result<()>;
}

/// The camera's calibration goes beside the depth images.
pub(crate) fn calibration_path(format: Format) -> &'static str {
    match format {
        Format::Euroc => "mav0/depth0/calibration.json",
        Format::Tum => "calibration.json",
        Format::Topics => "_azure_depth_image_raw/calibration.json",
        Format::Kalibr => "kalibr/depth0/calibration.json",
        Format::Ros2 => "calibration.json",
    }
}

/// A sample's time, rates and accelerations, with commas.
fn push_sample(row: &mut String, sample: &ImuRow) {
    use std::fmt::Write;
    // Writing into a String cannot fail.
    let _ = write!(row, "{}", sample.at.0);
    for number in sample.gyro.iter().chain(&sample.accel) {
        // Each in its shortest form that reads back to the same number.
        let _ = write!(row, ",{number}");
    }
}

fn imu_row(row: &mut String, sample: &ImuRow) {
    push_sample(row, sample);
    row.push('\n');
}

/// A name for the file of each of these pairs of times: harmless, and no two the same. Also
/// the names that had to be made longer for that, with what they became.
pub(crate) fn file_names<'a>(
    layout: &dyn Layout,
    references: &BTreeSet<&'a Reference>,
    lidar: Option<&str>,
) -> (BTreeMap<&'a Reference, String>, Vec<(String, String)>) {
    let mut taken = BTreeSet::new();
    let (mut names, mut longer) = (BTreeMap::new(), Vec::new());
    for &of in references {
        let Some(after) = layout.called_after(of, lidar) else {
            continue;
        };
        let plain = harmless(&after);
        let mut name = plain.clone();
        while !taken.insert(name.clone()) {
            name.push('_');
        }
        if name != plain {
            longer.push((after, name.clone()));
        }
        names.insert(of, name);
    }
    (names, longer)
}

/// A name that comes out of a file: only what is harmless in a file name stays.
fn harmless(name: &str) -> String {
    let harmless = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    name.chars().take(120).map(harmless).collect()
}

/// A number with at most so many digits after the point, and no trailing zeros.
pub(crate) fn number(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}
