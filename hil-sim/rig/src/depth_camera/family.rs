//! Families of depth cameras that can be bought, as far as makers and users describe them
//! (`docs/parts.md`). What nobody has published is drawn from a range by the seed,
//! so that nothing can rely on it.

use super::{DepthCameraConfig, DepthMode};
use crate::random::{Seed, Stream};
use stm32f4_sim::time::SimDuration;

/// A family.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Family {
    /// The published rig's.
    #[default]
    AzureKinect,
    /// Orbbec's, with the sensor of the former behind another input.
    Femto,
    /// Orbbec's stereo cameras, USB.
    Gemini330,
    /// RealSense D400 in genlock.
    RealSense,
    /// Luxonis, global shutter, frame sync as input.
    Oak,
}

impl Family {
    /// All of them.
    pub const ALL: [Self; 5] = [
        Self::AzureKinect,
        Self::Femto,
        Self::Gemini330,
        Self::RealSense,
        Self::Oak,
    ];

    /// The camera's word in rig profiles.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::AzureKinect => "azure-kinect-dk",
            Self::Femto => "femto-bolt",
            Self::Gemini330 => "gemini-330",
            Self::RealSense => "realsense-d400",
            Self::Oak => "oak",
        }
    }

    /// True if its recorder writes the Azure Kinect's files, and not a bag.
    #[must_use]
    pub fn writes_mkv(self) -> bool {
        matches!(self, Self::AzureKinect | Self::Femto)
    }

    /// Replaces another camera by one of this family. Clock and losses stay.
    #[must_use]
    pub fn specimen(self, camera: DepthCameraConfig, seed: Seed) -> DepthCameraConfig {
        let mut random = seed.stream(Stream::DepthFamily);
        let mut draw = |(from, to): (f64, f64)| random.uniform(from, to);
        let other = DepthCameraConfig {
            // 100 µs by all makers; the effect of shorter pulses is not known.
            shortest_pulse: micros(draw((60.0, 99.0))),
            first_frame: draw((1.0, 5.0)) as u32,
            photodiode: false,
            ..camera
        };
        match self {
            Self::AzureKinect => camera,
            // The time of the first flash is not published.
            Self::Femto => DepthCameraConfig {
                flash_delay: micros(draw((350.0, 4_000.0))),
                ..other
            },
            Self::Gemini330 => shutter(other, draw((150.0, 1_500.0)), draw(EXPOSURE_US)),
            // 790 µs (librealsense #9220).
            Self::RealSense => shutter(other, draw((740.0, 840.0)), draw(EXPOSURE_US)),
            // The exposure ends roughly with the next pulse.
            Self::Oak => {
                let exposure_us = draw(EXPOSURE_US);
                let before_us = draw((50.0, 1_000.0));
                let begins_us = 1e6 / f64::from(DepthCameraConfig::FPS) - before_us - exposure_us;
                shutter(other, begins_us, exposure_us)
            }
        }
    }
}

/// Exposure of a shutter, µs.
const EXPOSURE_US: (f64, f64) = (2_000.0, 12_000.0);

/// Returns the settings of a camera that waits for each pulse, and whose exposure is set.
fn shutter(camera: DepthCameraConfig, begins_us: f64, exposure_us: f64) -> DepthCameraConfig {
    DepthCameraConfig {
        mode: DepthMode::Shutter {
            exposure: micros(exposure_us),
        },
        flash_delay: micros(begins_us),
        free_runs: false,
        ..camera
    }
}

/// Returns a duration given in microseconds, in whole nanoseconds.
pub(crate) fn micros(us: f64) -> SimDuration {
    SimDuration::from_nanos((us * 1e3).round() as u64)
}
