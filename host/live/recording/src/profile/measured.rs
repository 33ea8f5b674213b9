//! Middle of the depth exposure as a photodiode has measured it, and the conditions under which
//! that holds.

use std::path::Path;

use jiff::civil::Date;
use serde::{Deserialize, Serialize};
use toml_edit::{InlineTable, value};

use super::edit::{open, set, table};
use super::{Depth, Profile, ProfileError};
use crate::camera::Model;
use crate::error_budget::ErrorPart;
use crate::strobes::{SeenExposures, StrobeTrain};

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

/// Writes a measured time from the trigger's edge to the middle of the depth exposure (µs, with
/// its 1-sigma) into the text of a profile, for its camera and mode. The total with a bias that was
/// measured on video stays as it is.
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
    let (depth, sync) = (&profile.depth, &profile.frame_sync);
    if sync.bias_measured.is_some() || sync.bias_us != 0.0 {
        let bias_us = sync.bias_us + depth.center_offset_us - center_us;
        set(
            table(&mut document, "frame_sync", path)?,
            "bias_us",
            rounded(bias_us),
        );
    }
    let table = table(&mut document, "depth", path)?;
    set(table, "center_offset_us", rounded(center_us));
    set(table, "center_offset_sigma_us", rounded(sigma_us));
    let mut measured = InlineTable::new();
    measured.insert("date", date.to_string().into());
    measured.insert("camera", depth.camera.as_str().into());
    measured.insert("mode", depth.mode.as_str().into());
    measured.insert("fps", i64::from(depth.fps).into());
    set(table, "measured", value(measured));
    let text = document.to_string();
    Profile::parse(&text, Some(path))?;
    Ok(text)
}

/// A nanosecond is fine enough.
fn rounded(us: f64) -> toml_edit::Item {
    value((us * 1e3).round() / 1e3)
}
