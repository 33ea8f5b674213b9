//! The strobe train of a time-of-flight camera, and its image on a rolling shutter.
//!
//! Times here are microseconds relative to the centre of exposure of the image's
//! middle row. The light that a row exposed around `x` gets from a flash around
//! `f` is the overlap of two boxes, a trapezoid in `x - f`:
//! `min(exposure, duration, (exposure + duration)/2 - |x - f|) / duration`, never
//! below zero. Its centre does not depend on the exposure, so the middle of a band can be
//! found even if the exposure is hardly known.

pub(crate) mod fit;
pub(crate) mod joint;
pub(crate) mod linear;
pub(crate) mod search;

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::EvaluateError;

/// Flashes of one exposure of the depth camera.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TrainGeometry {
    /// Number of flashes.
    pub count: u32,
    /// Time from the start of one flash to the start of the next, µs.
    pub pitch_us: f64,
    /// Length of one flash, µs.
    pub duration_us: f64,
}

impl Default for TrainGeometry {
    fn default() -> Self {
        Self::NFOV
    }
}

impl TrainGeometry {
    /// Azure Kinect, narrow field of view, and the binned mode of the wide one: 9
    /// flashes of 125 µs, 1,450 µs between them, 12.8 ms in all (the vendor's page on
    /// multiple synchronised devices, table of the raw timing).
    pub const NFOV: Self = Self {
        count: 9,
        pitch_us: 1575.0,
        duration_us: 125.0,
    };
    /// Azure Kinect, wide field of view without binning: 9 flashes of 125 µs, 2,390 µs
    /// between them, 20.3 ms in all.
    pub const WFOV: Self = Self {
        count: 9,
        pitch_us: 2515.0,
        duration_us: 125.0,
    };

    /// Checks that the numbers describe a train: 2 to 64 flashes that do not touch.
    pub(crate) fn check(self) -> Result<Self, EvaluateError> {
        let fits = (2..=64).contains(&self.count)
            && self.pitch_us.is_finite()
            && self.duration_us.is_finite()
            && self.duration_us >= 1.0
            && self.pitch_us >= 2.0 * self.duration_us
            && self.pitch_us <= 1e5;
        if fits {
            Ok(self)
        } else {
            Err(no_train(&self.to_string()))
        }
    }

    /// Returns the index of the flash at the centre of exposure; between two flashes if
    /// their number is even.
    pub(crate) fn center_index(&self) -> f64 {
        0.5 * (f64::from(self.count) - 1.0)
    }

    /// Returns the centre of flash `k` of a train that is centred at `bias_us`, µs.
    pub(crate) fn flash_us(&self, k: u32, bias_us: f64) -> f64 {
        bias_us + (f64::from(k) - self.center_index()) * self.pitch_us
    }
}

impl fmt::Display for TrainGeometry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{},{},{}", self.count, self.pitch_us, self.duration_us)
    }
}

impl FromStr for TrainGeometry {
    type Err = EvaluateError;

    /// Parses `nfov`, `wfov`, the name of a depth mode as the camera's recorder accepts it, or
    /// `COUNT,PITCH_US,DURATION_US`.
    fn from_str(s: &str) -> Result<Self, Self::Err> {
        match s.to_ascii_lowercase().as_str() {
            "nfov" | "nfov_unbinned" | "nfov_2x2binned" | "wfov_2x2binned" => {
                return Ok(Self::NFOV);
            }
            "wfov" | "wfov_unbinned" => return Ok(Self::WFOV),
            _ => {}
        }
        let wrong = || no_train(s);
        let parts: Vec<&str> = s.split(',').map(str::trim).collect();
        let [count, pitch, duration] = parts.as_slice() else {
            return Err(wrong());
        };
        Self {
            count: count.parse().map_err(|_| wrong())?,
            pitch_us: pitch.parse().map_err(|_| wrong())?,
            duration_us: duration.parse().map_err(|_| wrong())?,
        }
        .check()
    }
}

fn no_train(text: &str) -> EvaluateError {
    EvaluateError::Setting(format!(
        "`{text}` is not a strobe train: give `nfov`, `wfov`, a depth mode such as WFOV_2X2BINNED, \
         or COUNT,PITCH_US,DURATION_US, for example 9,1575,125 (2 to 64 flashes, pitch at least \
         twice the duration)"
    ))
}

/// Parameters of the train's shape in the image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shape {
    /// Centre of the train relative to the middle row's centre of exposure, µs.
    pub bias_us: f64,
    /// Time from one row's exposure to the next row's, µs.
    pub row_time_us: f64,
    /// Exposure of a row, µs.
    pub exposure_us: f64,
}

impl Shape {
    /// Returns the same shape with another centre of the train.
    pub(crate) fn at(self, bias_us: f64) -> Self {
        Self { bias_us, ..self }
    }
}

/// Light of one row and its derivatives, in units of one whole flash.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct RowLight {
    /// Number of flashes that the row sees: 1 is one whole flash.
    pub value: f64,
    /// Derivative with respect to the train's centre, 1/µs.
    pub by_bias: f64,
    /// Derivative with respect to the row time, rows/µs.
    pub by_row_time: f64,
    /// Derivative with respect to the exposure, 1/µs.
    pub by_exposure: f64,
}

/// Returns the share of one flash that a row sees whose exposure is centred `distance_us` away.
pub(crate) fn overlap(distance_us: f64, exposure_us: f64, duration_us: f64) -> f64 {
    let ramp = 0.5 * (exposure_us + duration_us) - distance_us.abs();
    ramp.min(exposure_us).min(duration_us).max(0.0) / duration_us
}

/// Returns the light of the row that is `position` rows after the middle row.
pub fn row_light(train: &TrainGeometry, shape: &Shape, position: f64) -> RowLight {
    let x = position * shape.row_time_us - shape.bias_us;
    let reach = 0.5 * (shape.exposure_us + train.duration_us);
    let center = train.center_index();
    let last = f64::from(train.count) - 1.0;
    // Only the flashes that reach this row.
    let first = ((x - reach) / train.pitch_us + center).ceil().max(0.0);
    let until = ((x + reach) / train.pitch_us + center).floor().min(last);
    let plateau = shape.exposure_us.min(train.duration_us);
    let mut light = RowLight::default();
    let mut k = first;
    while k <= until {
        let distance = x - (k - center) * train.pitch_us;
        let ramp = reach - distance.abs();
        if ramp >= plateau {
            light.value += plateau / train.duration_us;
            if shape.exposure_us < train.duration_us {
                light.by_exposure += 1.0 / train.duration_us;
            }
        } else if ramp > 0.0 {
            light.value += ramp / train.duration_us;
            let slope = distance.signum() / train.duration_us;
            light.by_bias += slope;
            light.by_row_time -= slope * position;
            light.by_exposure += 0.5 / train.duration_us;
        }
        k += 1.0;
    }
    light
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_and_custom_trains_parse() {
        assert_eq!(
            "NFOV".parse::<TrainGeometry>().unwrap(),
            TrainGeometry::NFOV
        );
        assert_eq!(
            "wfov".parse::<TrainGeometry>().unwrap(),
            TrainGeometry::WFOV
        );
        let mode = |name: &str| name.parse::<TrainGeometry>().unwrap();
        assert_eq!(mode("WFOV_2X2BINNED"), TrainGeometry::NFOV);
        assert_eq!(mode("NFOV_UNBINNED"), TrainGeometry::NFOV);
        assert_eq!(mode("WFOV_UNBINNED"), TrainGeometry::WFOV);
        let custom: TrainGeometry = "5, 2000, 100".parse().unwrap();
        assert_eq!((custom.count, custom.pitch_us), (5, 2000.0));
        for bad in [
            "",
            "nfow",
            "9,1575",
            "1,1575,125",
            "9,100,125",
            "9,NaN,125",
            "9,inf,1",
        ] {
            let e = bad.parse::<TrainGeometry>().unwrap_err().to_string();
            assert!(e.contains("nfov"), "{bad}: {e}");
        }
    }

    #[test]
    fn overlap_is_the_overlap_of_two_boxes() {
        for (distance, exposure, duration) in [
            (0.0, 500.0, 125.0),
            (0.0, 50.0, 125.0),
            (200.0, 500.0, 125.0),
            (80.0, 50.0, 125.0),
            (400.0, 500.0, 125.0),
        ] {
            let (d, e, f): (f64, f64, f64) = (distance, exposure, duration);
            let direct = ((d + e / 2.0).min(f / 2.0) - (d - e / 2.0).max(-f / 2.0)).max(0.0) / f;
            assert!((overlap(d, e, f) - direct).abs() < 1e-12, "{d} {e} {f}");
        }
    }

    #[test]
    fn derivatives_match_differences() {
        let train = TrainGeometry::NFOV;
        for exposure_us in [97.0, 310.0, 3900.0] {
            let shape = Shape {
                bias_us: 33.3,
                row_time_us: 10.2,
                exposure_us,
            };
            let mut ramps = 0;
            for row in -540..540 {
                let p = f64::from(row) + 0.5;
                let light = row_light(&train, &shape, p);
                let h = 1e-4;
                let value = |bias_us: f64, exposure_us: f64| {
                    let (bias_us, exposure_us) =
                        (shape.bias_us + bias_us, shape.exposure_us + exposure_us);
                    let moved = Shape {
                        bias_us,
                        exposure_us,
                        ..shape
                    };
                    row_light(&train, &moved, p).value
                };
                let by_bias = (value(h, 0.0) - value(-h, 0.0)) / (2.0 * h);
                let by_exposure = (value(0.0, h) - value(0.0, -h)) / (2.0 * h);
                assert!((light.by_bias - by_bias).abs() < 1e-6, "row {row}");
                assert!((light.by_exposure - by_exposure).abs() < 1e-6, "row {row}");
                assert!((light.by_row_time + light.by_bias * p).abs() < 1e-9);
                ramps += usize::from(light.by_bias != 0.0);
            }
            assert!(ramps > 100, "{ramps} rows on a ramp");
        }
    }
}
