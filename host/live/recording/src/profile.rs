//! The rig profile: what is fixed about one rig, as a commented TOML file.
//!
//! [`DEFAULT`] is the file that `smartdepthsync profile init` writes; the same
//! text gives the defaults, so the two cannot differ. Unknown keys are errors:
//! a misspelt constant must not silently be its default.

mod check;
pub mod edit;
mod error;
mod geometry;

use std::path::Path;

pub use error::ProfileError;
pub use geometry::{Direction, DistortionModel, Intrinsics, Pose};

use crate::camera::{DEFAULT_CAMERA, Model};
use crate::error_budget::ErrorPart;
use error::{in_line, located, syntax};
use jiff::Timestamp;
use jiff::civil::Date;
use protocol::{Output, TICK_HZ};
use serde::{Deserialize, Serialize};

/// The commented default profile.
pub const DEFAULT: &str = include_str!("profile_default.toml");

/// The longest profile that is read, bytes: a thousand times the commented default.
pub const MAX_LENGTH: u64 = 8 << 20;

/// 1-sigma of how an exposure that is not locked changes within a recording, as a part of it. A guess.
const EXPOSURE_CHANGES: f64 = 1.0 / 3.0;

/// A rig profile.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Profile {
    /// What the rig is called.
    pub name: String,
    /// What is done in the recordings, in a sentence: the task of training data.
    pub task: Option<String>,
    /// The board's serial port; else that of the one board that is plugged in.
    pub port: Option<String>,
    /// Name of the phone that the trigger is aligned to. Reading a profile puts
    /// that phone into `phone`; without this it is `[phone]`.
    pub reference: Option<String>,
    /// The phone; of several the one that the trigger is aligned to.
    pub phone: Phone,
    /// The depth camera.
    pub depth: Depth,
    /// The board's IMU.
    pub imu: Imu,
    /// How the trigger is aligned.
    pub align: Align,
    /// The measured constant bias.
    pub frame_sync: FrameSync,
    /// The other phones, each with its own clock; nothing can shift their frames.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub phones: Vec<Phone>,
    /// The sensors on the auxiliary outputs, 2 to 4.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub outputs: Vec<TriggerOutput>,
    /// The lidar, if there is one.
    pub lidar: Option<Lidar>,
}

/// A sensor on one of the auxiliary outputs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TriggerOutput {
    /// Number of the output: 2, 3 or 4.
    pub output: u8,
    /// What the sensor is called.
    pub name: String,
    /// Pulses of the camera's trigger to one of this: 6 is 5 fps beside 30.
    pub every: u32,
    /// How much later than the camera's pulse, µs; less than its period.
    #[serde(default)]
    pub delay_us: f64,
    /// Length of a pulse, µs.
    #[serde(default = "TriggerOutput::default_width")]
    pub width_us: f64,
}

impl TriggerOutput {
    /// At which pulses of the camera's trigger it has its own, in words.
    #[must_use]
    pub fn rule(&self) -> String {
        let later = if self.delay_us > 0.0 {
            format!("{} µs after ", self.delay_us)
        } else {
            String::from("at ")
        };
        match self.every {
            1 => later + "every pulse",
            every => format!("{later}one of {every} pulses"),
        }
    }

    const fn default_width() -> f64 {
        100.0
    }
}

/// A lidar that takes the board for a GNSS receiver.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lidar {
    /// What it is called.
    pub name: String,
    /// Rate of the serial line.
    #[serde(default = "Lidar::default_baud")]
    pub baud: u32,
    /// The serial line is high when idle (a UART's), not low (behind RS-232).
    #[serde(default)]
    pub idle_high: bool,
    /// Send `$GPZDA` after `$GPRMC`.
    #[serde(default)]
    pub zda: bool,
}

impl Lidar {
    const fn default_baud() -> u32 {
        9_600
    }
}

/// The phone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Phone {
    /// What it is called in the recording.
    #[serde(default = "Phone::default_name")]
    pub name: String,
    /// Host and port of the app.
    pub address: String,
    /// Exposure of a row, µs, where the app does not report it.
    pub exposure_us: f64,
    /// Exposure and frame rate are locked in the app.
    #[serde(default)]
    pub exposure_locked: bool,
    /// From the start of exposure of the first row to that of the last, µs.
    pub readout_us: f64,
    /// 1-sigma of it, µs.
    pub readout_sigma_us: f64,
    /// Rows of the video.
    pub rows: u32,
    /// The row that is synchronised, from 0; the middle if not given.
    pub middle_row: Option<f64>,
    /// Delay of the gyroscope's filter, µs.
    pub gyro_delay_us: f64,
    /// 1-sigma of it, µs.
    pub gyro_delay_sigma_us: f64,
    /// Where the readout goes in the images of the video.
    #[serde(default)]
    pub readout_direction: Direction,
    /// Length of a twist, s.
    pub twist_s: u32,
    /// From the frame of the board's IMU to that of the phone's camera, m.
    pub from_imu: Option<Pose>,
    /// Intrinsics of its camera, one for each size of its images.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cameras: Vec<Intrinsics>,
    /// What was learnt about it.
    pub learnt: Option<Learnt>,
}

impl Phone {
    fn default_name() -> String {
        String::from("phone")
    }

    /// From the start of exposure of the first row to that of the row that is
    /// synchronised, µs.
    #[must_use]
    pub fn middle_row_us(&self) -> f64 {
        self.readout_us * self.middle_row_part()
    }

    /// The part of the readout that goes by before the row that is synchronised.
    fn middle_row_part(&self) -> f64 {
        let last = f64::from(self.rows.saturating_sub(1).max(1));
        self.middle_row.map_or(0.5, |middle| middle / last)
    }

    /// 1-sigma of what the middle of its exposure, now of so many µs, moves within a recording, µs.
    #[must_use]
    pub fn exposure_sigma_us(&self, exposure_us: f64) -> f64 {
        match self.exposure_locked {
            true => 0.0,
            false => EXPOSURE_CHANGES * exposure_us / 2.0,
        }
    }

    /// 1-sigma of what its own constants put into the phase, µs: the delay of its gyroscope
    /// and the start of the row that is synchronised.
    #[must_use]
    pub fn constant_sigma_us(&self) -> f64 {
        self.gyro_delay_sigma_us
            .hypot(self.readout_sigma_us * self.middle_row_part())
    }
}

/// What recordings have taught about the phone's clocks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Learnt {
    /// Distance of frames in the phone's own time, ns.
    pub frame_period_ns: f64,
    /// 1-sigma of it, ns.
    pub frame_period_sigma_ns: f64,
    /// 1-sigma of the timestamps of single frames, ns.
    pub frame_jitter_ns: Option<f64>,
    /// Exposure of the recording that taught it, µs.
    pub exposure_us: Option<f64>,
    /// Rate of the phone's clock against the board's, minus one.
    pub skew: Option<f64>,
    /// 1-sigma of it.
    pub skew_sigma: Option<f64>,
    /// The day.
    pub learnt: Date,
    /// The time, where it is known.
    pub time: Option<Timestamp>,
    /// Temperature of the board's IMU then, °C.
    pub board_temperature_c: Option<f64>,
    /// The board whose clock the skew is against.
    pub board_id: Option<String>,
}

/// The depth camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Depth {
    /// Model of the camera, by its word ([`Model::all`]).
    #[serde(default = "Depth::default_camera")]
    pub camera: String,
    /// Depth mode, for the record.
    pub mode: String,
    /// Frames a second, which divide the phone's 30 and which the camera has.
    pub fps: u32,
    /// From the trigger's edge to the middle of exposure, µs.
    pub center_offset_us: f64,
    /// 1-sigma of it, µs.
    pub center_offset_sigma_us: f64,
    /// Length of the trigger pulse, µs.
    pub pulse_width_us: f64,
    /// Exposure of its colour images, µs, where it records them and that is known.
    pub color_exposure_us: Option<f64>,
    /// From the frame of the board's IMU to that of the depth camera's colour camera, m.
    pub color_from_imu: Option<Pose>,
    /// The program that records it.
    pub recorder: Recorder,
}

impl Depth {
    fn default_camera() -> String {
        DEFAULT_CAMERA.to_owned()
    }

    /// The camera's model; a profile that was checked has one.
    #[must_use]
    pub fn model(&self) -> Option<&'static Model> {
        Model::find(&self.camera)
    }
}

/// The program that records the depth camera.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recorder {
    /// Program and arguments; empty: none.
    pub command: Vec<String>,
    /// How it is asked to stop.
    pub stop: StopSignal,
    /// How long it may take to stop, s.
    pub stop_timeout_s: u32,
}

/// How a program is asked to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum StopSignal {
    /// SIGINT.
    Interrupt,
    /// SIGTERM.
    Terminate,
}

/// The board's IMU.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Imu {
    /// Samples a second.
    pub rate_hz: u32,
    /// Low-pass, Hz.
    pub low_pass_hz: u32,
    /// Full scale of the gyroscope, °/s.
    pub gyro_range_dps: u32,
    /// Full scale of the accelerometer, g.
    pub accel_range_g: u32,
}

/// How the trigger is aligned.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Align {
    /// Most change of the distance of two pulses, µs; 0 jumps.
    pub slew_us: f64,
    /// Twists with a larger 1-sigma are refused, µs.
    pub max_offset_sigma_us: f64,
}

/// The measured constant bias.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrameSync {
    /// Middle of exposure of depth minus that of the phone's middle row, µs.
    pub bias_us: f64,
    /// 1-sigma of it, µs.
    pub bias_sigma_us: f64,
    /// When it was measured.
    pub bias_measured: Option<Date>,
    /// By how much earlier than that the trigger is put on purpose, µs (`record --shift`).
    #[serde(default)]
    pub shift_us: f64,
}

fn unknown_phone(key: &'static str, name: &str) -> ProfileError {
    check::wrong(key, format!("{name:?}"), "the name of one of the phones")
}

impl Profile {
    /// The profile of the published rig.
    ///
    /// # Errors
    ///
    /// Never: the text is part of the program, and a test parses it.
    pub fn published() -> Result<Self, ProfileError> {
        Self::parse(DEFAULT, None)
    }

    /// The profile as the text of a file.
    ///
    /// # Errors
    ///
    /// A value has no TOML form.
    pub fn to_toml(&self) -> Result<String, toml::ser::Error> {
        toml::to_string_pretty(self)
    }

    /// Reads a profile; what it leaves out has its default.
    ///
    /// # Errors
    ///
    /// The file cannot be read, is no TOML, has a key that is not known, or a
    /// value out of its range.
    pub fn load(path: &Path) -> Result<Self, ProfileError> {
        let text = system::read_text(path, MAX_LENGTH).map_err(|error| ProfileError::Read {
            path: path.to_owned(),
            reason: error.to_string(),
        })?;
        Self::parse(&text, Some(path))
    }

    /// Reads a profile from its text.
    ///
    /// # Errors
    ///
    /// As [`Profile::load`].
    pub fn parse(text: &str, path: Option<&Path>) -> Result<Self, ProfileError> {
        let syntax = |error: toml::de::Error| syntax(path, error.to_string());
        // Into a table first: a text that is not TOML at all is reported with its line.
        let mut given: toml::Table = text.parse().map_err(syntax)?;
        let mut whole: toml::Table = DEFAULT.parse().map_err(syntax)?;
        complete_phones(&mut given, &whole);
        merge(&mut whole, given);
        let mut profile: Self = whole
            .try_into()
            .map_err(|error| in_line(text, path, &error))?;
        profile
            .check()
            .map_err(|error| located(error, text, path))?;
        if let Some(name) = profile.reference.clone() {
            profile.set_reference(&name)?;
        }
        Ok(profile)
    }

    /// All phones, the one that the trigger is aligned to first.
    pub fn all_phones(&self) -> impl Iterator<Item = &Phone> {
        std::iter::once(&self.phone).chain(&self.phones)
    }

    /// Makes a phone the one that the trigger is aligned to.
    ///
    /// # Errors
    ///
    /// There is none of that name.
    pub fn set_reference(&mut self, name: &str) -> Result<(), ProfileError> {
        if self.phone.name != name {
            match self.phones.iter_mut().find(|phone| phone.name == name) {
                Some(phone) => std::mem::swap(phone, &mut self.phone),
                None => return Err(unknown_phone("reference", name)),
            }
        }
        self.reference = (!self.phones.is_empty()).then(|| name.to_owned());
        Ok(())
    }

    /// The name of the sensor on an auxiliary output.
    #[must_use]
    pub fn output_name(&self, output: Output) -> String {
        let number = output.number();
        self.outputs
            .iter()
            .find(|sensor| sensor.output == number)
            .map_or_else(|| format!("output {number}"), |sensor| sensor.name.clone())
    }

    /// What the lidar is called; `gnss` if there is none.
    #[must_use]
    pub fn lidar_name(&self) -> &str {
        self.lidar.as_ref().map_or("gnss", |lidar| &lidar.name)
    }

    /// 1-sigma of the constant between the middles of the two exposures, µs, where the phone's is
    /// of so many µs: of the bias, once that is measured; until then from the trigger's edge to
    /// the middle of the depth exposure, and of the phone's own constants; and of an exposure
    /// that may change.
    #[must_use]
    pub fn constant_sigma_us(&self, exposure_us: f64) -> f64 {
        let parts = self.constant_parts(exposure_us);
        parts.iter().fold(0.0, |sum, part| sum.hypot(part.1))
    }

    /// 1-sigma of each part of [`Profile::constant_sigma_us`], µs.
    #[must_use]
    pub fn constant_parts(&self, exposure_us: f64) -> Vec<(ErrorPart, f64)> {
        let phone = &self.phone;
        let mut parts = match self.frame_sync.bias_measured {
            Some(_) => vec![(ErrorPart::Bias, self.frame_sync.bias_sigma_us)],
            None => vec![
                (ErrorPart::DepthCenter, self.depth.center_offset_sigma_us),
                (ErrorPart::GyroDelay, phone.gyro_delay_sigma_us),
                (
                    ErrorPart::Readout,
                    phone.readout_sigma_us * phone.middle_row_part(),
                ),
            ],
        };
        let exposure = (ErrorPart::Exposure, phone.exposure_sigma_us(exposure_us));
        parts.extend((exposure.1 > 0.0).then_some(exposure));
        parts
    }

    /// The largest of them.
    #[must_use]
    pub fn constant_part(&self, exposure_us: f64) -> ErrorPart {
        let parts = self.constant_parts(exposure_us).into_iter();
        let largest = parts.max_by(|a, b| a.1.total_cmp(&b.1));
        largest.map_or(ErrorPart::Bias, |part| part.0)
    }

    /// [`Profile::constant_sigma_us`] of another phone and its exposure, µs. The bias was measured
    /// with the first phone, and has the errors of that one's constants in it.
    #[must_use]
    pub fn other_constant_sigma_us(&self, phone: &Phone, exposure_us: f64) -> f64 {
        let common = match self.frame_sync.bias_measured {
            Some(_) => (self.frame_sync.bias_sigma_us).hypot(self.phone.constant_sigma_us()),
            None => self.depth.center_offset_sigma_us,
        };
        let own = phone.constant_sigma_us();
        let exposure = phone.exposure_sigma_us(exposure_us);
        common.hypot(own).hypot(exposure)
    }

    /// Length of the trigger pulse, ticks.
    #[must_use]
    pub fn pulse_width(&self) -> u32 {
        micros_to_ticks(self.depth.pulse_width_us)
    }

    /// The slew, ticks a frame.
    #[must_use]
    pub fn slew(&self) -> u32 {
        micros_to_ticks(self.align.slew_us)
    }

    /// The phone's frames to one frame of the depth camera.
    #[must_use]
    pub const fn frame_ratio(&self) -> u32 {
        30 / self.depth.fps
    }
}

/// Gives each of the other phones the defaults of what it leaves out; name and address it
/// must have itself.
fn complete_phones(given: &mut toml::Table, default: &toml::Table) {
    let Some(toml::Value::Table(default)) = default.get("phone") else {
        return;
    };
    let Some(toml::Value::Array(phones)) = given.get_mut("phones") else {
        return;
    };
    for phone in phones {
        if let toml::Value::Table(own) = phone {
            let mut whole = default.clone();
            whole.remove("address");
            // An empty name is refused where names are checked.
            whole.insert(String::from("name"), String::new().into());
            merge(&mut whole, std::mem::take(own));
            *own = whole;
        }
    }
}

/// Puts the values of `over` into `base`, table by table.
fn merge(base: &mut toml::Table, over: toml::Table) {
    for (key, value) in over {
        match (base.get_mut(&key), value) {
            (Some(toml::Value::Table(inner)), toml::Value::Table(over)) => merge(inner, over),
            (_, value) => {
                base.insert(key, value);
            }
        }
    }
}

/// Nearest ticks; what is negative or too large saturates.
fn micros_to_ticks(micros: f64) -> u32 {
    (micros * f64::from(TICK_HZ / 1_000_000)).round() as u32
}

#[cfg(test)]
mod tests;
