//! The rig profile: what is fixed about one rig, as a commented TOML file.
//!
//! [`DEFAULT`] is the file that `smartdepthsync profile init` writes; the same
//! text gives the defaults, so the two cannot differ. Unknown keys are errors:
//! a misspelt constant must not silently be its default.

use std::path::{Path, PathBuf};

use jiff::civil::Date;
use protocol::{AccelRange, GyroRange, ImuConfig, LowPass, Output, TICK_HZ};
use serde::{Deserialize, Serialize};

/// The commented default profile.
pub const DEFAULT: &str = include_str!("profile_default.toml");

/// A rig profile.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Profile {
    /// What the rig is called.
    pub name: String,
    /// Name of the phone that the trigger is aligned to. Reading a profile puts
    /// that phone into `phone`; without this it is `[phone]`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
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
    /// Further phones, each with its own clock; nothing can shift their frames.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub phones: Vec<Phone>,
    /// The sensors on the trigger outputs 2 to 4.
    #[serde(default)]
    pub outputs: Vec<TriggerOutput>,
    /// The lidar, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lidar: Option<Lidar>,
}

/// A sensor on one of the further trigger outputs.
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
    /// From the start of exposure of the first row to that of the last, µs.
    pub readout_us: f64,
    /// Rows of the video.
    pub rows: u32,
    /// The row that is synchronised, from 0; the middle if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub middle_row: Option<f64>,
    /// Delay of the gyroscope's filter, µs.
    pub gyro_delay_us: f64,
    /// 1-sigma of it, µs.
    pub gyro_delay_sigma_us: f64,
    /// Length of a twist, s.
    pub twist_s: u32,
    /// What was learnt about it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
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
        let last = f64::from(self.rows.saturating_sub(1).max(1));
        let middle = self.middle_row.unwrap_or(0.5 * last);
        self.readout_us * middle / last
    }

    fn check(&self) -> Result<(), ProfileError> {
        if crate::folder::check_name(&self.name).is_err() || self.name.contains('=') {
            return Err(ProfileError::Value {
                key: "phone.name",
                found: format!("{:?}", self.name),
                expected: "a name that can be a folder's, without a slash or '='",
            });
        }
        let micros = "0 to 1000000 (µs)";
        range("phone.exposure_us", self.exposure_us, 0.0, 1e6, micros)?;
        range("phone.readout_us", self.readout_us, 0.0, 1e6, micros)?;
        range("phone.rows", f64::from(self.rows), 2.0, 1e5, "2 to 100000")?;
        if let Some(row) = self.middle_row {
            let most = f64::from(self.rows - 1);
            range("phone.middle_row", row, 0.0, most, "0 to the last row")?;
        }
        range("phone.gyro_delay_us", self.gyro_delay_us, 0.0, 1e6, micros)?;
        range(
            "phone.gyro_delay_sigma_us",
            self.gyro_delay_sigma_us,
            0.0,
            1e6,
            micros,
        )?;
        let twist = f64::from(self.twist_s);
        range("phone.twist_s", twist, 3.0, 60.0, "3 to 60 (s)")?;
        self.learnt.as_ref().map_or(Ok(()), Learnt::check)
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
    /// Rate of the phone's clock against the board's, minus one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub skew: Option<f64>,
    /// 1-sigma of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub skew_sigma: Option<f64>,
    /// When.
    pub learnt: Date,
    /// The board whose clock the skew is against.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub board_id: Option<String>,
}

impl Learnt {
    fn check(&self) -> Result<(), ProfileError> {
        let period = "1000000 to 1000000000 (ns)";
        range(
            "phone.learnt.frame_period_ns",
            self.frame_period_ns,
            1e6,
            1e9,
            period,
        )?;
        range(
            "phone.learnt.frame_period_sigma_ns",
            self.frame_period_sigma_ns,
            0.0,
            1e6,
            "0 to 1000000 (ns)",
        )?;
        let skew = "-0.001 to 0.001";
        range(
            "phone.learnt.skew",
            self.skew.unwrap_or(0.0),
            -1e-3,
            1e-3,
            skew,
        )?;
        let sigma = self.skew_sigma.unwrap_or(0.0);
        range("phone.learnt.skew_sigma", sigma, 0.0, 1e-3, "0 to 0.001")
    }
}

/// The depth camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Depth {
    /// Depth mode, for the record.
    pub mode: String,
    /// Frames a second: 30, 15 or 5.
    pub fps: u32,
    /// From the trigger's edge to the middle of exposure, µs.
    pub center_offset_us: f64,
    /// 1-sigma of it, µs.
    pub center_offset_sigma_us: f64,
    /// Length of the trigger pulse, µs.
    pub pulse_width_us: f64,
    /// The program that records it.
    pub recorder: Recorder,
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
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bias_measured: Option<Date>,
}

/// Why a profile cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ProfileError {
    /// The file cannot be read.
    #[error("cannot read the rig profile {path}: {reason}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        reason: String,
    },
    /// It is no profile.
    #[error("the rig profile{} is not valid: {reason}", in_file(.path.as_deref()))]
    Syntax {
        /// The file, if it came from one.
        path: Option<PathBuf>,
        /// Line, key, and what was expected.
        reason: String,
    },
    /// A value is out of its range.
    #[error("in the rig profile, `{key}` is {found}, expected {expected}")]
    Value {
        /// The key with its tables.
        key: &'static str,
        /// The value.
        found: String,
        /// What is accepted.
        expected: &'static str,
    },
}

fn in_file(path: Option<&Path>) -> String {
    path.map_or(String::new(), |path| format!(" {}", path.display()))
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

    /// Reads a profile; what it leaves out has its default.
    ///
    /// # Errors
    ///
    /// The file cannot be read, is no TOML, has a key that is not known, or a
    /// value out of its range.
    pub fn load(path: &Path) -> Result<Self, ProfileError> {
        let text = std::fs::read_to_string(path).map_err(|error| ProfileError::Read {
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
        let syntax = |error: toml::de::Error| ProfileError::Syntax {
            path: path.map(Path::to_owned),
            reason: error.to_string(),
        };
        // Into a table first: a text that is no TOML at all is told with its line.
        let mut given: toml::Table = text.parse().map_err(syntax)?;
        let mut whole: toml::Table = DEFAULT.parse().map_err(syntax)?;
        complete_phones(&mut given, &whole);
        merge(&mut whole, given);
        let mut profile: Self = whole.try_into().map_err(syntax)?;
        profile.check()?;
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
                None => {
                    return Err(ProfileError::Value {
                        key: "reference",
                        found: format!("{name:?}"),
                        expected: "the name of one of the phones",
                    });
                }
            }
        }
        self.reference = (!self.phones.is_empty()).then(|| name.to_owned());
        Ok(())
    }

    /// Gives a phone another address: `HOST[:PORT]` to the first, or with its name
    /// before it, `NAME=HOST[:PORT]`.
    ///
    /// # Errors
    ///
    /// There is no phone of that name.
    pub fn set_address(&mut self, text: &str) -> Result<(), ProfileError> {
        let Some((name, address)) = text.split_once('=') else {
            text.clone_into(&mut self.phone.address);
            return Ok(());
        };
        let mut phones = std::iter::once(&mut self.phone).chain(&mut self.phones);
        match phones.find(|phone| phone.name == name) {
            Some(phone) => {
                address.clone_into(&mut phone.address);
                Ok(())
            }
            None => Err(ProfileError::Value {
                key: "phones.name",
                found: format!("{name:?}"),
                expected: "the name of one of the phones",
            }),
        }
    }

    fn check_phones(&self) -> Result<(), ProfileError> {
        for (index, phone) in self.all_phones().enumerate() {
            phone.check()?;
            let mut earlier = self.all_phones().take(index);
            if earlier.any(|other| other.name.eq_ignore_ascii_case(&phone.name)) {
                return Err(ProfileError::Value {
                    key: "phones.name",
                    found: format!("{:?} twice", phone.name),
                    expected: "a name of its own for each phone",
                });
            }
        }
        Ok(())
    }

    /// What the sensor on a further output is called.
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

    /// Settings of the board's IMU.
    ///
    /// # Errors
    ///
    /// The sensor has no such setting.
    pub fn imu_config(&self) -> Result<ImuConfig, ProfileError> {
        let imu = &self.imu;
        let value = |key, found: u32, expected| ProfileError::Value {
            key,
            found: found.to_string(),
            expected,
        };
        Ok(ImuConfig {
            divider: Some(imu.rate_hz)
                .filter(|&rate| rate > 0 && 1_000 % rate == 0)
                .and_then(|rate| u8::try_from(1_000 / rate - 1).ok())
                .ok_or_else(|| {
                    value(
                        "imu.rate_hz",
                        imu.rate_hz,
                        "1000 divided by a whole number up to 256",
                    )
                })?,
            low_pass: match imu.low_pass_hz {
                188 => LowPass::Hz188,
                98 => LowPass::Hz98,
                42 => LowPass::Hz42,
                20 => LowPass::Hz20,
                10 => LowPass::Hz10,
                5 => LowPass::Hz5,
                other => {
                    return Err(value("imu.low_pass_hz", other, "188, 98, 42, 20, 10 or 5"));
                }
            },
            gyro_range: match imu.gyro_range_dps {
                250 => GyroRange::Dps250,
                500 => GyroRange::Dps500,
                1_000 => GyroRange::Dps1000,
                2_000 => GyroRange::Dps2000,
                other => {
                    return Err(value("imu.gyro_range_dps", other, "250, 500, 1000 or 2000"));
                }
            },
            accel_range: match imu.accel_range_g {
                2 => AccelRange::G2,
                4 => AccelRange::G4,
                8 => AccelRange::G8,
                16 => AccelRange::G16,
                other => return Err(value("imu.accel_range_g", other, "2, 4, 8 or 16")),
            },
        })
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

    /// The phone's frames to one frame of the depth camera: 1, 2 or 6.
    #[must_use]
    pub const fn frame_ratio(&self) -> u32 {
        30 / self.depth.fps
    }

    /// From the start of exposure of the first row to that of the row that is
    /// synchronised, µs.
    #[must_use]
    pub fn middle_row_us(&self) -> f64 {
        self.phone.middle_row_us()
    }

    fn check(&self) -> Result<(), ProfileError> {
        for (index, sensor) in self.outputs.iter().enumerate() {
            let number = f64::from(sensor.output);
            range("outputs.output", number, 2.0, 4.0, "2, 3 or 4")?;
            let earlier = self.outputs.iter().take(index);
            if earlier.clone().any(|other| other.output == sensor.output) {
                return Err(ProfileError::Value {
                    key: "outputs.output",
                    found: format!("{} twice", sensor.output),
                    expected: "each output once",
                });
            }
            if sensor.name.trim().is_empty() || earlier.clone().any(|o| o.name == sensor.name) {
                return Err(ProfileError::Value {
                    key: "outputs.name",
                    found: format!("{:?}", sensor.name),
                    expected: "a name of its own for each sensor",
                });
            }
            let every = f64::from(sensor.every);
            range("outputs.every", every, 1.0, 30.0, "1 to 30 (pulses)")?;
            range(
                "outputs.delay_us",
                sensor.delay_us,
                0.0,
                1e6,
                "0 to 1000000 (µs)",
            )?;
            range(
                "outputs.width_us",
                sensor.width_us,
                50.0,
                1e6,
                "50 to 1000000 (µs)",
            )?;
        }
        if let Some(lidar) = &self.lidar
            && (lidar.name.trim().is_empty() || self.outputs.iter().any(|o| o.name == lidar.name))
        {
            return Err(ProfileError::Value {
                key: "lidar.name",
                found: format!("{:?}", lidar.name),
                expected: "a name of its own for each sensor",
            });
        }
        if let Some(lidar) = &self.lidar
            && board::gnss::parse_baud(&lidar.baud.to_string()).is_err()
        {
            return Err(ProfileError::Value {
                key: "lidar.baud",
                found: lidar.baud.to_string(),
                expected: "4800, 9600, 19200, 38400, 57600 or 115200 (Bd)",
            });
        }
        let depth = &self.depth;
        let micros = "0 to 1000000 (µs)";
        self.check_phones()?;
        if ![30, 15, 5].contains(&depth.fps) {
            return Err(ProfileError::Value {
                key: "depth.fps",
                found: depth.fps.to_string(),
                expected: "30, 15 or 5",
            });
        }
        let signed = "-1000000 to 1000000 (µs)";
        range(
            "depth.center_offset_us",
            depth.center_offset_us,
            -1e6,
            1e6,
            signed,
        )?;
        range(
            "depth.center_offset_sigma_us",
            depth.center_offset_sigma_us,
            0.0,
            1e6,
            micros,
        )?;
        range(
            "depth.pulse_width_us",
            depth.pulse_width_us,
            8.0,
            10_000.0,
            "8 to 10000 (µs)",
        )?;
        range(
            "align.slew_us",
            self.align.slew_us,
            0.0,
            16_000.0,
            "0 to 16000 (µs)",
        )?;
        range(
            "align.max_offset_sigma_us",
            self.align.max_offset_sigma_us,
            1.0,
            10_000.0,
            "1 to 10000 (µs)",
        )?;
        range(
            "frame_sync.bias_us",
            self.frame_sync.bias_us,
            -1e6,
            1e6,
            signed,
        )?;
        range(
            "frame_sync.bias_sigma_us",
            self.frame_sync.bias_sigma_us,
            0.0,
            1e6,
            micros,
        )?;
        self.imu_config().map(|_| ())
    }
}

fn range(
    key: &'static str,
    value: f64,
    least: f64,
    most: f64,
    expected: &'static str,
) -> Result<(), ProfileError> {
    if value >= least && value <= most {
        Ok(())
    } else {
        Err(ProfileError::Value {
            key,
            found: value.to_string(),
            expected,
        })
    }
}

/// Gives each of the further phones the defaults of what it leaves out; name and
/// address it must have itself.
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
mod tests {
    use super::*;

    #[test]
    fn the_default_profile_is_valid_and_is_the_published_rig() {
        let profile = Profile::published().unwrap();
        assert_eq!(profile.pulse_width(), 576);
        assert_eq!(profile.slew(), 4_800);
        assert_eq!(profile.frame_ratio(), 1);
        assert!((profile.middle_row_us() - 5_503.0).abs() < 1e-9);
        assert_eq!(profile.imu_config().unwrap().divider, 1);
        assert_eq!(profile.phone.learnt, None);
    }

    #[test]
    fn the_commented_examples_are_valid_too() {
        let mut text = String::new();
        for line in DEFAULT.lines() {
            // Examples are comments that look like TOML; prose has no '=' or '['.
            let body = line.strip_prefix("# ").unwrap_or(line);
            let example = body.starts_with('[')
                || body
                    .split_once(" = ")
                    .is_some_and(|(key, _)| !key.contains(' '));
            if line.starts_with("# ") && example {
                if body.starts_with("command") {
                    continue;
                }
                text.push_str(body);
            } else {
                text.push_str(line);
            }
            text.push('\n');
        }
        let profile = Profile::parse(&text, None).unwrap();
        let learnt = profile.phone.learnt.unwrap();
        assert_eq!(learnt.skew, Some(1.2e-5));
        assert!(profile.frame_sync.bias_measured.is_some());
    }

    #[test]
    fn what_is_left_out_has_its_default_and_what_is_unknown_is_an_error() {
        let profile = Profile::parse("[phone]\naddress = \"10.0.0.7\"\n", None).unwrap();
        assert_eq!(profile.phone.address, "10.0.0.7");
        assert_eq!(profile.phone.rows, 1080);

        let error = Profile::parse("[phone]\nadress = \"x\"\n", None).unwrap_err();
        assert!(error.to_string().contains("adress"), "{error}");
        let error = Profile::parse("[phone\n", None).unwrap_err();
        assert!(error.to_string().contains("line 1"), "{error}");
    }

    #[test]
    fn values_out_of_range_name_their_key_and_what_is_expected() {
        for (text, key) in [
            (
                "[[outputs]]\noutput = 5\nname = \"a\"\nevery = 1\n",
                "outputs.output",
            ),
            (
                "[[outputs]]\noutput = 2\nname = \" \"\nevery = 1\n",
                "outputs.name",
            ),
            (
                "[[outputs]]\noutput = 2\nname = \"a\"\nevery = 0\n",
                "outputs.every",
            ),
            ("[lidar]\nname = \"v\"\nbaud = 9601\n", "lidar.baud"),
            ("[lidar]\nname = \"\"\n", "lidar.name"),
            (
                "[[outputs]]\noutput = 2\nname = \"a\"\nevery = 1\n[lidar]\nname = \"a\"\n",
                "lidar.name",
            ),
            ("[depth]\nfps = 25\n", "depth.fps"),
            ("[depth]\npulse_width_us = 5\n", "depth.pulse_width_us"),
            ("[imu]\nrate_hz = 300\n", "imu.rate_hz"),
            ("[imu]\nrate_hz = 0\n", "imu.rate_hz"),
            ("[phone]\nreadout_us = nan\n", "phone.readout_us"),
            ("[phone]\nmiddle_row = 1080\n", "phone.middle_row"),
            ("[frame_sync]\nbias_us = inf\n", "frame_sync.bias_us"),
            ("reference = \"left\"\n", "reference"),
            ("[phone]\nname = \"a/b\"\n", "phone.name"),
            ("[[phones]]\naddress = \"x\"\n", "phone.name"),
            (
                "[[phones]]\nname = \"Phone\"\naddress = \"x\"\n",
                "phones.name",
            ),
            (
                "[[phones]]\nname = \"left\"\naddress = \"x\"\nrows = 1\n",
                "phone.rows",
            ),
        ] {
            let error = Profile::parse(text, None).unwrap_err().to_string();
            assert!(error.contains(key), "{text}: {error}");
            assert!(error.contains("expected"), "{error}");
        }
    }

    #[test]
    fn several_phones_have_defaults_and_one_of_them_is_the_reference() {
        let text = "[phone]\nname = \"left\"\nrows = 720\n\n\
                    [[phones]]\nname = \"right\"\naddress = \"10.0.0.8\"\n";
        let profile = Profile::parse(text, None).unwrap();
        assert_eq!(
            (profile.phone.name.as_str(), profile.phone.rows),
            ("left", 720)
        );
        let right = &profile.phones[0];
        assert_eq!((right.address.as_str(), right.rows), ("10.0.0.8", 1080));

        let other = Profile::parse(&format!("reference = \"right\"\n{text}"), None).unwrap();
        assert_eq!(other.phone, profile.phones[0]);
        assert_eq!(other.phones, [profile.phone]);
        // What a session file keeps reads back as the same.
        let kept = toml::to_string(&other).unwrap();
        assert_eq!(Profile::parse(&kept, None).unwrap(), other);

        let mut moved = other.clone();
        moved.set_address("left=10.0.0.9:7000").unwrap();
        moved.set_address("10.0.0.10").unwrap();
        assert_eq!(moved.phones[0].address, "10.0.0.9:7000");
        assert_eq!(moved.phone.address, "10.0.0.10");
        assert!(moved.set_address("middle=10.0.0.9").is_err());

        let error = Profile::parse("[[phones]]\nname = \"right\"\n", None).unwrap_err();
        assert!(error.to_string().contains("address"), "{error}");
        let alone = Profile::parse("[phone]\nrows = 720\n", None).unwrap();
        assert_eq!(
            (alone.phone.name.as_str(), alone.phones.len()),
            ("phone", 0)
        );
    }
}
