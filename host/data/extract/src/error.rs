//! Why an extraction, or a step of it, gives nothing.

use std::io;
use std::path::PathBuf;

use crate::depth::DepthError;
use crate::inputs::InputsError;
use crate::output::folder::OutputDirError;

/// Why there is no data set, or a part of it is missing.
#[derive(Debug, thiserror::Error)]
pub enum ExtractError {
    /// There is nothing to extract from.
    #[error(transparent)]
    Inputs(#[from] InputsError),
    /// The output folder.
    #[error(transparent)]
    OutputDir(#[from] OutputDirError),
    /// The board's recording.
    #[error(transparent)]
    Board(#[from] recording::RecordingError),
    /// A file cannot be written.
    #[error("writing {path}: {error}")]
    Write {
        /// Which, or the output folder.
        path: PathBuf,
        /// Why.
        #[source]
        error: io::Error,
    },
    /// The depth recording.
    #[error(transparent)]
    Depth(#[from] DepthError),
    /// The phone's video.
    #[error(transparent)]
    Video(#[from] phone::video::VideoError),
    /// One part is missing, in words.
    #[error("{0}")]
    Missing(String),
    /// Stopped; the next run continues.
    #[error("stopped; run it again to continue")]
    Cancelled,
}

impl ExtractError {
    /// Whether it ends the extraction. Without a part that is missing, the rest is extracted.
    #[must_use]
    pub const fn is_fatal(&self) -> bool {
        !matches!(self, Self::Missing(_))
    }
}
