//! The messages between the SmartDepthSync board and its host.
//!
//! One crate owns the wire format; firmware and host both import it and nobody
//! declares it again. `no_std`, no allocation, no unsafe code.
//!
//! The modules form layers: each imports only from those before it.
//!
//! - [`units`]: board time ([`Ticks`], [`TickDelta`], [`Period`]).
//! - [`framing`]: how a message of any type is put on the wire (postcard, CRC-32,
//!   COBS, a zero byte behind each frame) and taken off again.
//! - [`trigger`], [`capture`], [`imu`]: settings, events and status of the camera
//!   trigger, the capture inputs and the IMU.
//! - [`outputs`], [`gnss`]: the same of the further trigger outputs (2 to 4) and of
//!   the pulse per second.
//! - [`board`]: who the board is ([`Hello`]) and how all of it fares ([`Status`]).
//! - [`messages`]: what is said ([`DeviceToHost`], [`HostToDevice`]).
//!
//! Beside them, without imports:
//!
//! - [`mpu9150`]: names of the IMU's registers, which [`ImuFault`] gives as numbers.
//! - [`usb`]: how the board shows itself on USB.
//!
//! The order of an enum's variants and of a struct's fields *is* the format.
//! `tests/golden.rs` pins the bytes of every message; any change there needs a
//! new [`PROTOCOL_VERSION`].

#![no_std]
#![forbid(unsafe_code)]

pub mod board;
pub mod capture;
pub mod framing;
pub mod gnss;
pub mod imu;
pub mod messages;
pub mod mpu9150;
pub mod outputs;
pub mod trigger;
pub mod units;
pub mod usb;

pub use board::*;
pub use capture::*;
pub use framing::{Decoder, FrameError, LinkCounters, MAX_FRAME, encode, hello_version};
pub use gnss::*;
pub use imu::*;
pub use messages::*;
pub use outputs::*;
pub use trigger::*;
pub use units::{Period, TICK_HZ, TickDelta, Ticks};

/// Version of the wire format. Host and board must agree on it exactly; it is
/// the first field of [`Hello`], whose position never changes, so that a host
/// can read the version of any board.
pub const PROTOCOL_VERSION: u16 = 2;
