//! `session.json`: all decisions of a session, with versions and profile, so that a recording can
//! be judged and evaluated years later.
//!
//! It is written again at every step (to a temporary file that then replaces it), so a kill
//! leaves the state of the last step, without an outcome. Its last field is a checksum over all
//! bytes before it: JSON has none of its own, and a changed digit is a changed time.

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

use protocol::{ImuSetup, Output, Ticks};
use serde::{Deserialize, Serialize};

use super::{RecordingError, SESSION_FILE};
use crate::contents::{Contents, FileContents, TopicContents, files_of};
use crate::error_budget::{COARSE_US, ErrorPart, together};
use crate::profile::{Phone, Profile};
use crate::strobes::SeenExposures;
use board::finding::Finding;
use board::imu::Scale;
use board::{BoardInfo, StreamCounts};
use clock::alignment::{GridPlan, Placement};
use clock::{BoardSeconds, ClockRelation, PhoneNanos};
use system::ReadMonitor;
use twist_sync::Report;

/// Version of the form of this file.
pub const FORMAT: u32 = 4;

/// Longest file that is read, bytes. An hour with a twist a minute and a problem a
/// second is below 2 MB.
pub const MAX_LENGTH: u64 = 8 << 20;

/// The folder of the phones' folders in a recording of several phones.
pub const PHONES_FOLDER: &str = "phones";

/// The content of `session.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SessionFile {
    /// Version of this form, [`FORMAT`].
    pub format: u32,
    /// Version of the program.
    pub program: String,
    /// Name of the folder.
    pub name: String,
    /// Time at which the session began, on the host's clock (RFC 3339).
    pub started: String,
    /// Outcome; nothing while it runs or after a kill.
    pub outcome: Option<SessionOutcome>,
    /// Rig profile that was used.
    pub profile: Profile,
    /// The board.
    pub board: Option<BoardInfo>,
    /// The board's IMU.
    pub imu: Option<ImuInfo>,
    /// Findings of the checks before the recording.
    #[serde(default)]
    pub preflight: Vec<Finding>,
    /// Phones in the profile's order: the first is the reference, to whose frames the
    /// trigger is aligned.
    pub phones: Vec<PhoneRecord>,
    /// Alignment of the trigger.
    pub alignment: Option<Alignment>,
    /// Tracking of the phone's clock during the recording; nothing if there was none.
    pub tracking: Option<TrackInfo>,
    /// Length of the recording that was asked for, s; nothing to record until stopped.
    #[serde(default)]
    pub asked_s: Option<f64>,
    /// Recorded span of board time: from the arrival of the trigger on the phone's frames to the
    /// stop.
    pub recorded: Option<Span>,
    /// The LED that flashed at the phone; nothing if none did.
    #[serde(default)]
    pub led: Option<LedRun>,
    /// Exposures of the depth camera that a photodiode saw; nothing if it saw none.
    #[serde(default)]
    pub exposures: Option<SeenExposures>,
    /// Markers of the user.
    pub markers: Vec<Marker>,
    /// Messages received and lost on each stream, during the recorded span.
    pub counts: StreamCounts,
    /// Frames that arrived damaged over the link.
    pub damaged_frames: u32,
    /// Number of times that the link was lost and restored.
    pub reconnects: u32,
    /// Problems, in order of time.
    pub problems: Vec<Finding>,
    /// Files in the folder besides `recording.mcap` and this one.
    pub files: Vec<String>,
    /// Contents of the closed recording; nothing while it runs, after a kill, or if `recording.mcap`
    /// could not be closed.
    #[serde(default)]
    pub contents: Option<Contents>,
}

/// Outcome of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SessionOutcome {
    /// Everything was recorded.
    Good,
    /// Finished, with the losses in `problems`.
    Loss,
    /// The user stopped it.
    Interrupted,
    /// A step failed, for the reason in the last problem.
    Failed,
}

/// Name of the check of the constant bias.
pub const CHECK_BIAS: &str = "constant bias";

/// Name of the check of the phone's learnt clocks.
pub const CHECK_LEARNT: &str = "learnt clocks";

/// Name of the check of the trigger's read-back.
pub const CHECK_READBACK: &str = "trigger read-back";

/// The board's IMU.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImuInfo {
    /// Settings and state at the beginning.
    pub setup: ImuSetup,
    /// Conversion from counts to SI units, and filter delays, which are not subtracted from the
    /// times of samples.
    pub scale: Scale,
}

/// A phone of a session.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PhoneRecord {
    /// Name in the profile.
    pub name: String,
    /// Host and port of its app.
    pub address: String,
    /// Version of the app, once it has answered.
    pub version: Option<String>,
    /// All twists in order, including rejected ones.
    pub twists: Vec<Twist>,
    /// Best known relation of its clock to the board's.
    pub clock: Option<ClockRelation>,
    /// Its answer at the start of the video.
    pub video: Option<Video>,
    /// Position of its frames on the trigger's grid, if that follows another phone.
    pub placement: Option<Placement>,
}

/// One twist.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Twist {
    /// File with the phone's gyroscope, relative to the recording.
    pub phone_gyro: Option<String>,
    /// First and last board time of the samples used.
    pub span: Span,
    /// True if it passed the gates.
    pub accepted: bool,
    /// Relation of the clocks from this twist alone.
    pub clock: Option<ClockRelation>,
    /// 1-sigma of the offset, µs.
    pub offset_sigma_us: Option<f64>,
    /// 1-sigma of the skew, ppm.
    pub skew_sigma_ppm: Option<f64>,
    /// Temperature of the board's IMU at the end of the twist, °C.
    pub board_temperature_c: Option<f64>,
    /// Findings of the estimator (gates, faults, residuals): stream a is the board, stream b the
    /// phone.
    pub report: Option<Report>,
}

/// A span of board time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Span {
    /// First tick.
    pub from: Ticks,
    /// Last tick.
    pub to: Ticks,
}

/// Tracking of the phone's clock during a recording.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TrackInfo {
    /// Serial number of the phone in `adb`.
    pub device: String,
    /// Number of changes of the trigger's period.
    pub steps: u32,
    /// Number of times that the phone's clock was lost.
    pub lost: u32,
}

/// Flashes of the LED of a calibration; the recording has each of them among the output's pulses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LedRun {
    /// The output.
    pub output: Output,
    /// Length of a flash, ticks.
    pub length: u32,
    /// Time in which it flashed.
    pub span: Span,
}

/// The answer to `video_start`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Video {
    /// Timestamp of one frame: start of exposure of its first row.
    pub phase: PhoneNanos,
    /// Mean frame period that the app measured, ns.
    pub frame_duration_ns: f64,
    /// Exposure that the app reported, ns.
    pub exposure_ns: Option<u64>,
    /// Clock of the phone's sensors (`CLOCK_BOOTTIME`) minus the clock of its frames, ns; 0 if
    /// they are the same. All times of frames from the app are on the latter.
    #[serde(default)]
    pub boot_minus_frames_ns: i64,
}

impl Video {
    /// Returns the phase on the clock of the phone's sensors.
    #[must_use]
    pub const fn on_boot_clock(&self) -> PhoneNanos {
        PhoneNanos(self.phase.0.saturating_add(self.boot_minus_frames_ns))
    }

    /// Returns true if a phone's video can have these values: 1 to 1,000 frames a second, clocks that
    /// are less than 30 years apart.
    fn is_possible(&self) -> bool {
        const YEARS_NS: u64 = 1_000_000_000_000_000_000;
        (1e6..=1e9).contains(&self.frame_duration_ns)
            && self.boot_minus_frames_ns.unsigned_abs() < YEARS_NS
            && self.exposure_ns.is_none_or(|ns| ns <= 10_000_000_000)
    }

    /// Returns the exposure, µs, if the app reported one.
    #[must_use]
    pub fn exposure_us(&self) -> Option<f64> {
        let exposure = self.exposure_ns.filter(|&exposure| exposure > 0)?;
        Some(exposure as f64 * 1e-3)
    }
}

/// Alignment of the trigger; see `docs/formats.md`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Alignment {
    /// Exposure that was used, µs.
    pub exposure_us: f64,
    /// Time from the start of the first row to that of the synchronised row, µs.
    pub middle_row_us: f64,
    /// Time from the trigger's edge to the middle of exposure of the depth image, µs.
    pub center_offset_us: f64,
    /// Constant bias that was subtracted, µs.
    pub bias_us: f64,
    /// Intended shift that was subtracted besides, µs: depth is earlier by as much.
    #[serde(default)]
    pub shift_us: f64,
    /// 1-sigma of the constant between the two exposures, µs
    /// ([`Profile::constant_sigma_us`]).
    pub constant_sigma_us: Option<f64>,
    /// Largest part of that.
    pub constant_part: Option<ErrorPart>,
    /// True if the constant was measured, as a bias or in both its halves; false if a part of it
    /// was assumed.
    #[serde(default)]
    pub bias_is_measured: bool,
    /// Grid of the trigger, with the relation of the clocks and the frame period that it was
    /// planned from.
    pub plan: GridPlan,
    /// Predicted 1-sigma of the phase when the train arrives on the grid, µs, including that of
    /// the constant if there is one.
    pub phase_sigma_us: f64,
    /// Largest 1-sigma of the phase within the recorded span so far, µs, including that of the
    /// constant, as it was known while it was recorded.
    #[serde(default)]
    pub largest_sigma_us: Option<f64>,
    /// The same at the end of that span.
    #[serde(default)]
    pub end_sigma_us: Option<f64>,
    /// Predicted 1-sigma of the drift, µs/min.
    pub drift_sigma_us_per_min: f64,
    /// Number of the first pulse on the grid, once it has arrived.
    pub arrival_pulse: Option<u64>,
    /// Board time of that pulse.
    pub arrival: Option<Ticks>,
}

impl Alignment {
    /// Returns the 1-sigma of the phase that is stated, µs: the largest within the recorded span,
    /// and before that the one at the arrival. That of the constant is in it, as the root of the
    /// sum of the squares.
    #[must_use]
    pub fn stated_sigma_us(&self) -> f64 {
        self.largest_sigma_us
            .unwrap_or_default()
            .max(self.phase_sigma_us)
    }

    /// Returns the part of [`Self::stated_sigma_us`] of clocks and frame period, µs.
    #[must_use]
    pub fn clocks_sigma_us(&self) -> f64 {
        let total = self.stated_sigma_us();
        let constant = self.constant_sigma_us.unwrap_or_default();
        (total * total - constant * constant).max(0.0).sqrt()
    }

    /// Describes how well the cameras expose together.
    #[must_use]
    pub fn promise(&self) -> String {
        let total = self.stated_sigma_us();
        together(total, Some(self.largest_part(total)))
    }

    /// Takes the present 1-sigma of the clocks and the frame period, µs, into the recorded span.
    pub fn note_sigma_us(&mut self, clocks_us: f64) {
        let total = clocks_us.hypot(self.constant_sigma_us.unwrap_or_default());
        self.end_sigma_us = Some(total);
        self.largest_sigma_us = Some(self.largest_sigma_us.unwrap_or_default().max(total));
    }

    /// Returns the predicted 1-sigma of the phase at a board time, µs, including that of the rig's
    /// constants, which no twist reduces.
    #[must_use]
    pub fn stated_sigma_us_at(&self, at: BoardSeconds) -> f64 {
        let constant_us = self.constant_sigma_us.unwrap_or_default();
        self.plan.phase_sigma_us_at(at).hypot(constant_us)
    }

    /// Returns true if a measured bias and the predicted phase show that the cameras expose
    /// together.
    #[must_use]
    pub fn is_sure(&self) -> bool {
        self.bias_is_measured && self.stated_sigma_us() < COARSE_US
    }

    /// Returns the largest part of a total 1-sigma, µs: that of the constant, or of the clocks.
    #[must_use]
    pub fn largest_part(&self, total_us: f64) -> ErrorPart {
        let constant = self.constant_sigma_us.unwrap_or_default();
        if constant * constant * 2.0 > total_us * total_us {
            self.constant_part.unwrap_or(ErrorPart::Bias)
        } else {
            ErrorPart::Clocks
        }
    }
}

/// A marker of the user.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Marker {
    /// Board time.
    pub at: Ticks,
    /// Label.
    pub label: String,
}

impl SessionFile {
    /// Creates the file of a session that begins now.
    #[must_use]
    pub fn new(name: String, profile: Profile) -> Self {
        let phone = |phone: &Phone| PhoneRecord {
            name: phone.name.clone(),
            address: phone.address.clone(),
            ..PhoneRecord::default()
        };
        let phones = profile.all_phones().map(phone).collect();
        Self {
            format: FORMAT,
            program: env!("CARGO_PKG_VERSION").to_owned(),
            name,
            started: jiff::Zoned::now()
                .strftime("%Y-%m-%dT%H:%M:%S%:z")
                .to_string(),
            outcome: None,
            profile,
            board: None,
            imu: None,
            preflight: Vec::new(),
            phones,
            alignment: None,
            tracking: None,
            recorded: None,
            led: None,
            exposures: None,
            markers: Vec::new(),
            counts: StreamCounts::default(),
            damaged_frames: 0,
            reconnects: 0,
            problems: Vec::new(),
            files: Vec::new(),
            asked_s: None,
            contents: None,
        }
    }

    /// Returns true if the recording holds anything between its begin and its end.
    #[must_use]
    pub fn has_recorded(&self) -> bool {
        self.recorded
            .is_some_and(|span| span.to > span.from || self.outcome.is_none())
    }

    /// Returns the time at which the session began, if [`Self::started`] is valid.
    #[must_use]
    pub fn began(&self) -> Option<jiff::Timestamp> {
        self.started.parse().ok()
    }

    /// Returns the day on which the session began, or today if [`Self::started`] is not valid, in
    /// the computer's time zone.
    #[must_use]
    pub fn day(&self) -> jiff::civil::Date {
        let began = self.began().unwrap_or_else(jiff::Timestamp::now);
        began.to_zoned(jiff::tz::TimeZone::system()).date()
    }

    /// Returns the folder of a phone's files, relative to the recording's: a folder of its own if
    /// there are several phones.
    #[must_use]
    pub fn phone_folder(&self, name: &str) -> PathBuf {
        if self.profile.phones.is_empty() {
            PathBuf::new()
        } else {
            Path::new(PHONES_FOLDER).join(name)
        }
    }

    /// Returns the phone to whose frames the trigger is aligned.
    #[must_use]
    pub fn reference(&self) -> Option<&PhoneRecord> {
        self.phones.first()
    }

    /// Returns the phones other than the reference.
    #[must_use]
    pub fn other_phones(&self) -> &[PhoneRecord] {
        self.phones.get(1..).unwrap_or_default()
    }

    /// Returns a phone by its name in the profile.
    #[must_use]
    pub fn phone(&self, name: &str) -> Option<&PhoneRecord> {
        self.phones.iter().find(|phone| phone.name == name)
    }

    /// Returns the best known relation of the reference phone's clock.
    #[must_use]
    pub fn clock(&self) -> Option<ClockRelation> {
        self.reference()?.clock
    }

    /// Enters the outcome, and the topics of a `recording.mcap` that was closed.
    pub fn close(
        &mut self,
        outcome: SessionOutcome,
        topics: Option<BTreeMap<String, TopicContents>>,
    ) {
        self.outcome = Some(outcome);
        self.contents = topics.map(|topics| Contents {
            topics,
            files: None,
        });
    }

    /// Enters size and checksum of each file of a closed recording.
    ///
    /// # Errors
    ///
    /// Returns an error if a file cannot be read.
    pub fn close_files(
        &mut self,
        folder: &Path,
        monitor: &ReadMonitor,
    ) -> Result<(), RecordingError> {
        let Some(contents) = &mut self.contents else {
            return Ok(());
        };
        let mut files = BTreeMap::new();
        for name in files_of(folder, &self.files).map_err(RecordingError::io("read", folder))? {
            let path = folder.join(&name);
            let found = FileContents::read(&path, monitor);
            files.insert(name, found.map_err(RecordingError::io("read", &path))?);
        }
        contents.files = Some(files);
        Ok(())
    }

    /// Writes the file into the recording's folder; an older one is replaced only by a complete
    /// one.
    ///
    /// # Errors
    ///
    /// Returns an error if it cannot be written.
    pub fn save(&self, folder: &Path) -> Result<(), RecordingError> {
        let path = folder.join(SESSION_FILE);
        let wrong = |error: serde_json::Error| RecordingError::Session {
            path: path.clone(),
            reason: error.to_string(),
        };
        let text = with_checksum(&serde_json::to_string_pretty(self).map_err(wrong)?);
        // A number that is none becomes `null`, which no reader takes.
        serde_json::from_str::<Self>(&text).map_err(wrong)?;
        system::replace(&path, text.as_bytes()).map_err(RecordingError::io("write", &path))
    }

    /// Reads the file from a recording's folder.
    ///
    /// # Errors
    ///
    /// Returns an error if it cannot be read, has another version, was changed after it was written,
    /// or holds a value or a name that this program never writes.
    pub fn load(folder: &Path) -> Result<Self, RecordingError> {
        let path = folder.join(SESSION_FILE);
        let text =
            system::read_text(&path, MAX_LENGTH).map_err(RecordingError::io("read", &path))?;
        let wrong = |reason: String| RecordingError::Session {
            path: path.clone(),
            reason,
        };
        let format: Form = serde_json::from_str(&text).map_err(|error| wrong(error.to_string()))?;
        if format.format != FORMAT {
            return Err(wrong(format!(
                "expected form {FORMAT}, found {}",
                format.format
            )));
        }
        let session: Self =
            serde_json::from_str(&text).map_err(|error| wrong(error.to_string()))?;
        if !is_unchanged(&text) {
            return Err(wrong(String::from(
                "its checksum is not that of its content: it was changed after the session wrote it",
            )));
        }
        session.check().map_err(wrong)?;
        Ok(session)
    }

    /// Checks that the profile is valid, that the phones are those of the profile, that clocks and
    /// times can be, and that every name stays in the recording's folder: the file may come from
    /// anywhere.
    fn check(&self) -> Result<(), String> {
        self.profile.check().map_err(|error| error.to_string())?;
        let names: Vec<&str> = self.phones.iter().map(|p| p.name.as_str()).collect();
        let expected: Vec<&str> = self.profile.all_phones().map(|p| p.name.as_str()).collect();
        if names != expected {
            return Err(format!(
                "its phones are {names:?}; expected those of its profile, {expected:?}"
            ));
        }
        let twists = self.phones.iter().flat_map(|phone| &phone.twists);
        let clocks = twists.clone().filter_map(|twist| twist.clock);
        let clocks = clocks.chain(self.phones.iter().filter_map(|phone| phone.clock));
        let mut clocks = clocks.chain(self.alignment.map(|alignment| alignment.plan.clock));
        if let Some(clock) = clocks.find(|clock| !is_possible(clock)) {
            return Err(format!(
                "no two clocks have the relation {clock:?}; expected a rate within 1 % and a covariance"
            ));
        }
        let mut videos = self.phones.iter().filter_map(|phone| phone.video);
        if let Some(video) = videos.find(|video| !video.is_possible()) {
            return Err(format!("no phone records a video like {video:?}"));
        }
        if self.recorded.is_some_and(|span| span.to < span.from) {
            return Err(String::from("its recorded span ends before it begins"));
        }
        let files = twists.filter_map(|twist| twist.phone_gyro.as_ref());
        let contents = self.contents.iter().filter_map(|all| all.files.as_ref());
        let named = self.files.iter().chain(files);
        let mut named = named.chain(contents.flat_map(BTreeMap::keys));
        match named.find(|name| !is_below(name)) {
            Some(name) => Err(format!(
                "it names the file {name:?}; expected one in the recording's folder"
            )),
            None => Ok(()),
        }
    }
}

/// Returns true if two clocks can have this relation: finite values, a rate within 1 % (crystals are
/// within 0.01 %), and a covariance that is one.
#[must_use]
pub fn is_possible(clock: &ClockRelation) -> bool {
    let [[offset, both], [also_both, skew]] = clock.covariance;
    let is_covariance = offset >= 0.0
        && skew >= 0.0
        && both == also_both
        && both * both <= offset * skew * (1.0 + 1e-6) + f64::MIN_POSITIVE;
    // 300 years; a phone counts from its start, or from 1970.
    let is_time = |seconds: f64| seconds.abs() < 1e10;
    let is_sigma = |value: f64| (0.0..1e20).contains(&value);
    is_time(clock.reference)
        && is_time(clock.offset)
        && clock.skew.abs() <= 1e-2
        && is_covariance
        && is_sigma(offset)
        && is_sigma(skew)
        && is_sigma(clock.wander.0)
}

/// Field that ends the file.
const CHECKSUM: &str = ",\n  \"checksum\": \"";

/// Returns the text of a JSON object with a checksum over it as its last field.
#[must_use]
pub fn with_checksum(object: &str) -> String {
    let object = object.trim_end();
    sealed(object.strip_suffix('}').unwrap_or(object).trim_end())
}

/// Ends a JSON object, given without its last brace, with a checksum over it.
fn sealed(open: &str) -> String {
    let sum = crc32fast::hash(open.as_bytes());
    format!("{open}{CHECKSUM}{sum:08x}\"\n}}\n")
}

/// Returns the text of a JSON object without the checksum at its end, if it has one.
#[must_use]
pub fn without_checksum(text: &str) -> String {
    let end = text.rfind(CHECKSUM).and_then(|end| text.get(..end));
    end.map_or_else(|| text.to_owned(), |open| format!("{open}\n}}"))
}

/// Returns true if the checksum at the end of a text is that of what precedes it.
fn is_unchanged(text: &str) -> bool {
    let end = text.rfind(CHECKSUM);
    end.is_some_and(|end| text.get(..end).map(sealed).as_deref() == Some(text))
}

/// Returns true if a relative path stays below the folder that it begins in.
fn is_below(path: &str) -> bool {
    let mut parts = Path::new(path).components();
    parts.all(|part| matches!(part, Component::Normal(_)))
}

#[derive(Deserialize)]
struct Form {
    format: u32,
}

#[cfg(test)]
mod tests {
    use super::*;
    use twist_sync::{Action, Fault, FaultKind, Gate, GateKind, Stream, Warning};

    /// The last of two sawteeth of the phone counts, and a gate keeps a value that JSON lacks.
    #[test]
    fn findings_about_a_twist_are_read_as_they_were_written() {
        let sawtooth = |stream, jump_s| Fault {
            stream,
            kind: FaultKind::TimestampSawtooth,
            count: 3,
            period: None,
            displacement_s: Some(jump_s),
            action: Action::Corrected,
            samples: Vec::new(),
        };
        let gate = Gate {
            kind: GateKind::Unit,
            passed: false,
            value: f64::INFINITY,
            limit: 20.0,
        };
        let held = Warning::Held {
            stream: Stream::B,
            rate_hz: 50.0,
        };
        let report = Report {
            faults: vec![
                sawtooth(Stream::B, 2e-3),
                sawtooth(Stream::B, 4e-3),
                sawtooth(Stream::A, 1e-3),
            ],
            gates: vec![gate],
            warnings: vec![held],
            ..Report::default()
        };
        let text = serde_json::to_string(&report).unwrap();
        let read: Report = serde_json::from_str(&text).unwrap();
        assert_eq!((&read, read.sawtooth_s(Stream::B)), (&report, Some(4e-3)));
    }

    #[test]
    fn a_gate_has_one_name() {
        use GateKind::{
            Axes, Bands, Consistent, Explained, Lengths, Motion, OneBody, OneRelation, Overlap,
            Rate, Residual, Samples, Settled, Sigma, Skew, Solvable, UniquePeak, Unit, Usable,
        };
        let kinds = [
            Lengths,
            Samples,
            Rate,
            Motion,
            Axes,
            Unit,
            Overlap,
            Explained,
            UniquePeak,
            Residual,
            Usable,
            OneBody,
            OneRelation,
            Consistent,
            Bands,
            Sigma,
            Skew,
            Settled,
            Solvable,
        ];
        for kind in kinds {
            assert_eq!(serde_json::to_value(kind).unwrap(), kind.name());
        }
    }
}
