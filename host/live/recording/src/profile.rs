//! The rig profile: the constants and settings of one rig, as a commented TOML file.
//!
//! [`DEFAULT`] is the file that `smartdepthsync profile init` writes; the same text gives the
//! defaults, so the two cannot differ. Unknown keys are errors: a misspelt constant must not
//! silently get its default.

mod check;
pub mod edit;
mod error;
mod fit;
mod geometry;
pub mod measured;

use std::path::Path;

pub use error::ProfileError;
pub use fit::Objection;
pub use geometry::{Direction, DistortionModel, Intrinsics, Pose};
use measured::{MeasuredDepth, MeasuredPhone};

use crate::camera::{DEFAULT_CAMERA, Model};
use crate::error_budget::ErrorPart;
use error::{in_line, located, syntax};
use jiff::Timestamp;
use jiff::civil::Date;
use protocol::{Output, TICK_HZ};
use serde::{Deserialize, Serialize};

/// Text of the commented default profile.
pub const DEFAULT: &str = include_str!("profile_default.toml");

/// Longest profile that is read, bytes: a thousand times the commented default.
pub const MAX_LENGTH: u64 = 8 << 20;

/// 1-sigma of the change of an exposure that is not locked, within a recording, as a part of the
/// exposure. A guess.
const EXPOSURE_CHANGES: f64 = 1.0 / 3.0;

/// A rig profile.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Profile {
    /// Name of the rig.
    pub name: String,
    /// Action in the recordings, in a sentence: the task of training data.
    pub task: Option<String>,
    /// Serial port of the board; without it, that of the only board that is plugged in.
    pub port: Option<String>,
    /// Name of the phone that the trigger is aligned to. Reading a profile puts that phone into
    /// `phone`; without this key it is `[phone]`.
    pub reference: Option<String>,
    /// The phone; with several phones, the one that the trigger is aligned to.
    pub phone: Phone,
    /// The depth camera.
    pub depth: Depth,
    /// The board's IMU.
    pub imu: ImuSettings,
    /// Settings of the alignment.
    pub align: Align,
    /// The measured constant bias.
    pub frame_sync: FrameSync,
    /// The other phones, each with its own clock; their frames cannot be shifted.
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
    /// Name of the sensor.
    pub name: String,
    /// Number of the camera's trigger pulses per pulse of this output: 6 is 5 fps beside 30.
    pub every: u32,
    /// Delay after the camera's pulse, µs; less than its period.
    #[serde(default)]
    pub delay_us: f64,
    /// Length of a pulse, µs.
    #[serde(default = "TriggerOutput::default_width")]
    pub width_us: f64,
}

impl TriggerOutput {
    /// Describes at which pulses of the camera's trigger this output has its own.
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

/// A lidar to which the board acts as a GNSS receiver.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lidar {
    /// Name of the lidar.
    pub name: String,
    /// Rate of the serial line, Bd.
    #[serde(default = "Lidar::default_baud")]
    pub baud: u32,
    /// True if the serial line is high when idle (a UART), false if it is low (RS-232).
    #[serde(default)]
    pub idle_high: bool,
    /// True if `$GPZDA` is sent after `$GPRMC`.
    #[serde(default)]
    pub zda: bool,
}

impl Lidar {
    const fn default_baud() -> u32 {
        9_600
    }
}

/// A phone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Phone {
    /// Name in the recording.
    #[serde(default = "Phone::default_name")]
    pub name: String,
    /// Host and port of the app.
    pub address: String,
    /// Exposure of a row, µs, used if the app does not report it.
    pub exposure_us: f64,
    /// True if exposure and frame rate are locked in the app.
    #[serde(default)]
    pub exposure_locked: bool,
    /// Time from the start of exposure of the first row to that of the last, µs.
    pub readout_us: f64,
    /// 1-sigma of `readout_us`, µs.
    pub readout_sigma_us: f64,
    /// Number of rows of the video.
    pub rows: u32,
    /// Row that is synchronised, from 0; the middle one by default.
    pub middle_row: Option<f64>,
    /// Delay of the gyroscope's filter, µs.
    pub gyro_delay_us: f64,
    /// 1-sigma of `gyro_delay_us`, µs.
    pub gyro_delay_sigma_us: f64,
    /// Measurement of delay and readout together by the board's LED.
    pub measured: Option<MeasuredPhone>,
    /// Direction of the readout in the images of the video.
    #[serde(default)]
    pub readout_direction: Direction,
    /// Length of a twist, s.
    pub twist_s: u32,
    /// Transform from the frame of the board's IMU to that of the phone's camera, m.
    pub from_imu: Option<Pose>,
    /// Intrinsics of its camera, one entry per size of image.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cameras: Vec<Intrinsics>,
    /// Properties of its clocks, learnt from recordings.
    pub learnt: Option<Learnt>,
}

impl Phone {
    fn default_name() -> String {
        String::from("phone")
    }

    /// Returns the time from the start of exposure of the first row to that of the synchronised
    /// row, µs.
    #[must_use]
    pub fn middle_row_us(&self) -> f64 {
        self.readout_us * self.middle_row_part()
    }

    /// Returns the part of the readout before the synchronised row, 0 to 1.
    fn middle_row_part(&self) -> f64 {
        let last = f64::from(self.rows.saturating_sub(1).max(1));
        self.middle_row.map_or(0.5, |middle| middle / last)
    }

    /// Returns the 1-sigma of the movement of the middle of its exposure within a recording, µs,
    /// for an exposure of `exposure_us` at its beginning.
    #[must_use]
    pub fn exposure_sigma_us(&self, exposure_us: f64) -> f64 {
        if self.exposure_locked {
            0.0
        } else {
            EXPOSURE_CHANGES * exposure_us / 2.0
        }
    }

    /// Returns the 1-sigma of the phase due to its own constants, µs: the delay of its gyroscope
    /// and the start of the synchronised row.
    #[must_use]
    pub fn constant_sigma_us(&self) -> f64 {
        self.gyro_delay_sigma_us
            .hypot(self.readout_sigma_us * self.middle_row_part())
    }
}

/// Properties of a phone's clocks, learnt from recordings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Learnt {
    /// Frame period in the phone's own time, ns.
    pub frame_period_ns: f64,
    /// 1-sigma of `frame_period_ns`, ns.
    pub frame_period_sigma_ns: f64,
    /// 1-sigma of the timestamps of single frames, ns.
    pub frame_jitter_ns: Option<f64>,
    /// Exposure in that recording, µs.
    pub exposure_us: Option<f64>,
    /// Rate of the phone's clock against the board's, minus one.
    pub skew: Option<f64>,
    /// 1-sigma of `skew`.
    pub skew_sigma: Option<f64>,
    /// Day of the last recording that contributed.
    pub learnt: Date,
    /// Time of that recording, if known.
    pub time: Option<Timestamp>,
    /// Temperature of the board's IMU in that recording, °C.
    pub board_temperature_c: Option<f64>,
    /// ID of the board against whose clock the skew was measured.
    pub board_id: Option<String>,
}

/// The depth camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Depth {
    /// Word of the camera's model ([`Model::all`]).
    #[serde(default = "Depth::default_camera")]
    pub camera: String,
    /// Depth mode, for information.
    pub mode: String,
    /// Frames per second: a divisor of the phone's 30 that the camera supports.
    pub fps: u32,
    /// Time from the trigger's edge to the middle of exposure, µs.
    pub center_offset_us: f64,
    /// 1-sigma of `center_offset_us`, µs.
    pub center_offset_sigma_us: f64,
    /// Measurement of it by a photodiode.
    pub measured: Option<MeasuredDepth>,
    /// Length of the trigger pulse, µs.
    pub pulse_width_us: f64,
    /// Exposure of its colour images, µs, if it records them and the exposure is known.
    pub color_exposure_us: Option<f64>,
    /// Transform from the frame of the board's IMU to that of the depth camera's colour camera, m.
    pub color_from_imu: Option<Pose>,
    /// Program that records it.
    pub recorder: Recorder,
}

impl Depth {
    fn default_camera() -> String {
        DEFAULT_CAMERA.to_owned()
    }

    /// Returns the camera's model; a valid profile has one.
    #[must_use]
    pub fn model(&self) -> Option<&'static Model> {
        Model::find(&self.camera)
    }
}

/// Program that records the depth camera.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recorder {
    /// Program and arguments; empty: none.
    pub command: Vec<String>,
    /// Signal that asks it to stop.
    pub stop: StopSignal,
    /// Longest time until it has stopped, s.
    pub stop_timeout_s: u32,
}

/// Signal that asks a program to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum StopSignal {
    /// SIGINT.
    Interrupt,
    /// SIGTERM.
    Terminate,
}

/// Settings of the board's IMU.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImuSettings {
    /// Samples per second.
    pub rate_hz: u32,
    /// Cut-off frequency of the low-pass filter, Hz.
    pub low_pass_hz: u32,
    /// Full scale of the gyroscope, °/s.
    pub gyro_range_dps: u32,
    /// Full scale of the accelerometer, g.
    pub accel_range_g: u32,
}

/// Settings of the alignment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Align {
    /// Largest change of the distance of two pulses while the phase moves, µs; with 0 the phase
    /// jumps.
    pub slew_us: f64,
    /// Largest 1-sigma of the clock offset at which a twist is accepted, µs.
    pub max_offset_sigma_us: f64,
}

/// The measured constant bias.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrameSync {
    /// Middle of exposure of depth minus that of the phone's middle row, µs.
    pub bias_us: f64,
    /// 1-sigma of `bias_us`, µs.
    pub bias_sigma_us: f64,
    /// Day of the measurement; nothing if it was not measured.
    pub bias_measured: Option<Date>,
    /// Intended shift of the trigger to earlier times, µs (`record --shift`).
    #[serde(default)]
    pub shift_us: f64,
}

fn unknown_phone(key: &'static str, name: &str) -> ProfileError {
    check::wrong(key, format!("{name:?}"), "the name of one of the phones")
}

impl Profile {
    /// Returns the profile of the published rig.
    ///
    /// # Errors
    ///
    /// Never returns one: the text is part of the program, and a test parses it.
    pub fn published() -> Result<Self, ProfileError> {
        Self::parse(DEFAULT, None)
    }

    /// Returns the profile as the text of a file.
    ///
    /// # Errors
    ///
    /// Returns an error if a value has no TOML form.
    pub fn to_toml(&self) -> Result<String, toml::ser::Error> {
        toml::to_string_pretty(self)
    }

    /// Reads a profile; missing keys get their defaults.
    ///
    /// # Errors
    ///
    /// Returns an error if the file cannot be read, is not TOML, or has an unknown key or a value
    /// out of its range.
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
        let syntax = |error: toml::de::Error| syntax(path, &error.to_string());
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

    /// Iterates over all phones, the one that the trigger is aligned to first.
    pub fn all_phones(&self) -> impl Iterator<Item = &Phone> {
        std::iter::once(&self.phone).chain(&self.phones)
    }

    /// Selects the phone that the trigger is aligned to.
    ///
    /// # Errors
    ///
    /// Returns an error if there is no phone with that name.
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

    /// Returns the name of the sensor on an auxiliary output; `output N` if there is none.
    #[must_use]
    pub fn output_name(&self, output: Output) -> String {
        let number = output.number();
        self.outputs
            .iter()
            .find(|sensor| sensor.output == number)
            .map_or_else(|| format!("output {number}"), |sensor| sensor.name.clone())
    }

    /// Returns the name of the lidar; `gnss` if there is none.
    #[must_use]
    pub fn lidar_name(&self) -> &str {
        self.lidar.as_ref().map_or("gnss", |lidar| &lidar.name)
    }

    /// Returns the 1-sigma of the constant between the middles of the two exposures, µs, for a
    /// phone's exposure of `exposure_us`. It is that of the measured bias; without one, that of
    /// the time from the trigger's edge to the middle of the depth exposure and of the phone's own
    /// constants. An exposure that may change adds to either.
    #[must_use]
    pub fn constant_sigma_us(&self, exposure_us: f64) -> f64 {
        let parts = self.constant_parts(exposure_us);
        parts.iter().fold(0.0, |sum, part| sum.hypot(part.1))
    }

    /// Returns the parts of [`Profile::constant_sigma_us`] with their 1-sigmas, µs.
    #[must_use]
    pub fn constant_parts(&self, exposure_us: f64) -> Vec<(ErrorPart, f64)> {
        let phone = &self.phone;
        let mut parts = match self.frame_sync.bias_measured {
            Some(_) => vec![(ErrorPart::Bias, self.frame_sync.bias_sigma_us)],
            None => std::iter::once(self.depth.center_part())
                .chain(phone.own_parts(exposure_us))
                .collect(),
        };
        let exposure = (ErrorPart::Exposure, phone.exposure_sigma_us(exposure_us));
        parts.extend((exposure.1 > 0.0).then_some(exposure));
        parts
    }

    /// Returns the largest part of [`Profile::constant_sigma_us`].
    #[must_use]
    pub fn constant_part(&self, exposure_us: f64) -> ErrorPart {
        let parts = self.constant_parts(exposure_us).into_iter();
        let largest = parts.max_by(|a, b| a.1.total_cmp(&b.1));
        largest.map_or(ErrorPart::Bias, |part| part.0)
    }

    /// Returns [`Profile::constant_sigma_us`] for another phone and its exposure, µs. The bias was
    /// measured with the first phone and includes the errors of that phone's constants.
    #[must_use]
    pub fn other_constant_sigma_us(&self, phone: &Phone, exposure_us: f64) -> f64 {
        let common = match self.frame_sync.bias_measured {
            Some(_) => (self.frame_sync.bias_sigma_us).hypot(self.phone.constant_sigma_us()),
            None => self.depth.center_part().1,
        };
        let own = phone.own_parts(exposure_us).into_iter();
        let own = own.fold(0.0_f64, |sum, part| sum.hypot(part.1));
        let exposure = phone.exposure_sigma_us(exposure_us);
        common.hypot(own).hypot(exposure)
    }

    /// Returns the length of the trigger pulse, ticks.
    #[must_use]
    pub fn pulse_width(&self) -> u32 {
        micros_to_ticks(self.depth.pulse_width_us)
    }

    /// Returns the slew, ticks per frame.
    #[must_use]
    pub fn slew(&self) -> u32 {
        micros_to_ticks(self.align.slew_us)
    }

    /// Returns the number of the phone's frames per frame of the depth camera.
    #[must_use]
    pub const fn frame_ratio(&self) -> u32 {
        30 / self.depth.fps
    }
}

/// Fills in the defaults of the other phones, except for name and address, which are required.
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
            // The check of names refuses an empty one.
            whole.insert(String::from("name"), String::new().into());
            merge(&mut whole, std::mem::take(own));
            *own = whole;
        }
    }
}

/// Merges the values of `over` into `base`, table by table.
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

/// Rounds to ticks; negative and too large values saturate.
fn micros_to_ticks(micros: f64) -> u32 {
    (micros * f64::from(TICK_HZ / 1_000_000)).round() as u32
}

#[cfg(test)]
mod tests;
