//! The sync math: the relation of two clocks from two rigidly attached gyroscopes.
//!
//! Pure functions on slices: no input or output, no global state. Times are f64
//! seconds relative to a reference, so that a clock that reads 10⁶ s costs no
//! precision. Each module derives what it computes; the whole is described in
//! `docs/sync-math.md`, and measured in `docs/sync-study.md`.
//!
//! [`estimate_offset`] takes two recordings ([`GyroTrack`]) and gives an
//! [`Estimate`] with a [`ClockRelation`], or a [`Refusal`] with reasons.

// Axes and rows of 3-vectors and small matrices are indices by nature.
#![allow(clippy::needless_range_loop)]

pub mod clock;
pub mod coach;
pub mod coarse;
pub mod compare;
pub mod crosscheck;
pub mod estimate;
pub mod faults;
pub mod fit;
pub mod gates;
pub mod robust;
pub mod samples;
pub mod signal;
pub mod simulate;
pub mod smoother;
pub mod spline;
pub mod timestamps;
pub mod track;

pub use clock::{ClockRelation, Wander, WithSigma};
pub use estimate::{Estimate, Options, Refusal, Report, estimate_offset};
pub use faults::{Action, Fault, FaultKind, Stream};
pub use gates::Gate;
pub use smoother::{ClockCourse, WindowOptions, estimate_course};
pub use track::GyroTrack;
