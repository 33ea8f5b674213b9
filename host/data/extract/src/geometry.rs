//! Lenses and poses of the cameras, the depth camera's own calibration, and registration of
//! depth images into another camera's view.

pub(crate) mod calibration;
pub(crate) mod lens;
pub(crate) mod register;

use recording::profile::{Direction, Intrinsics, Pose};

use self::register::Registration;

/// Checks that a depth camera's `calibration.json` can be used for a depth mode, as its recorder
/// names it, and for colour images of a size, if there are any.
///
/// # Errors
///
/// Returns what was found and what was expected.
pub fn check_calibration(json: &[u8], mode: &str, color: Option<(u32, u32)>) -> Result<(), String> {
    calibration::read(json, Some(mode), color).map(drop)
}

/// Camera into whose view depth images are registered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum View {
    /// The phone's camera.
    Phone,
    /// The depth camera's colour camera.
    Color,
}

/// Known properties of a camera.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub(crate) struct CameraFacts {
    /// Lens and image size.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) intrinsics: Option<Intrinsics>,
    /// Pose: from the frame of the board's IMU to the camera's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) from_imu: Option<Pose>,
    /// Rolling shutter: time from one row (or column) to the next, ns, and direction of the
    /// readout.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) shutter: Option<(i64, Direction)>,
}

/// Cameras of a recording: the content of `cameras.json`.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub(crate) struct Cameras {
    /// The phone's camera.
    pub(crate) phone: CameraFacts,
    /// The depth camera's colour camera.
    pub(crate) color: CameraFacts,
    /// The camera of the depth images as they are written (after registration).
    pub(crate) depth: CameraFacts,
}

/// View that depth images are written in.
pub(crate) enum DepthView {
    /// The depth camera's own.
    Own,
    /// Another camera's.
    Registered(Box<Registration>),
    /// Another camera's, into which they cannot be registered.
    Unavailable,
}
