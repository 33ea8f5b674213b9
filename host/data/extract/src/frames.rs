//! Frames of the phone and of the depth camera.

pub(crate) mod pairs;
pub(crate) mod trigger_offset;
pub(crate) mod video_rows;
