//! Measurement of frame sync from the depth camera's own strobes.
//!
//! Every exposure of a time-of-flight camera is a train of infrared flashes. A
//! photodiode and an LED strip turn them into visible light on the phone's
//! rolling-shutter sensor, where each flash becomes a bright band of rows. The
//! position of the bands shows when the depth camera was exposed relative to the
//! phone's frame.
//!
//! ## Conventions
//!
//! - *Perfect sync*: the centre of the train (the 5th of 9 flashes) falls on the
//!   centre of exposure of the sensor's middle row. The middle row of `n` rows is
//!   row `(n - 1) / 2`, counted from 0; between the two middle rows for even `n`.
//! - *Bias*: centre of the train minus centre of exposure of the middle row, in
//!   microseconds. Positive: the depth camera is exposed later.
//! - Times are in the depth camera's clock, because row time and bias scale with the
//!   train's pitch. That clock may be off by hundreds of ppm, which is 0.05 µs of a
//!   bias of 100 µs.
//!
//! ## Design
//!
//! | module | contents |
//! |---|---|
//! | [`footage`] | reads a video and reduces each frame to the mean brightness of its rows, so that memory does not depend on the size or length of the video |
//! | [`train`] | the model of the flashes in a frame: coarse search by a matched filter, fit of the whole train, fit of several frames together |
//! | [`track`] | the train's place in every frame of a recording, classes of frames, and the evidence that the bands are flashes |
//! | [`precision`], [`drift`] | the results: bias of each recording with its scatter over recordings, and drift over a long one |
//! | [`shown`] | the profiles and the frame that a report draws |
//! | [`calibrate`] | the measured bias in the rig profile |
//! | [`stats`] | statistics |
//!
//! ## Limits
//!
//! - There is one train in a frame. With a slow read-out a second train can enter at the
//!   edge when the cameras are half a period apart; such frames fit badly.
//! - An exposure that is a whole number of pitches hides the flashes, because every row
//!   sees the same light; a note of the result says so.
//! - The light path's delay must be given by the user (`path_delay_us`).

use serde::Serialize;

pub mod calibrate;
pub mod drift;
mod error;
pub mod footage;
pub mod led;
pub mod precision;
pub mod shown;
pub mod stats;
pub mod track;
pub mod train;

pub use error::EvaluateError;

use footage::{Footage, Region};
use recording::profile::{Direction, Phone};
use system::ReadMonitor;
use train::TrainGeometry;

/// Settings of a measurement: the camera, the train of flashes and the part of the recording.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Settings {
    /// Flashes of one exposure of the depth camera.
    pub train: TrainGeometry,
    /// Direction in the image in which the sensor reads out its rows.
    pub readout: Direction,
    /// Part of the image to use; the whole image if `None`.
    pub region: Option<Region>,
    /// Exposure of a row, µs, if known (to about 2 %).
    pub exposure_us: Option<f64>,
    /// Row time, µs, if known (to about 0.5 %).
    pub row_time_us: Option<f64>,
    /// Readout of the phone in a rig profile; the measured row time must not contradict it.
    #[serde(skip)]
    pub known_readout: Option<KnownReadout>,
    /// Row time found in another recording of the same camera, µs; it is tried first.
    #[serde(skip)]
    pub row_time_hint_us: Option<f64>,
    /// Exposure that the phone reported, µs; it is tried first, and decides between
    /// exposures that differ by whole pitches.
    #[serde(skip)]
    pub exposure_hint_us: Option<f64>,
    /// Expected bias, µs; it decides between biases that differ by whole pitches.
    pub near_us: f64,
    /// Delay of the light path from strobe to LED, µs; it is subtracted from the bias.
    pub path_delay_us: f64,
    /// First second of the recording to use.
    pub from_s: Option<f64>,
    /// Second of the recording to stop at.
    pub to_s: Option<f64>,
    /// Monitor that follows and cancels the reading of recordings.
    #[serde(skip)]
    pub monitor: ReadMonitor,
}

/// Deviation of a row time from the known one that counts as a contradiction, in 1-sigmas.
const CONTRADICTS_SIGMAS: f64 = 3.0;

/// Accepted relative deviation besides, of a video that is cropped or scaled by a few rows.
const ROWS: f64 = 0.02;

/// Largest 1-sigma of a readout that is known, relative to it. A guess contradicts nothing: readouts
/// of phones take 5 to 33 ms.
const KNOWN: f64 = 0.05;

/// Readout of a phone's whole picture as a rig profile states it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownReadout {
    /// Time from the start of exposure of the first row to that of the last, µs.
    pub readout_us: f64,
    /// Its 1-sigma, µs.
    pub sigma_us: f64,
}

impl KnownReadout {
    /// Returns the readout in a phone's profile.
    #[must_use]
    pub const fn of_phone(phone: &Phone) -> Self {
        Self {
            readout_us: phone.readout_us,
            sigma_us: phone.readout_sigma_us,
        }
    }

    /// Returns the row time of a picture with `rows` rows, µs, if it is known as well as
    /// [`Evidence::RowTime`](track::Evidence::RowTime) needs.
    fn exact_row_time_us(&self, rows: usize) -> Option<f64> {
        let is_exact = self.sigma_us <= track::evidence::ROW_TIME_AGREES * self.readout_us;
        is_exact.then(|| self.readout_us / rows.saturating_sub(1).max(1) as f64)
    }

    /// Compares a row time and its 1-sigma, µs, of a picture with `rows` rows. Returns the expected
    /// row time and its 1-sigma if they contradict each other.
    fn contradicts(&self, row_time_us: f64, sigma_us: f64, rows: usize) -> Option<(f64, f64)> {
        let steps = rows.saturating_sub(1).max(1) as f64;
        let (expected, known) = (self.readout_us / steps, self.sigma_us / steps);
        let most = CONTRADICTS_SIGMAS * sigma_us.hypot(known) + ROWS * expected;
        let is_off = (row_time_us - expected).abs() > most;
        (known <= KNOWN * expected && is_off).then_some((expected, known))
    }
}

impl Settings {
    /// Returns the settings with the exposure in the recording's session as a hint, and the readout
    /// of its profile unless another is known.
    fn with_session(&self, footage: &Footage) -> Self {
        let known = footage.applied.map(|a| a.exposure_us);
        let readout = footage.applied.map(|a| a.readout);
        Self {
            known_readout: self.known_readout.or(readout),
            exposure_hint_us: known.filter(|e| (1.0..=1e5).contains(e)),
            ..self.clone()
        }
    }

    /// Checks that every number is possible for a camera.
    ///
    /// # Errors
    ///
    /// Returns [`EvaluateError::Setting`] for the first number that is out of range.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_time_is_compared_with_a_readout_that_is_known() {
        let readout = |sigma_us| KnownReadout {
            readout_us: 11_005.8,
            sigma_us,
        };
        // 180 rows: 61.5 µs a row.
        let contradicts = |sigma_us, row_time_us| {
            let found = readout(sigma_us).contradicts(row_time_us, 0.3, 180);
            found.is_some()
        };
        for row_time_us in [23.0, 53.0, 65.0, 120.0] {
            assert!(contradicts(0.0, row_time_us), "{row_time_us}");
            assert!(!contradicts(3_000.0, row_time_us), "{row_time_us}");
        }
        for row_time_us in [60.0, 61.5, 63.0] {
            assert!(!contradicts(0.0, row_time_us), "{row_time_us}");
        }
    }
}
