//! Sources of frames.

mod timestamps;
mod video;

use std::path::PathBuf;

pub use timestamps::{FrameTimes, read_timestamps};
pub(crate) use video::Video;

use crate::EvaluateError;
use crate::footage::frame::GreyView;

/// Properties of a source that are known before its first frame.
#[derive(Debug, Clone, PartialEq)]
pub struct SourceInfo {
    /// Path of the video.
    pub path: PathBuf,
    /// Pixels in an image row.
    pub width: usize,
    /// Number of image rows.
    pub height: usize,
    /// Grey level from which a pixel counts as saturated.
    pub white: u8,
    /// Number of frames by the file's header.
    pub frames: Option<u64>,
    /// Times of the frames.
    pub times: FrameTimes,
    /// True if the frames went through a video encoder.
    pub encoded: bool,
    /// Remarks for the user about the input; after the last frame also about its end.
    pub notes: Vec<String>,
}

/// Source of frames one after the other, which needs the memory of one frame.
pub trait FrameSource {
    /// Returns the properties of the source.
    fn info(&self) -> &SourceInfo;

    /// Reads the next frame; returns `None` at the end.
    ///
    /// # Errors
    ///
    /// Fails if the frame cannot be read.
    fn next_frame(&mut self) -> Result<Option<GreyView<'_>>, EvaluateError>;
}
