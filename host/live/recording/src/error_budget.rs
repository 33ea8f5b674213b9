//! Uncertainty between the exposures of the two cameras: its parts, and its description in words.

use serde::{Deserialize, Serialize};

/// Total 1-sigma, µs, from which cameras are not known to expose together: a moving hand is
/// blurred by as much.
pub const COARSE_US: f64 = 1_000.0;

/// A part of the total uncertainty between the middles of the two exposures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ErrorPart {
    /// The measured bias.
    #[default]
    Bias,
    /// The assumed time from the trigger's edge to the middle of the depth exposure.
    DepthCenter,
    /// That time, as a photodiode has measured it.
    MeasuredDepth,
    /// That time, measured with another camera, mode or rate.
    StaleDepth,
    /// The assumed delay of the phone's gyroscope.
    GyroDelay,
    /// The assumed readout time of the phone.
    Readout,
    /// Both of the phone's constants, as the board's LED has measured them.
    MeasuredPhone,
    /// Both, measured at another exposure or with another phone.
    StalePhone,
    /// The phone's exposure, which may change.
    Exposure,
    /// The relation of the clocks, and the phone's frame period.
    Clocks,
}

impl ErrorPart {
    /// Returns the part in words.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::Bias => "the measured bias",
            Self::DepthCenter => "the assumed centre of the depth exposure",
            Self::MeasuredDepth => "the measured centre of the depth exposure",
            Self::StaleDepth => "the depth exposure, measured in another mode",
            Self::MeasuredPhone => "the phone's rows, measured with the LED",
            Self::StalePhone => {
                "the phone's rows, measured at another exposure or with another phone"
            }
            Self::GyroDelay => "the assumed delay of the phone's gyroscope",
            Self::Readout => "the assumed readout of the phone",
            Self::Exposure => "an exposure that is not known to be locked",
            Self::Clocks => "clocks and frame period",
        }
    }
}

/// Describes how well the cameras expose together: total 1-sigma, µs, and its largest part.
#[must_use]
pub fn together(sigma_us: f64, largest: Option<ErrorPart>) -> String {
    let part = largest.map_or(String::new(), |part| {
        format!(", most of it from {}", part.text())
    });
    format!(
        "cameras expose together to ± {} (1-sigma){part}",
        micros_text(sigma_us)
    )
}

/// Formats a span given in µs; one of a millisecond and more in ms.
#[must_use]
pub fn micros_text(micros: f64) -> String {
    if micros.abs() < 1_000.0 {
        format!("{micros:.1} µs")
    } else {
        format!("{:.1} ms", micros * 1e-3)
    }
}
