//! Report of an extraction: the content of `report.json`.
//!
//! It does not depend on when or how often the extraction ran, so that
//! a repeated one writes the same file.

use recording::error_budget::ErrorPart;
use recording::verify::Verification;
use serde::{Serialize, Serializer};

pub use crate::clocks::gyro_clock::WindowResult;
pub use crate::constants::Constants;
pub use crate::depth::depth_clock::{Ambiguity, Decision, HintSource, MatchError};
use crate::frames::pairs::{DifferenceHistogram, DifferenceSpread};
pub use crate::frames::trigger_offset::TriggerOffset;
use crate::inputs::survey::ImuSpan;
use crate::layout::Format;
pub use crate::output::sample_pairs::FILE as SAMPLES_FILE;

/// Name of the file, which every data set has.
pub const FILE: &str = "report.json";

/// Part of a recording that a loss concerns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum LossPart {
    /// The board's recording.
    Board,
    /// The phone's timestamps and samples.
    Phone,
    /// The phone's video.
    Video,
    /// The depth recording.
    Depth,
    /// The relation of the phone's clock to the board's.
    Clock,
    /// Pairs of frames.
    Pairs,
}

impl LossPart {
    /// Returns the word in `report.json`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Board => "board",
            Self::Phone => "phone",
            Self::Video => "video",
            Self::Depth => "depth",
            Self::Clock => "clock",
            Self::Pairs => "pairs",
        }
    }
}

/// Missing or damaged data.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Loss {
    /// Part of the recording.
    pub part: LossPart,
    /// Description of the loss and its consequence.
    pub what: String,
}

fn compared<S: Serializer>(verification: &Verification, to: S) -> Result<S::Ok, S::Error> {
    verification.compared.serialize(to)
}

/// Report of an extraction.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ExtractReport {
    /// Version of the report's format.
    pub version: u32,
    /// Name of the recording.
    pub recording: String,
    /// Format of the data set.
    pub format: Format,
    /// Task that the recording shows, if the rig profile names one.
    pub task: Option<String>,
    /// The board's part.
    pub board: BoardReport,
    /// Name of the phone that the trigger was aligned to, from the rig profile.
    pub reference: Option<String>,
    /// The phone's part, if its files are there; with several phones, the reference's.
    pub phone: Option<PhoneReport>,
    /// Relation of the phone's clock to the board's.
    pub clock: Option<ClockReport>,
    /// The depth camera's part, if its recording is there.
    pub depth: Option<DepthReport>,
    /// Pairs of a phone frame and a depth frame.
    pub pairs: Option<PairsReport>,
    /// Offset of the phone's frames from the trigger's grid.
    pub grid: Option<TriggerOffset>,
    /// The other phones.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub phones: Vec<OtherReport>,
    /// Sensors on auxiliary outputs, and a lidar.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub sensors: Vec<SensorReport>,
    /// Parts into which marks divide the recording.
    pub sequences: Vec<SequenceReport>,
    /// Constants used for the times, ns.
    pub constants: Constants,
    /// Check of the recording before it was read, but for the content of the phones' files; in the file
    /// the comparisons that it made, in words.
    #[serde(rename = "compared", serialize_with = "compared")]
    pub verification: Verification,
    /// Missing and damaged data; empty if everything is there.
    pub losses: Vec<Loss>,
    /// Observations that are not loss.
    pub remarks: Vec<String>,
}

/// The board's part.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct BoardReport {
    /// Unique ID of the board, if the session knows it.
    pub id: Option<String>,
    /// Number of trigger pulses.
    pub pulses: usize,
    /// Median distance of pulses, ns.
    pub pulse_period_ns: Option<i64>,
    /// Gaps in the recorded pulses: train, first missing number, count.
    pub missing_pulses: Vec<(u32, u64, u64)>,
    /// Samples of the board's IMU.
    pub imu: ImuSpan,
    /// Board times of the marks, ns.
    pub marks_ns: Vec<i64>,
}

/// The phone's part.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct PhoneReport {
    /// Name of the video.
    pub name: String,
    /// Number of frame timestamps.
    pub timestamps: usize,
    /// Number of frames decoded from the video.
    pub video_frames: Option<u64>,
    /// Number of images written.
    pub images: u64,
    /// Number of gyroscope samples.
    pub gyro_samples: u64,
    /// Number of rows in the IMU table.
    pub imu_rows: u64,
}

/// A phone other than the one that the trigger was aligned to; its files are in
/// `phones/NAME` of the output.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OtherReport {
    /// Name in the rig profile.
    pub name: String,
    /// Timestamps, images and samples, if its files are there.
    pub phone: Option<PhoneReport>,
    /// Relation of its clock to the board's.
    pub clock: Option<ClockReport>,
    /// Pairs of its frames with depth frames.
    pub pairs: Option<PairsReport>,
    /// Offset of its frames from the trigger's grid, which does not follow them.
    pub grid: Option<TriggerOffset>,
    /// Constants used for its times, ns.
    pub constants: Constants,
}

/// Origin of the relation of a phone's clock to the board's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ClockSource {
    /// Both gyroscopes, over the whole recording.
    Gyroscopes,
    /// The model that the session found by its twists.
    Session,
    /// The one offset in a bag of the published system.
    Bag,
}

/// Relation of a phone's clock to the board's.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClockReport {
    /// Origin of the relation.
    pub source: ClockSource,
    /// Number of windows with data.
    pub windows: usize,
    /// Number of windows that were used.
    pub used: usize,
    /// Number of windows that contradict the others.
    pub contradicting: usize,
    /// Phone − board at the middle of the recording, s.
    pub offset_s: f64,
    /// Rate of the phone's clock against the board's, ppm.
    pub skew_ppm: f64,
    /// 1-sigma of the rate, ppm.
    pub skew_sigma_ppm: f64,
    /// Smallest and largest 1-sigma of the offset over the frames, µs; `null` if unknown, or
    /// without frames.
    pub sigma_us: Option<[f64; 2]>,
    /// Root mean square of windows minus smoothed course, µs; `null` without windows.
    pub residual_us: Option<f64>,
    /// Frame period on the phone's clock and its 1-sigma, ns.
    pub frame_period_ns: Option<(f64, f64)>,
    /// 1-sigma of single frame timestamps, ns.
    pub frame_jitter_ns: Option<f64>,
    /// Windows against the smoothed course.
    pub course: Vec<WindowResult>,
    /// Number of exchanges with the clocks of phone and board, if they were read during the
    /// recording.
    pub exchanges: Option<usize>,
}

/// The depth camera's part.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct DepthReport {
    /// Number of frames in the file.
    pub frames: usize,
    /// Number of frames with a pulse of their own.
    pub matched: usize,
    /// Evidence that decided which pulse made which frame; empty if they were not matched.
    #[serde(serialize_with = "text_or_empty")]
    pub decided_by: Option<Decision>,
    /// Reason why frames and pulses were not matched; `null` if they were.
    #[serde(serialize_with = "text_or_null")]
    pub not_matched: Option<MatchError>,
    /// Rate of the camera's clock relative to the board's and its 1-sigma, ppm.
    pub rate_ppm: Option<(f64, f64)>,
    /// Robust scatter of frame time minus pulse time, µs.
    pub residual_us: Option<f64>,
    /// Numbers of the pulses without a frame, between the first and the last frame.
    pub missing: Vec<u64>,
    /// Indices of doubled frames: another frame is nearer to the same pulse.
    pub doubled: Vec<usize>,
    /// Indices of frames away from any recorded pulse.
    pub off_pulse: Vec<usize>,
    /// Number of frames before the first pulse.
    pub before_first_pulse: usize,
    /// Number of frames after the last pulse.
    pub after_last_pulse: usize,
    /// Indices of frames without a whole image.
    pub broken: Vec<usize>,
    /// Indices of frames whose part of the file has a wrong checksum.
    pub damaged: Vec<usize>,
    /// Indices of frames without any depth.
    pub empty: Vec<usize>,
    /// Number of pixels beyond the format's range.
    pub out_of_range: u64,
    /// Number of depth images written.
    pub images: u64,
    /// Number of infrared images written.
    pub infrared: u64,
    /// Number of the camera's colour images written.
    pub color: u64,
    /// Synchronisation mode of the camera (`K4A_WIRED_SYNC_MODE`).
    pub sync: Option<String>,
    /// Depth mode of the camera (`K4A_DEPTH_MODE`).
    pub mode: Option<String>,
    /// Serial number of the camera.
    pub serial: Option<String>,
}

/// Pairs of a phone frame and a depth frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PairsReport {
    /// Distribution of depth − phone.
    pub spread: DifferenceSpread,
    /// Largest 1-sigma of depth − phone, µs, from the clocks and from the constant between the
    /// exposures; `null` if one of them is unknown.
    pub sigma_us: Option<f64>,
    /// Largest contribution to it.
    pub largest: Option<ErrorPart>,
    /// Histogram of depth − phone near the median (within ten times the distance of the
    /// quartiles).
    pub central: DifferenceHistogram,
    /// Board time of the phone's frame and depth − phone, ns, for an even selection of the pairs
    /// near the median.
    pub course: Vec<(i64, i64)>,
}

/// Sensor on an auxiliary output, or a lidar.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct SensorReport {
    /// Name of the sensor.
    pub name: String,
    /// Number of its pulses; a lidar gets one a second.
    pub pulses: usize,
}

/// Part of a recording between marks.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct SequenceReport {
    /// Folder in the output; `.` if there are no marks.
    pub folder: String,
    /// Number of phone images.
    pub color: usize,
    /// Number of depth images.
    pub depth: usize,
    /// Number of pairs.
    pub pairs: usize,
}

fn text_or_empty<S: Serializer>(decision: &Option<Decision>, to: S) -> Result<S::Ok, S::Error> {
    match decision {
        Some(decision) => to.collect_str(decision),
        None => to.serialize_str(""),
    }
}

fn text_or_null<S: Serializer>(error: &Option<MatchError>, to: S) -> Result<S::Ok, S::Error> {
    error.as_ref().map(ToString::to_string).serialize(to)
}
