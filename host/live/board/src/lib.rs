//! The link to the board, from bytes to answers.
//!
//! - [`transport`]: bytes to and from the board, nothing else.
//! - [`Conversation`]: bytes in, events out; command ids, deadlines, losses. No I/O.
//! - [`Received`]: the messages of a board, sorted by their streams.
//! - [`Stream`]: the numbered streams of the board, with counts of messages received and lost.
//! - [`Board`]: a conversation on a transport, with calls that wait for the answer.
//! - [`imu`]: the board's IMU samples in SI units.
//! - [`image`]: images of the firmware.
//! - [`bring_up`]: the board test, which compares a real board with the simulated one.
//! - [`finding`]: findings, and the scale of their severity.
//! - [`gnss`]: the board as a lidar's GNSS receiver.
#![forbid(unsafe_code)]

pub mod bring_up;
mod calls;
mod conversation;
mod error;
pub mod finding;
pub mod gnss;
pub mod image;
pub mod imu;
mod info;
mod listen;
mod received;
mod streams;
pub mod transport;

pub use calls::{Board, choose_port};
pub use conversation::{Conversation, Event};
pub use error::{BoardError, Result, reset_cause};
pub use info::BoardInfo;
pub use received::Received;
pub use streams::{Stream, StreamCount, StreamCounts, follow};
