//! Sources of frames.

mod timestamps;
mod video;

use std::path::PathBuf;

pub use timestamps::{FrameTimes, read_timestamps};
pub(crate) use video::Video;

use super::EvaluateError;
use super::frame::GreyView;

/// Facts of an input before its first frame.
#[derive(Debug, Clone, PartialEq)]
pub struct SourceInfo {
    pub path: PathBuf,
    /// Pixels in an image row.
    pub width: usize,
    pub height: usize,
    /// Grey level from which a pixel counts as saturated.
    pub white: u8,
    /// Frames that the file says it holds.
    pub frames: Option<u64>,
    /// When each frame was taken.
    pub times: FrameTimes,
    /// True if the frames went through a video encoder.
    pub encoded: bool,
    /// Remarks for the user about the input; after the last frame also about how it ended.
    pub notes: Vec<String>,
}

/// Frames one after the other. Memory is that of one frame.
pub trait FrameSource {
    /// Facts of the input.
    fn info(&self) -> &SourceInfo;

    /// The next frame, or `None` at the end.
    fn next_frame(&mut self) -> Result<Option<GreyView<'_>>, EvaluateError>;
}
