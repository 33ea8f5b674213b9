//! The link to the board, from bytes to answers.
//!
//! - [`transport`]: bytes to and from the board, nothing else.
//! - [`session`]: bytes in, events out; command ids, deadlines, losses. No I/O.
//! - [`Board`]: a session on a transport, with calls that wait for the answer.
//! - [`imu`]: the board's IMU samples in SI units.
//! - [`gnss`]: the board as a lidar's GNSS receiver.
#![forbid(unsafe_code)]

mod calls;
pub mod gnss;
pub mod imu;
pub mod session;
pub mod transport;

pub use calls::{Board, BoardError, Result, choose_port, explain, reset_cause};
