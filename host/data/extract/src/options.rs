//! Choices of the user for an extraction.

use std::path::PathBuf;

use recording::profile::Profile;

use crate::geometry::View;

/// Choices of the user.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct Options {
    /// Rig profile in place of the recording's own, except for its other phones.
    pub profile: Option<Profile>,
    /// Index of the pulse that made the first depth frame.
    pub first_pulse: Option<usize>,
    /// Topic of depth in a bag of the camera's driver, if there are several.
    pub depth_topic: Option<String>,
    /// True to keep pairs from outside the aligned span, and those farther apart than 10 ms.
    pub all_pairs: bool,
    /// True to write infrared images.
    pub infrared: bool,
    /// Camera into whose view depth images are registered.
    pub view: Option<View>,
    /// Folders of phones' files, by their names in the rig profile.
    #[serde(skip)]
    pub phones: Vec<(String, PathBuf)>,
}
