//! Frame sync measured from the depth camera's own strobes.
//!
//! Every exposure of a time-of-flight camera is a train of infrared flashes. A
//! photodiode and an LED strip turn them into visible light on the phone's
//! rolling-shutter sensor, where each flash becomes a bright band of rows. Where
//! the bands lie says when the depth camera was exposed relative to the phone's
//! frame.
//!
//! ## Conventions
//!
//! - *Perfect sync*: the centre of the train (the 5th of 9 flashes) falls on the
//!   centre of exposure of the sensor's middle row. The middle row of `n` rows is
//!   row `(n - 1) / 2`, counted from 0; between the two middle rows for even `n`.
//! - *Bias*: centre of the train minus centre of exposure of the middle row, in
//!   microseconds. Positive: the depth camera comes late.
//! - Times are in the camera's clock as far as the train's pitch is known: row
//!   time and bias scale with the pitch. The depth camera's clock may be off by
//!   hundreds of ppm; of a bias of 100 µs that is 0.05 µs.
//!
//! ## Design
//!
//! Frames are reduced to row profiles as they come ([`frame`], [`source`]), so
//! memory does not depend on size or length of a video ([`footage`]). Everything
//! after that is pure computation: a coarse matched filter (`search`), a fit of
//! the whole train (`fit`), of several frames together (`joint`), and the steps from
//! there to a recording's result (`track`).
//!
//! ## Limits
//!
//! - One train a frame. With a slow read-out a second train can enter at the edge
//!   when the cameras are half a period apart; such frames fit badly.
//! - An exposure that is a whole number of pitches hides the flashes (every row
//!   sees the same light); the result says so.
//! - The light path's delay is the user's to state (`path_delay_us`).

use serde::Serialize;

pub mod calibrate;
pub mod classify;
pub mod drift;
mod error;
pub mod evidence;
mod fit;
pub mod footage;
pub mod frame;
pub mod identity;
mod input;
mod joint;
mod lamp;
mod linear;
pub mod precision;
mod search;
pub mod shown;
pub mod source;
pub mod stats;
mod store;
mod track;
pub mod train;
mod window;

pub use error::EvaluateError;

use footage::Footage;
use frame::Region;
use recording::profile::Direction;
use system::ReadMonitor;
use train::TrainGeometry;

/// Settings of the user about camera and train.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Settings {
    /// Flashes of one exposure of the depth camera.
    pub train: TrainGeometry,
    /// Which way the sensor reads out, in the image.
    pub readout: Direction,
    /// Part of the image to look at.
    pub region: Option<Region>,
    /// Exposure of a row, µs, if known (to about 2 %).
    pub exposure_us: Option<f64>,
    /// Row time, µs, if known (to about 0.5 %).
    pub row_time_us: Option<f64>,
    /// Row time found in another recording of the same camera, µs: tried first.
    #[serde(skip)]
    pub row_time_hint_us: Option<f64>,
    /// Exposure that the phone reported, µs: tried first, and decides where whole
    /// pitches of exposure are open.
    #[serde(skip)]
    pub exposure_hint_us: Option<f64>,
    /// Bias that is expected, µs: decides where whole pitches are open.
    pub near_us: f64,
    /// Delay of the light path from strobe to LED, µs; subtracted.
    pub path_delay_us: f64,
    /// First second of the recording to use.
    pub from_s: Option<f64>,
    /// Second of the recording to stop at.
    pub to_s: Option<f64>,
    /// Follows and cancels the reading of recordings.
    #[serde(skip)]
    pub monitor: ReadMonitor,
}

impl Settings {
    /// With the exposure that the recording's session knows, as a hint.
    fn with_session(&self, footage: &Footage) -> Self {
        let known = footage.applied.map(|a| a.exposure_us);
        Self {
            exposure_hint_us: known.filter(|e| (1.0..=1e5).contains(e)),
            ..self.clone()
        }
    }

    /// Checks that every number is one that a camera can have.
    pub fn check(&self) -> Result<(), EvaluateError> {
        self.train.check()?;
        let wrong = |what: &str, value: f64, expected: &str| {
            Err(EvaluateError::Setting(format!(
                "{what} of {value} is not possible: expected {expected}"
            )))
        };
        if let Some(t) = self.row_time_us.filter(|t| !(0.5..=500.0).contains(t)) {
            return wrong("a row time", t, "0.5 to 500 µs");
        }
        if let Some(e) = self.exposure_us.filter(|e| !(1.0..=1e5).contains(e)) {
            return wrong("an exposure", e, "1 to 100000 µs");
        }
        if !self.near_us.is_finite() || self.near_us.abs() > 1e6 {
            return wrong("an expected bias", self.near_us, "at most 1000000 µs");
        }
        if !self.path_delay_us.is_finite() || self.path_delay_us.abs() > 1e5 {
            return wrong("a delay", self.path_delay_us, "at most 100000 µs");
        }
        let seconds = |v: Option<f64>| v.is_none_or(|s| s.is_finite() && s >= 0.0);
        let ordered = self.from_s.zip(self.to_s).is_none_or(|(a, b)| a < b);
        if !seconds(self.from_s) || !seconds(self.to_s) || !ordered {
            return Err(EvaluateError::Setting(
                "start and end must be seconds since the first frame, the start before the end"
                    .to_owned(),
            ));
        }
        Ok(())
    }
}
