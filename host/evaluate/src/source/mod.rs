//! Sources of frames: videos, folders of images.

mod images;
mod timestamps;
mod video;

use std::path::{Path, PathBuf};

pub use timestamps::{FrameTimes, read_timestamps};

use super::EvaluateError;
use super::frame::{GreyView, MAX_SIDE};

/// Facts of an input before its first frame.
#[derive(Debug, Clone, PartialEq)]
pub struct SourceInfo {
    /// The file or folder.
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

/// Opens a video, a folder of images or a single image.
pub(crate) fn open(
    path: &Path,
    timestamps: Option<&Path>,
) -> Result<Box<dyn FrameSource>, EvaluateError> {
    let metadata = std::fs::metadata(path).map_err(EvaluateError::io(path))?;
    if metadata.is_dir() || images::is_image(path) {
        Ok(Box::new(images::ImageFolder::open(path, timestamps)?))
    } else {
        Ok(Box::new(video::Video::open(path, timestamps)?))
    }
}

fn check_size(path: &Path, width: u64, height: u64) -> Result<(usize, usize), EvaluateError> {
    let side = |n: u64| {
        usize::try_from(n)
            .ok()
            .filter(|n| (1..=MAX_SIDE).contains(n))
    };
    match (side(width), side(height)) {
        (Some(w), Some(h)) => Ok((w, h)),
        _ => Err(EvaluateError::Unsupported {
            path: path.to_owned(),
            width,
            height,
        }),
    }
}
