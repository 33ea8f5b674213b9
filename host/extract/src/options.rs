//! What the user of an extraction gives.

use std::path::PathBuf;

use super::geometry::View;

/// Values that the user gives; they go before those of the session.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct Options {
    /// Exposure of a row of the phone, ns.
    pub exposure_ns: Option<i64>,
    /// From the first to the last row of the phone, ns.
    pub readout_ns: Option<i64>,
    /// From the trigger pulse to the depth timestamp, ns.
    pub depth_center_ns: Option<i64>,
    /// Low-pass delay of the board's IMU, ns.
    pub board_imu_delay_ns: Option<i64>,
    /// Low-pass delay of the phone's gyroscope, ns.
    pub phone_imu_delay_ns: Option<i64>,
    /// Index of the first depth frame's pulse.
    pub first_pulse: Option<usize>,
    /// The topic of depth in a bag of the camera's driver, if there are several.
    pub depth_topic: Option<String>,
    /// Whether pairs from outside the aligned span, and those further apart than
    /// 10 ms, are taken too.
    pub all_pairs: bool,
    /// Whether infrared images are written too.
    pub infrared: bool,
    /// Exposure of the depth camera's colour images, ns.
    pub camera_exposure_ns: Option<i64>,
    /// The camera from whose place depth images are given.
    pub view: Option<View>,
    /// Depth frames are timed by the camera's own clock, whatever the trigger did.
    pub free_running: bool,
    /// Where the files of phones lie, by their names in the rig profile.
    #[serde(skip)]
    pub phones: Vec<(String, PathBuf)>,
}
