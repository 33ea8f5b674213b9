//! What the user of an extraction gives.

use std::path::PathBuf;

use recording::profile::Profile;

use crate::geometry::View;

/// What the user gives.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct Options {
    /// In place of the recording's own, but for its other phones.
    pub profile: Option<Profile>,
    /// Index of the first depth frame's pulse.
    pub first_pulse: Option<usize>,
    /// The topic of depth in a bag of the camera's driver, if there are several.
    pub depth_topic: Option<String>,
    /// Whether pairs from outside the aligned span, and those further apart than
    /// 10 ms, are taken too.
    pub all_pairs: bool,
    /// Whether infrared images are written too.
    pub infrared: bool,
    /// The camera from whose place depth images are given.
    pub view: Option<View>,
    /// Where the files of phones lie, by their names in the rig profile.
    #[serde(skip)]
    pub phones: Vec<(String, PathBuf)>,
}
