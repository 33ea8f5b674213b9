#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]
#![warn(missing_docs)]
// Axes and rows of 3-vectors and small matrices are indices by nature.
#![allow(clippy::needless_range_loop)]
// A refusal carries its report, and there is one a twist.
#![allow(clippy::result_large_err)]

mod axes;
mod calibration;
mod classes;
mod clock;
pub mod coach;
mod coarse;
mod correlate;
mod course;
mod crosscheck;
mod estimate;
mod faults;
mod fit;
mod gates;
#[doc(hidden)] // of the workspace: no part of the interface
pub mod interpolant;
mod lag;
#[doc(hidden)] // of the workspace: no part of the interface
pub mod mixture;
mod neighbours;
mod pair;
mod recording;
mod rigid;
#[doc(hidden)] // of the workspace: no part of the interface
pub mod robust;
mod samples;
mod search;
mod signal;
mod stream;
mod timestamps;
mod track;
pub mod tracker;
mod wander;

pub use clock::{ClockRelation, Wander, WithSigma};
pub use course::{ClockCourse, ClockStep, Unsupported};
pub use estimate::{Estimate, Options, Refusal, Report, Warning, estimate_offset};
pub use faults::{Action, Fault, FaultKind, LeftOut, Stream, Why};
pub use gates::Gate;
pub use recording::{
    GyroOpener, Prior, RecordingClock, RecordingError, RefusedWindows, course_of_tracks,
    estimate_course,
};
pub use track::{GyroSample, GyroStream, GyroTrack};
