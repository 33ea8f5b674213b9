//! Error of an estimate over whole recordings.

use std::error::Error;

/// Failure to relate two recordings, which are read with errors of type `E`.
#[derive(Debug, thiserror::Error)]
pub enum CourseError<E: Error + 'static> {
    /// Reading one of the recordings failed.
    #[error(transparent)]
    Read(#[from] E),
    /// No part of the recordings can be related, for this reason.
    #[error(
        "the two gyroscopes cannot be related: {0}; twist the rig by hand at the beginning of a recording"
    )]
    NoRelation(String),
}
