#![doc = include_str!("../README.md")]
//!
//! ## Source
//!
//! | module | contents |
//! |---|---|
//! | `track` | recordings of a gyroscope, in memory and streamed |
//! | `signal/` | from samples to a smooth angular rate: interpolation, low-pass, prediction of a sample from its neighbours |
//! | `stream/` | faults that one stream shows by itself: in its timestamps, in its samples, in periodic classes of samples |
//! | `estimate/` | one estimate from two recordings of one motion: pair of streams, coarse lags and their choice, fit, parts that do not move as one body, faults against the other stream, late axes, wander of the stamps, gates |
//! | `course/` | the relation over whole recordings: search for a first relation, estimates window by window, filter and smoother over them |
//! | `clock` | the relation of two clocks, its covariance, prediction and inverse |
//! | `faults` | faults and their report |
//! | `robust`, `mixture`, `correlate` | statistics that several modules use |
//!
//! `robust`, `mixture` and `interpolant` are public for programs that treat clocks in the same way.
#![forbid(unsafe_code)]
#![warn(missing_docs)]
// Axes and rows of 3-vectors and small matrices are indices by nature.
#![allow(clippy::needless_range_loop)]
// A refusal carries its report; there is only one for each twist.
#![allow(clippy::result_large_err)]

mod clock;
mod correlate;
mod course;
mod estimate;
mod faults;
pub mod mixture;
pub mod robust;
mod signal;
mod slow;
mod stream;
mod track;

pub use clock::{ClockRelation, Wander, WithSigma};
pub use course::{
    ClockCourse, ClockStep, CourseError, Prior, RecordingClock, RefusedWindows, Unsupported,
    course_of_tracks, estimate_course,
};
pub use estimate::{Estimate, Gate, GateKind, Options, Refusal, Report, Warning, estimate_offset};
pub use faults::{Action, Fault, FaultKind, LeftOut, Stream, Why};
pub use signal::interpolant;
pub use track::{GyroOpener, GyroSample, GyroStream, GyroTrack};
