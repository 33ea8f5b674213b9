//! The messages between the SmartDepthSync board and its host.
//!
//! One crate owns the wire format; firmware and host both import it.
//! `no_std`, no allocation, no unsafe code.
//!
//! The modules form layers: each imports only from those before it.
//!
//! - [`units`]: board time in whole ticks ([`Ticks`], [`TickDelta`]).
//! - [`edges`]: board time finer than a tick ([`Period`], [`EdgeTime`], [`EdgeGrid`]).
//! - [`framing`]: encoding of messages as frames (postcard, CRC-32, COBS, a zero byte after
//!   each) and decoding.
//! - [`trigger`], [`capture`], [`imu`], [`gnss`]: settings, events and status of the
//!   trigger outputs, the capture inputs, the IMU and the pulse per second.
//! - [`board`]: identity ([`Hello`]), settings and overall status ([`Status`]) of the board.
//! - [`commands`]: the host's commands, each with its reply.
//! - [`messages`]: the messages ([`DeviceToHost`], [`HostToDevice`]).
//!
//! Beside them, without imports:
//!
//! - [`mpu9150`], [`icm42688p`]: names of the IMUs' registers, which [`ImuFault`] gives as
//!   numbers.
//! - [`pins`]: which signal is on which pin.
//! - [`usb`]: identity of the board on USB.
//!
//! The order of an enum's variants and of a struct's fields *is* the format.
//! `tests/it/golden` pins the bytes of every message; any change there needs a
//! new [`PROTOCOL_VERSION`].

#![no_std]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod board;
pub mod capture;
pub mod commands;
pub mod edges;
pub mod framing;
pub mod gnss;
pub mod icm42688p;
pub mod imu;
pub mod messages;
pub mod mpu9150;
pub mod pins;
pub mod trigger;
pub mod units;
pub mod usb;

pub use board::*;
pub use capture::*;
pub use commands::*;
pub use edges::{EdgeGrid, EdgeTime, Period};
pub use framing::{
    Decoder, FrameError, LinkCounters, MAX_FRAME, decode_frame, encode, hello_version,
};
pub use gnss::*;
pub use imu::*;
pub use messages::*;
pub use trigger::*;
pub use units::{TICK_HZ, TickDelta, Ticks};

/// Version of the wire format. Host and board must agree on it exactly; it is
/// the first field of [`Hello`], whose position never changes, so that a host
/// can read the version of any board.
pub const PROTOCOL_VERSION: u16 = 10;
