//! The relation of two clocks from two gyroscopes that are rigidly attached to each
//! other.
//!
//! Pure functions on samples in memory or from any stream: no files, no global
//! state. Times are f64 seconds relative to a reference, so that a clock that reads
//! 10⁶ s costs no precision. Each module derives what it computes; the whole is
//! described in `docs/sync-math.md`, and measured in `docs/sync-study.md`.
//!
//! [`estimate_offset`] takes two recordings ([`GyroTrack`]) of one twist and gives an
//! [`Estimate`] with a [`ClockRelation`], or a [`Refusal`] with reasons.
//! [`estimate_course`] takes whole recordings and gives the relation over time.

// Axes and rows of 3-vectors and small matrices are indices by nature.
#![allow(clippy::needless_range_loop)]
// A refusal carries its report, and there is one a twist.
#![allow(clippy::result_large_err)]

mod classes;
mod clock;
pub mod coach;
mod coarse;
pub mod compare;
mod correlate;
mod course;
mod crosscheck;
mod estimate;
mod faults;
mod fit;
mod gates;
mod interpolant;
mod lag;
mod neighbours;
mod pair;
mod recording;
mod rigid;
pub mod robust;
mod samples;
mod search;
mod signal;
#[cfg(feature = "simulate")]
pub mod simulate;
mod stream;
mod swing;
mod timestamps;
mod track;
pub mod tracker;

pub use clock::{ClockRelation, Wander, WithSigma};
pub use course::ClockCourse;
pub use estimate::{Estimate, Options, Refusal, Report, Warning, estimate_offset};
pub use faults::{Action, Fault, FaultKind, LeftOut, Stream, Why};
pub use gates::Gate;
pub use recording::{
    GyroOpener, GyroSample, GyroStream, Prior, RecordingClock, RecordingError, estimate_course,
};
pub use track::GyroTrack;
