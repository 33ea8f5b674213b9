//! The messages between the SmartDepthSync board and its host.
//!
//! One crate owns the wire format; firmware and host both import it and nobody
//! declares it again. `no_std`, no allocation, no unsafe code.
//!
//! - [`units`]: board time ([`Ticks`], [`TickDelta`], [`Period`]).
//! - [`messages`]: what is said ([`DeviceToHost`], [`HostToDevice`]).
//! - [`outputs`]: the same for the further outputs (triggers 2 to 4, lidar).
//! - [`framing`]: how it is put on the wire (postcard, CRC-32, COBS, a zero
//!   byte behind each frame) and taken off again.
//!
//! - [`mpu9150`]: names of the IMU's registers, which [`ImuFault`] gives as numbers.
//! - [`usb`]: how the board shows itself on USB.
//!
//! The order of an enum's variants and of a struct's fields *is* the format.
//! `tests/golden.rs` pins the bytes of every message; any change there needs a
//! new [`PROTOCOL_VERSION`].

#![no_std]
#![forbid(unsafe_code)]

pub mod framing;
pub mod messages;
pub mod mpu9150;
pub mod outputs;
pub mod units;
pub mod usb;

pub use framing::{Decoder, FrameError, LinkCounters, MAX_FRAME, encode, hello_version};
pub use messages::*;
pub use outputs::*;
pub use units::{Period, TICK_HZ, TickDelta, Ticks};

/// Version of the wire format. Host and board must agree on it exactly; it is
/// the first field of [`Hello`], whose position never changes, so that a host
/// can read the version of any board.
pub const PROTOCOL_VERSION: u16 = 2;
