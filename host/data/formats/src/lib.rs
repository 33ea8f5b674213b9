//! Files that other makers' programs write.
//!
//! - [`k4a`]: recordings of the Azure Kinect: depth, infrared, colour and IMU in the
//!   camera's own time.
//! - `mkv`: the Matroska container that they are in; knows nothing of the camera.
//! - [`faults`]: what cannot be read of a file.
//!
//! Nothing read from a file can make the program panic, and memory is bounded whatever the
//! file claims.

pub mod faults;
pub mod k4a;
mod mkv;

/// An instant of the depth camera's own clock, in nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
pub struct DeviceNanos(pub i64);
