//! The phone: a client of the remote control of OpenCamera Sensors.
//!
//! The app listens on TCP port 6969 and serves one client at a time, one
//! request after the other on one connection: `imu?…`, `video_start`,
//! `video_stop`, `get_video`. Answers are lines of text that end with the line
//! `end`; see [`answer`] for the framing and [`requests`] for the bodies.
//!
//! Design: everything that interprets bytes is sans-IO ([`answer`],
//! [`requests`], [`samples`], [`file_name`]) and takes any input without a
//! panic and in bounded memory. [`client`] is the only part that touches a
//! socket; it is blocking, with a deadline on every read and write, since a
//! session has exactly one thing to wait for. [`task`] gives it a thread of its own, for
//! who has more. An error within an answer closes
//! the connection: after it nobody knows which byte belongs to what. A refusal
//! in the app's own words does not.
//!
//! Limits: no encryption and no authentication, as the app has none; use it on
//! a network of your own. The time of a request is not used for any
//! synchronisation, so a slow network costs patience, never accuracy.

pub mod adb;
pub mod agent;
pub mod answer;
pub mod client;
mod connection;
mod download;
pub mod error;
pub mod file_name;
pub mod frame_timestamps;
pub mod requests;
pub mod rows;
pub mod samples;
mod settings;
pub mod task;
pub mod video;
pub mod video_files;

pub use answer::ServerVersion;
pub use client::PhoneClient;
pub use download::SavedVideo;
pub use error::PhoneError;
pub use requests::{Asked, ImuRequest, VideoStart};
pub use samples::{PhoneSample, save_samples};
pub use settings::Settings;

/// TCP port of the app.
pub(crate) const DEFAULT_PORT: u16 = 6969;
