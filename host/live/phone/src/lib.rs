//! The phone: a client of the remote control of OpenCamera Sensors.
//!
//! The app listens on TCP port 6969 and serves one client at a time, one request after the other
//! on one connection: `imu?…`, `video_start`, `video_stop`, `get_video`. Answers are lines of text
//! that end with the line `end`; see [`answer`] for the framing and [`requests`] for the bodies.
//!
//! Design: parsing is sans-IO ([`answer`], [`requests`], [`samples`], [`file_name`]), needs bounded
//! memory and panics on no input. [`client`] talks to the app; it blocks, with a deadline on every
//! read and write. [`task`] runs a client on a thread, for callers that must not block. An error
//! within an answer closes the connection, as the position in the stream is then unknown; a refusal
//! by the app does not.
//!
//! Besides the app, [`adb`] copies files from the phone's storage, and [`agent`] reads the phone's
//! clocks by a program of ours there. The app's files are read by [`rows`] and
//! [`frame_timestamps`], found by [`video_files`] and compared with each other by [`coverage`];
//! [`video`] decodes videos with ffmpeg.
//!
//! Limits: no encryption and no authentication, as the app has none; use it on a network of your
//! own. The time of a request is not used for synchronisation, so a slow network costs time, never
//! accuracy.

pub mod adb;
pub mod agent;
pub mod answer;
pub mod client;
mod connection;
pub mod coverage;
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
pub use client::{PhoneClient, check_address};
pub use download::SavedVideo;
pub use error::PhoneError;
pub use requests::{Asked, ImuRequest, VideoStart};
pub use samples::{PhoneSample, save_samples};
pub use settings::Settings;
