//! Extraction: from a recording to a data set whose timestamps are all in board
//! time, in the formats that people load.
//!
//! - [`run`]: the whole of it, step by step. [`report`]: what it says at the end.
//! - Inputs: [`inputs`] finds them; `board_data` (our MCAP, bags of the published system),
//!   `phone_rows` (the phone's CSV files), `depth` (Matroska, ROS 2 bags).
//! - Files of other makers: [`k4a`] (recordings of the Azure Kinect), `mkv` (the Matroska container
//!   that they are in), [`faults`] (what cannot be read of a file).
//! - Time: `time` (integers only), `constants`, `gyro_clock` and `phone_clock` (the phone's clock
//!   over the whole recording), `depth_clock` and `depth_match` (depth frames and
//!   pulses), `frames` (timestamps and images), `pairs`, `grid` (frames against the trigger).
//! - Space: [`geometry`] (lenses, the depth camera's calibration, registration).
//! - Outputs: [`layout`] (EuRoC, TUM, topics, bags), sequences, `tables`, `imu_tables`,
//!   `image_tables`, `sample_images`, in an [`output_dir`] in which a later run continues.
//!
//! Inputs are read only, front to back, with bounded memory; nothing read from a
//! file can make the program panic. Missing and damaged parts are named in the
//! report, and the rest is extracted.

mod board_data;
mod constants;
mod depth;
mod depth_clock;
mod depth_match;
pub mod error;
pub mod faults;
mod frames;
pub mod geometry;
mod grid;
mod gyro_clock;
mod image;
mod image_tables;
mod imu_tables;
pub mod inputs;
pub mod k4a;
pub mod layout;
mod mkv;
pub mod options;
pub mod output_dir;
mod pairs;
mod phone_clock;
mod phone_rows;
pub mod report;
mod ros2_depth;
pub mod run;
mod sample_images;
mod sequence;
mod streams;
mod survey;
mod tables;
mod time;
