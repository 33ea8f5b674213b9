//! How the cameras see and where they are: lenses, the depth camera's own calibration,
//! and depth images as another camera would see them.

pub(crate) mod calibration;
pub(crate) mod lens;
pub(crate) mod register;

use recording::profile::{Direction, Intrinsics, Pose};

/// Whether a depth camera's `calibration.json` can be used, for a depth mode as its recorder
/// names it and the size of the colour images, if there are any.
///
/// # Errors
///
/// What was found and what was expected.
pub fn check_calibration(json: &[u8], mode: &str, color: Option<(u32, u32)>) -> Result<(), String> {
    calibration::read(json, Some(mode), color).map(drop)
}

/// Which camera's view depth images are given in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum View {
    /// The phone's.
    Phone,
    /// That of the depth camera's colour camera.
    Color,
}

/// What is known of one camera.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub(crate) struct CameraFacts {
    /// How it sees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) intrinsics: Option<Intrinsics>,
    /// From the frame of the board's IMU to its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) from_imu: Option<Pose>,
    /// Time from one row (or column) to the next, ns, and where the readout goes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) shutter: Option<(i64, Direction)>,
}

/// The cameras of a recording, as `cameras.json` has them.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub(crate) struct Cameras {
    pub(crate) phone: CameraFacts,
    /// Colour of the depth camera.
    pub(crate) color: CameraFacts,
    /// Depth images as they are written, and infrared as the camera has it.
    pub(crate) depth: CameraFacts,
}
