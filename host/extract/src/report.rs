//! The report of an extraction: `report.json` for programs, `report.html` for
//! people, with the same content.
//!
//! Nothing in it depends on when or how often the extraction ran, so that
//! repeating it gives the same files.

mod html;

use std::fmt::Write;

use serde::Serialize;

use super::grid::GridReport;
use super::gyro_clock::WindowResult;
use super::layout::Format;
use super::pairs::{Histogram, Spread};
use super::survey::ImuSpan;
use page::Level;

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
    /// The board.
    pub board: BoardReport,
    /// Name in the rig profile of the phone that the trigger was aligned to.
    #[serde(skip_serializing_if = "Option::is_none")]
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
    /// Further phones.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub phones: Vec<OtherReport>,
    /// Sensors on further outputs, and a lidar.
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

/// Constants that went into the times.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Constants {
    /// Low-pass delay subtracted from the board's IMU times (not in the topics
    /// layout), ns.
    pub board_imu_delay_ns: i64,
    /// The same of the phone, ns.
    pub phone_imu_delay_ns: i64,
    /// From the phone's frame timestamp to the middle of exposure of the middle
    /// row, ns.
    pub color_middle_ns: i64,
    /// From the trigger pulse to the depth timestamp, ns.
    pub depth_center_ns: i64,
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
    /// What following the phone's clock while it recorded has added.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tracked: Option<TrackedReport>,
}

/// What following a phone's clock has added to its relation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TrackedReport {
    /// Exchanges with the clocks of phone and board.
    pub exchanges: usize,
    /// Smallest and largest 1-sigma of the offset over the frames without them, µs; nothing
    /// without frames.
    pub sigma_us_without: Option<[f64; 2]>,
    /// The most that they have moved a frame, µs.
    pub moved_us: f64,
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
    /// Frames behind the last pulse.
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
    /// Depth − phone, all of them.
    pub histogram: Histogram,
    /// Those near to the median (within ten times the distance of the quartiles).
    pub central: Histogram,
    /// Depth − phone over time: board time of the phone's frame and the difference, ns, of
    /// the pairs near to the median; of many, evenly picked ones.
    pub course: Vec<(i64, i64)>,
}

/// A sensor on a further output, or a lidar.
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

impl ExtractReport {
    /// The report as text for a terminal.
    #[must_use]
    pub fn text(&self) -> String {
        let mut out = String::new();
        for (name, value) in self.lines() {
            let _ = writeln!(out, "{name:<22} {value}");
        }
        for loss in &self.losses {
            let _ = writeln!(out, "missing ({}): {}", loss.part, loss.what);
        }
        for remark in &self.remarks {
            let _ = writeln!(out, "note: {remark}");
        }
        out
    }

    /// Name and value of what matters most.
    fn lines(&self) -> Vec<(&'static str, String)> {
        let mut lines = vec![
            ("recording", self.recording.clone()),
            ("format", self.format.name().into()),
            ("trigger pulses", self.board.pulses.to_string()),
            ("board IMU samples", self.board.imu.samples.to_string()),
        ];
        if let Some(reference) = self.reference.as_ref().filter(|_| !self.phones.is_empty()) {
            lines.push(("trigger follows", reference.clone()));
        }
        if let Some(phone) = &self.phone {
            lines.push(("phone timestamps", phone.timestamps.to_string()));
            lines.push(("phone images", phone.images.to_string()));
            lines.push(("phone IMU rows", phone.imu_rows.to_string()));
        }
        if let Some(clock) = &self.clock {
            lines.push(("clock relation", clock.line()));
        }
        if let Some(grid) = &self.grid {
            lines.push(("phone against trigger", grid.line()));
        }
        if let Some(depth) = &self.depth {
            lines.push(("depth frames", depth.line()));
            lines.push(("depth images", depth.images.to_string()));
            if depth.color > 0 {
                lines.push(("depth camera's colour", depth.color.to_string()));
            }
            if let (Some((rate, sigma)), Some(residual)) = (depth.rate_ppm, depth.residual_us) {
                lines.push((
                    "depth clock",
                    format!(
                        "{rate:.3} ppm ± {sigma:.3}, scatter {residual:.1} µs, decided by {}",
                        depth.decided_by
                    ),
                ));
            }
            lines.push(("pulses without a frame", depth.missing.len().to_string()));
        }
        if let Some(pairs) = &self.pairs {
            let us = |ns: i64| format!("{:.1}", ns as f64 / 1000.0);
            let spread = &pairs.spread;
            lines.push((
                "pairs",
                format!(
                    "{}, depth − phone: median {} µs{}, quartiles {} to {} µs",
                    spread.count,
                    us(spread.median_ns),
                    pairs.known(),
                    us(spread.quartiles_ns[0]),
                    us(spread.quartiles_ns[1])
                ),
            ));
        }
        for other in &self.phones {
            lines.push(("further phone", other.line()));
        }
        for sensor in &self.sensors {
            let line = format!("{}: {} pulses", sensor.name, sensor.pulses);
            lines.push(("further sensor", line));
        }
        lines
    }

    /// How well it went, in words.
    #[must_use]
    pub fn verdict(&self) -> (Level, String) {
        let pairs = self.pairs.as_ref().map_or(String::new(), |pairs| {
            format!(
                " {} pairs of frames; depth − phone is {:.1} µs{} in the median.",
                pairs.spread.count,
                pairs.spread.median_ns as f64 / 1000.0,
                pairs.known()
            )
        });
        match self.losses.first() {
            None => (
                Level::Good,
                format!(
                    "Everything is there and has its time in board time: {} trigger pulses, {} IMU \
                     samples.{pairs}",
                    self.board.pulses, self.board.imu.samples
                ),
            ),
            Some(loss) => (
                Level::Warning,
                format!(
                    "Something is missing or damaged: {} ({}){}. What is there has its time in board \
                     time.{pairs}",
                    loss.what,
                    loss.part,
                    match self.losses.len() {
                        1 => String::new(),
                        n => format!(", and {} more (below)", n - 1),
                    }
                ),
            ),
        }
    }
}

impl PairsReport {
    /// How well depth − phone is known, in words behind it.
    fn known(&self) -> String {
        self.sigma_us.map_or(String::new(), |sigma_us| {
            format!(" ± {sigma_us:.1} µs (1-sigma)")
        })
    }
}

impl ClockReport {
    fn line(&self) -> String {
        let from = match self.source {
            "session" => "the session's twists alone",
            "bag" => "the one offset in the bag",
            other => other,
        };
        let mut line = format!("from {from}");
        // An offset alone has no rate.
        if self.source != "bag" {
            let _ = write!(
                line,
                ": {:.3} ppm ± {:.3}",
                self.skew_ppm, self.skew_sigma_ppm
            );
        }
        match self.sigma_us {
            Some([least, most]) => {
                let _ = write!(line, ", 1-sigma {least:.1} to {most:.1} µs");
            }
            None => line.push_str(", 1-sigma not known"),
        }
        if let Some(residual) = self.residual_us {
            let (used, windows) = (self.used, self.windows);
            let _ = write!(
                line,
                ", residual {residual:.1} µs, {used} of {windows} windows"
            );
        }
        if let Some(tracked) = &self.tracked {
            let _ = write!(line, "; {} exchanges with its clock", tracked.exchanges);
            if let Some([least, most]) = tracked.sigma_us_without {
                let _ = write!(
                    line,
                    ", without which 1-sigma were {least:.1} to {most:.1} µs"
                );
            }
            let _ = write!(line, ", moved frames by up to {:.1} µs", tracked.moved_us);
        }
        line
    }
}

impl DepthReport {
    /// All frames of the file: those on a pulse, and what the others are.
    fn line(&self) -> String {
        let mut line = format!("{}: {} on a pulse", self.frames, self.matched);
        let others = [
            (self.before_first_pulse, "before the first pulse"),
            (
                self.after_last_pulse,
                "after the last pulse, by the camera's own clock",
            ),
            (self.doubled.len(), "doubled"),
            (self.off_pulse.len(), "off any pulse"),
            (self.unassigned(), "not matched"),
        ];
        for (count, what) in others.into_iter().filter(|&(count, _)| count > 0) {
            let _ = write!(line, ", {count} {what}");
        }
        line
    }

    /// Frames that nothing is known of.
    fn unassigned(&self) -> usize {
        let known = self.matched
            + self.before_first_pulse
            + self.after_last_pulse
            + self.doubled.len()
            + self.off_pulse.len();
        self.frames.saturating_sub(known)
    }
}

impl GridReport {
    fn line(&self) -> String {
        format!(
            "depth − phone {:+.1} µs, drifting by {:+.1} µs/min, scatter {:.1} µs, {} pulses",
            self.offset_us, self.drift_us_per_min, self.residual_us, self.pulses
        )
    }
}

impl OtherReport {
    fn line(&self) -> String {
        let mut line = self.name.clone();
        if let Some(phone) = &self.phone {
            let _ = write!(
                line,
                ": {} timestamps, {} images, {} IMU rows",
                phone.timestamps, phone.images, phone.imu_rows
            );
        }
        if let Some(clock) = &self.clock {
            let _ = write!(line, "; clock {}", clock.line());
        }
        if let Some(grid) = &self.grid {
            let _ = write!(line, "; {}", grid.line());
        }
        line
    }
}
