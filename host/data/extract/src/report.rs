//! The report of an extraction, in `report.json`.
//!
//! Nothing in it depends on when or how often the extraction ran, so that
//! repeating it gives the same files.

use recording::error_budget::ErrorPart;
use serde::Serialize;

pub use crate::clocks::gyro_clock::WindowResult;
pub use crate::constants::Constants;
use crate::frames::pairs::{Histogram, Spread};
pub use crate::frames::trigger_offset::GridReport;
use crate::inputs::survey::ImuSpan;
use crate::layout::Format;
pub use crate::output::sample_pairs::FILE as SAMPLES_FILE;

/// Something that is missing or damaged.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Loss {
    /// Which part: `board`, `phone`, `video`, `depth`, `clock`, `pairs`.
    pub part: &'static str,
    /// What is missing, and what that means.
    pub what: String,
}

/// Everything there is to say.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ExtractReport {
    /// Version of this form.
    pub version: u32,
    /// Name of the recording.
    pub recording: String,
    /// The format.
    pub format: Format,
    /// What is done in it, if the rig profile says it.
    pub task: Option<String>,
    /// The board.
    pub board: BoardReport,
    /// Name in the rig profile of the phone that the trigger was aligned to.
    pub reference: Option<String>,
    /// The phone, if its files are there; of several the reference.
    pub phone: Option<PhoneReport>,
    /// How phone time became board time.
    pub clock: Option<ClockReport>,
    /// The depth camera, if its recording is there.
    pub depth: Option<DepthReport>,
    /// Pairs of frames.
    pub pairs: Option<PairsReport>,
    /// The phone's frames against the trigger's grid.
    pub grid: Option<GridReport>,
    /// The other phones.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub phones: Vec<OtherReport>,
    /// Sensors on auxiliary outputs, and a lidar.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub sensors: Vec<SensorReport>,
    /// The parts that marks divide the recording into.
    pub sequences: Vec<SequenceReport>,
    /// Constants that went into the times, ns.
    pub constants: Constants,
    /// What is missing or damaged. Empty: all is there.
    pub losses: Vec<Loss>,
    /// Worth knowing, but no loss.
    pub remarks: Vec<String>,
}

/// The board's part.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct BoardReport {
    /// The board's unique ID, if the session knows it.
    pub id: Option<String>,
    /// Pulses.
    pub pulses: usize,
    /// Median distance of pulses, ns.
    pub pulse_period_ns: Option<i64>,
    /// Pulses missing in the recording: train, first number, how many.
    pub missing_pulses: Vec<(u32, u64, u64)>,
    /// Samples of the IMU.
    pub imu: ImuSpan,
    /// Marks, ns.
    pub marks_ns: Vec<i64>,
}

/// The phone's part.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct PhoneReport {
    /// Name of the video.
    pub name: String,
    /// Frame timestamps.
    pub timestamps: usize,
    /// Frames of the video as decoded.
    pub video_frames: Option<u64>,
    /// Images written.
    pub images: u64,
    /// Samples of the gyroscope.
    pub gyro_samples: u64,
    /// Rows of the IMU table.
    pub imu_rows: u64,
}

/// A phone beside the one that the trigger was aligned to; its files are in
/// `phones/NAME` of the output.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OtherReport {
    /// Its name in the rig profile.
    pub name: String,
    /// What there was of it.
    pub phone: Option<PhoneReport>,
    /// How its time became board time.
    pub clock: Option<ClockReport>,
    /// Pairs of its frames with depth frames.
    pub pairs: Option<PairsReport>,
    /// Its frames against the trigger's grid, which does not follow it.
    pub grid: Option<GridReport>,
    /// Constants that went into its times, ns.
    pub constants: Constants,
}

/// How phone time became board time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClockReport {
    /// `gyroscopes`, `session` (the twist's model) or `bag` (the recorded offset).
    pub source: &'static str,
    /// Windows with data.
    pub windows: usize,
    /// Windows that were used.
    pub used: usize,
    /// Windows that contradict the rest.
    pub contradicting: usize,
    /// Phone − board at the middle of the recording, s.
    pub offset_s: f64,
    /// Rate of the phone's clock against the board's, ppm.
    pub skew_ppm: f64,
    /// 1-sigma of the rate, ppm.
    pub skew_sigma_ppm: f64,
    /// Smallest and largest 1-sigma of the offset over the frames, µs; nothing where it is
    /// not known, or without frames.
    pub sigma_us: Option<[f64; 2]>,
    /// Root mean square of the windows against the course, µs; nothing without windows.
    pub residual_us: Option<f64>,
    /// Distance of frames in the phone's own time, ns, with 1-sigma.
    pub frame_period_ns: Option<(f64, f64)>,
    /// 1-sigma of the timestamps of single frames, ns.
    pub frame_jitter_ns: Option<f64>,
    /// The windows.
    pub course: Vec<WindowResult>,
    /// Exchanges with the clocks of phone and board, if it was followed while it recorded.
    pub exchanges: Option<usize>,
}

/// The depth camera's part.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct DepthReport {
    /// Frames in the file.
    pub frames: usize,
    /// Frames with a pulse of their own.
    pub matched: usize,
    /// What decided which pulse is whose; empty if the frames were not matched.
    pub decided_by: String,
    /// Why they were not matched.
    pub not_matched: Option<String>,
    /// Rate of the camera's clock against the board's, ppm, with 1-sigma.
    pub rate_ppm: Option<(f64, f64)>,
    /// Robust scatter of frame time against pulse, µs.
    pub residual_us: Option<f64>,
    /// Pulses without a frame (numbers), between the first and the last frame.
    pub missing: Vec<u64>,
    /// Doubled frames.
    pub doubled: Vec<usize>,
    /// Frames off any recorded pulse.
    pub off_pulse: Vec<usize>,
    /// Frames before the first pulse.
    pub before_first_pulse: usize,
    /// Frames after the last pulse.
    pub after_last_pulse: usize,
    /// Frames without a whole image.
    pub broken: Vec<usize>,
    /// Frames whose part of the file has a wrong checksum.
    pub damaged: Vec<usize>,
    /// Frames without any depth.
    pub empty: Vec<usize>,
    /// Pixels beyond the format's range.
    pub out_of_range: u64,
    /// Images written.
    pub images: u64,
    /// Infrared images written.
    pub infrared: u64,
    /// Colour images of the camera written.
    pub color: u64,
    /// How the camera was told to be synchronised (`K4A_WIRED_SYNC_MODE`).
    pub sync: Option<String>,
    /// Mode of the camera.
    pub mode: Option<String>,
    /// Serial number of the camera.
    pub serial: Option<String>,
}

/// Pairs of frames.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PairsReport {
    /// Depth − phone.
    pub spread: Spread,
    /// 1-sigma of depth − phone, µs: of the clocks, at most, and of the constant between the
    /// exposures; nothing where one of them is not known.
    pub sigma_us: Option<f64>,
    /// The largest part of that.
    pub largest: Option<ErrorPart>,
    /// Depth − phone of those near to the median (within ten times the distance of the quartiles).
    pub central: Histogram,
    /// Depth − phone over time: board time of the phone's frame and the difference, ns, of
    /// the pairs near to the median; of many, evenly picked ones.
    pub course: Vec<(i64, i64)>,
}

/// A sensor on an auxiliary output, or a lidar.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct SensorReport {
    /// Its name.
    pub name: String,
    /// Its pulses; of a lidar, one a second.
    pub pulses: usize,
}

/// One part of the recording.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct SequenceReport {
    /// Its folder; `.` if there are no marks.
    pub folder: String,
    /// Phone images.
    pub color: usize,
    /// Depth images.
    pub depth: usize,
    /// Pairs.
    pub pairs: usize,
}
