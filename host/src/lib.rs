//! The host side of SmartDepthSync as a library; the command-line tool is thin.
//!
//! - [`transport`]: bytes to and from the board, nothing else.
//! - [`session`]: bytes in, events out; command ids, deadlines, losses. No I/O.
//! - [`board`]: a session on a transport, with calls that wait for the answer.
//! - [`phone`]: the phone's remote control over TCP.
//! - [`imu`]: the board's IMU samples in SI units.
//! - [`live_data`]: what is recorded, live for Foxglove.
//! - [`profile`]: what is fixed about one rig.
//! - [`record`]: a session from the twist to the aligned recording.
//! - [`recording`]: the folder of a session, written and read.
//! - [`report`]: one self-contained HTML page, the same for all commands.
//! - [`sync`]: the relation of two clocks from two gyroscopes. No I/O.
//! - [`time`]: phone time and board time as types that do not mix.
//! - [`evaluate`]: frame sync measured from the depth camera's strobes on video.
//! - [`extract`]: recordings into datasets with timestamps in board time.
//! - [`verify`]: checks and repairs recordings.
//! - [`view`]: what the operator sees while a session runs.
//! - [`log`]: where log lines go.
//! - [`cli`], [`commands`], [`outcome`]: the program `smartdepthsync`.
#![forbid(unsafe_code)]

pub mod board;
pub mod cli;
pub mod commands;
pub mod decimal;
pub mod evaluate;
pub mod extract;
pub mod gyro_csv;
pub mod imu;
pub mod live_data;
pub mod log;
pub mod outcome;
pub mod phone;
pub mod profile;
pub mod record;
pub mod recording;
pub mod report;
pub mod session;
pub mod sync;
pub mod time;
pub mod transport;
pub mod verify;
pub mod view;
