//! Portable logic of the SmartDepthSync firmware, tested on the host.
//!
//! Nothing in here touches a register. The binary (`src/main.rs`) adds the
//! board (`src/hardware/`) and the tasks (`src/tasks/`).
//!
//! - [`boards`]: what differs from board to board.
//! - [`config`]: every tuning number with its derivation.
//! - [`timebase`]: 32-bit counter values to 64-bit board time.
//! - [`trigger`]: where the edges of the train fall.
//! - [`pulser`]: how each edge is made by a compare channel.
//! - [`capture`]: directions of captured edges, and the limit on their rate.
//! - [`imu`]: the IMUs, a file a family.
//! - [`nmea`]: the sentences of a GNSS receiver.
//! - [`outbox`]: what waits to be sent, in which order, and what was dropped.
//! - [`die_temperature`]: the chip's temperature.
//! - [`alive`]: which tasks have checked in.
//! - [`retained`]: what survives a reset.
//! - [`storage`]: what survives power-off.
//! - [`load`]: time awake, and the deepest stack.

#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

pub mod alive;
pub mod boards;
pub mod capture;
pub mod config;
pub mod die_temperature;
pub mod imu;
pub mod load;
pub mod nmea;
pub mod outbox;
pub mod pulser;
pub mod retained;
pub mod storage;
pub mod timebase;
pub mod trigger;
