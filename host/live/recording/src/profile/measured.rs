//! Constants that a photodiode and the board's LED have measured, and the conditions under which
//! they hold.

use std::path::Path;

use jiff::civil::Date;
use serde::{Deserialize, Serialize};
use toml_edit::{InlineTable, Table, Value, value};

use super::edit::{open, phone_table, set, table};
use super::{Depth, Direction, Phone, Profile, ProfileError};
use crate::camera::Model;
use crate::error_budget::ErrorPart;
use crate::strobes::{SeenExposures, StrobeTrain};

/// Part by which an exposure may differ from that of a measurement.
const SAME_EXPOSURE: f64 = 0.02;

/// Measurement of the time from the trigger's edge to the middle of the depth exposure.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeasuredDepth {
    /// Day.
    pub date: Date,
    /// Model of the camera.
    pub camera: String,
    /// Depth mode.
    pub mode: String,
    /// Pulses per second.
    pub fps: u32,
}

impl MeasuredDepth {
    /// Describes a measurement of a camera as the profile has it.
    #[must_use]
    pub fn of(depth: &Depth, date: Date) -> Self {
        Self {
            date,
            camera: depth.camera.clone(),
            mode: depth.mode.clone(),
            fps: depth.fps,
        }
    }

    /// Returns true if the camera is the same still, in the same mode and at the same rate.
    #[must_use]
    pub fn holds_for(&self, depth: &Depth) -> bool {
        *self == Self::of(depth, self.date)
    }
}

/// Measurement of the phone's rows against its clocks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeasuredPhone {
    /// Day.
    pub date: Date,
    /// Name of the phone.
    pub phone: String,
    /// Exposure of a row, µs.
    pub exposure_us: f64,
    /// Version of the app.
    pub app: Option<String>,
}

/// The rows of a phone as the LED has shown them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PhoneRows {
    /// Delay of the gyroscope with which frame timestamps convert to the middle of exposure of the
    /// middle row, µs, and its 1-sigma.
    pub gyro_delay_us: [f64; 2],
    /// Time from the start of exposure of the first row to that of the last, µs, and its 1-sigma.
    pub readout_us: [f64; 2],
    /// Direction of the readout.
    pub direction: Direction,
}

impl Depth {
    /// Returns the flashes of its mode; none if the model is not known to flash.
    #[must_use]
    pub fn train(&self) -> Option<StrobeTrain> {
        self.model()?.mode(&self.mode)?.train
    }

    /// Sets the time from the edge to the middle of exposure to that which a photodiode sees today.
    pub fn set_measured(&mut self, seen: &SeenExposures, date: Date) {
        self.center_offset_us = seen.center_us;
        self.center_offset_sigma_us = seen.sigma_us;
        self.measured = Some(MeasuredDepth::of(self, date));
    }

    /// Returns the part of the error budget that the time from the edge to the middle of exposure
    /// is, and its 1-sigma, µs. A measurement in another mode counts as none.
    #[must_use]
    pub fn center_part(&self) -> (ErrorPart, f64) {
        let sigma_us = self.center_offset_sigma_us;
        match &self.measured {
            None => (ErrorPart::DepthCenter, sigma_us),
            Some(measured) if measured.holds_for(self) => (ErrorPart::MeasuredDepth, sigma_us),
            Some(_) => {
                // Of a mode that no file has, as little is known as of any.
                let modes = Model::all().iter().flat_map(Model::modes);
                let mode = self.model().and_then(|model| model.mode(&self.mode));
                let assumed = mode.map_or_else(
                    || modes.map(|mode| mode.sigma_us).fold(0.0, f64::max),
                    |mode| mode.sigma_us,
                );
                (ErrorPart::StaleDepth, assumed.max(sigma_us))
            }
        }
    }
}

impl Phone {
    /// Returns the parts of the error budget that the phone's own constants are, and their
    /// 1-sigmas, µs. What was measured at another exposure moves by up to half the difference if
    /// timestamps are not the start of exposure.
    #[must_use]
    pub fn own_parts(&self, exposure_us: f64) -> Vec<(ErrorPart, f64)> {
        let Some(measured) = &self.measured else {
            let readout_us = self.readout_sigma_us * self.middle_row_part();
            return vec![
                (ErrorPart::GyroDelay, self.gyro_delay_sigma_us),
                (ErrorPart::Readout, readout_us),
            ];
        };
        if measured.phone != self.name {
            let mut phone = self.clone();
            phone.forget();
            return vec![(ErrorPart::StalePhone, phone.constant_sigma_us())];
        }
        let change_us = (exposure_us - measured.exposure_us).abs();
        let sigma_us = self.constant_sigma_us();
        if change_us <= SAME_EXPOSURE * measured.exposure_us {
            vec![(ErrorPart::MeasuredPhone, sigma_us)]
        } else {
            vec![(ErrorPart::StalePhone, sigma_us.hypot(0.5 * change_us))]
        }
    }

    /// Replaces a measurement that was made with another version of the app, 1-sigmas included.
    /// Returns the version of the measurement if it was.
    pub fn forget_if_other_app(&mut self, app: Option<&str>) -> Option<String> {
        let of = self.measured.as_ref()?.app.as_deref()?;
        if app.is_none_or(|app| app == of) {
            return None;
        }
        let of = of.to_owned();
        self.forget();
        Some(of)
    }

    /// Takes the constants for assumed.
    fn forget(&mut self) {
        self.measured = None;
        if let Ok(Profile { phone: assumed, .. }) = Profile::published() {
            self.gyro_delay_sigma_us = self.gyro_delay_sigma_us.max(assumed.gyro_delay_sigma_us);
            self.readout_sigma_us = self.readout_sigma_us.max(assumed.readout_sigma_us);
        }
    }
}

impl Profile {
    /// Returns true if the constant between the two exposures was measured for the phone's
    /// exposure, µs, as a whole or in both its halves.
    #[must_use]
    pub fn is_constant_measured(&self, exposure_us: f64) -> bool {
        let is_assumed = |part: ErrorPart| match part {
            ErrorPart::DepthCenter
            | ErrorPart::StaleDepth
            | ErrorPart::GyroDelay
            | ErrorPart::Readout
            | ErrorPart::StalePhone => true,
            ErrorPart::MeasuredDepth
            | ErrorPart::MeasuredPhone
            | ErrorPart::Bias
            | ErrorPart::Exposure
            | ErrorPart::Clocks => false,
        };
        let parts = self.constant_parts(exposure_us);
        !parts.into_iter().any(|(part, _)| is_assumed(part))
    }
}

/// Writes a measured time from the trigger's edge to the middle of the depth exposure (µs, with
/// its 1-sigma) into the text of a profile, for its camera and mode. Its total with a bias that
/// was measured before stays, until the phone's half is measured too.
///
/// # Errors
///
/// Returns an error if the text is not a valid profile, before or after.
pub fn with_depth(
    text: &str,
    path: &Path,
    [center_us, sigma_us]: [f64; 2],
    date: Date,
) -> Result<String, ProfileError> {
    let (profile, mut document) = open(text, path)?;
    let depth = &profile.depth;
    let moved_us = depth.center_offset_us - center_us;
    set_bias(
        &mut document,
        &profile,
        moved_us,
        profile.phone.measured.is_some(),
        path,
    )?;
    let table = table(&mut document, "depth", path)?;
    set(table, "center_offset_us", rounded(center_us));
    set(table, "center_offset_sigma_us", rounded(sigma_us));
    let conditions = [
        ("camera", Value::from(depth.camera.as_str())),
        ("mode", depth.mode.as_str().into()),
        ("fps", i64::from(depth.fps).into()),
    ];
    set_measured(table, date, conditions);
    checked(&document, path)
}

/// Writes the measured rows of a phone into the text of a profile, with the conditions of the
/// measurement.
///
/// # Errors
///
/// As [`with_depth`].
pub fn with_phone(
    text: &str,
    path: &Path,
    rows: &PhoneRows,
    measured: &MeasuredPhone,
) -> Result<String, ProfileError> {
    let (profile, mut document) = open(text, path)?;
    let name = measured.phone.as_str();
    let known = profile.all_phones().find(|phone| phone.name == name);
    let phone = known.unwrap_or(&profile.phone);
    if phone.name == profile.phone.name {
        // A larger delay makes the board times of frames later.
        let moved_us = rows.gyro_delay_us[0] - phone.gyro_delay_us
            + 0.5 * (rows.readout_us[0] - phone.readout_us);
        set_bias(
            &mut document,
            &profile,
            moved_us,
            profile.depth.measured.is_some(),
            path,
        )?;
    }
    let table = phone_table(&mut document, &profile, Some(name), path)?;
    let [delay_us, delay_sigma_us] = rows.gyro_delay_us;
    let [readout_us, readout_sigma_us] = rows.readout_us;
    set(table, "gyro_delay_us", rounded(delay_us));
    set(table, "gyro_delay_sigma_us", rounded(delay_sigma_us));
    set(table, "readout_us", rounded(readout_us));
    set(table, "readout_sigma_us", rounded(readout_sigma_us));
    set(table, "readout_direction", value(rows.direction.name()));
    let conditions = [
        ("phone", Value::from(measured.phone.as_str())),
        ("exposure_us", measured.exposure_us.into()),
    ];
    let app = measured.app.as_deref().map(|app| ("app", app.into()));
    set_measured(table, measured.date, conditions.into_iter().chain(app));
    checked(&document, path)
}

/// Changes a bias that was measured as a whole by as much as another constant takes over; removes
/// it once both halves are measured.
fn set_bias(
    document: &mut toml_edit::DocumentMut,
    profile: &Profile,
    change_us: f64,
    is_other_measured: bool,
    path: &Path,
) -> Result<(), ProfileError> {
    let sync = &profile.frame_sync;
    if is_other_measured {
        let table = table(document, "frame_sync", path)?;
        set(table, "bias_us", value(0.0));
        set(table, "bias_sigma_us", value(0.0));
        table.remove("bias_measured");
    } else if sync.bias_measured.is_some() || sync.bias_us != 0.0 {
        let table = table(document, "frame_sync", path)?;
        set(table, "bias_us", rounded(sync.bias_us + change_us));
    }
    Ok(())
}

fn set_measured<'a>(
    table: &mut Table,
    date: Date,
    conditions: impl IntoIterator<Item = (&'a str, Value)>,
) {
    let mut measured = InlineTable::new();
    measured.insert("date", date.to_string().into());
    measured.extend(conditions);
    set(table, "measured", value(measured));
}

/// A nanosecond is fine enough.
fn rounded(us: f64) -> toml_edit::Item {
    value((us * 1e3).round() / 1e3)
}

fn checked(document: &toml_edit::DocumentMut, path: &Path) -> Result<String, ProfileError> {
    let text = document.to_string();
    Profile::parse(&text, Some(path))?;
    Ok(text)
}
