//! Errors of an extraction.

use std::io;
use std::path::PathBuf;

use crate::depth::DepthError;
use crate::inputs::InputsError;
use crate::output::folder::OutputDirError;

/// Reason why there is no data set, or why a part of it is missing.
#[derive(Debug, thiserror::Error)]
pub enum ExtractError {
    /// There is nothing to extract from.
    #[error(transparent)]
    Inputs(#[from] InputsError),
    /// The output folder cannot be used.
    #[error(transparent)]
    OutputDir(#[from] OutputDirError),
    /// The board's recording cannot be read.
    #[error(transparent)]
    Board(#[from] recording::RecordingError),
    /// A file cannot be written.
    #[error("writing {path}: {error}")]
    Write {
        /// The file, or the output folder.
        path: PathBuf,
        /// The reason.
        #[source]
        error: io::Error,
    },
    /// The depth recording cannot be read.
    #[error(transparent)]
    Depth(#[from] DepthError),
    /// The system starts no further thread.
    #[error("cannot start a thread: {0}")]
    Thread(std::io::Error),
    /// The phone's video cannot be decoded.
    #[error(transparent)]
    Video(#[from] phone::video::VideoError),
    /// A part is missing, for the given reason.
    #[error("{0}")]
    Missing(String),
    /// The extraction was stopped; the next run continues.
    #[error("stopped; run it again to continue")]
    Cancelled,
}

impl ExtractError {
    /// Returns true if the error ends the extraction, false if only one part is missing.
    #[must_use]
    pub const fn is_fatal(&self) -> bool {
        !matches!(self, Self::Missing(_))
    }
}
