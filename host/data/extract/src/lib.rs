//! Extraction: turns a recording into a data set whose timestamps are all in board time, in the
//! formats that people load.
//!
//! | module | contents |
//! |---|---|
//! | [`run`] | the extraction, step by step |
//! | [`options`], [`error`], [`report`] | what the user gives, why there is no data set, `report.json` |
//! | [`inputs`] | finds the files of a recording; reads the board's MCAP file and the phone's CSV files |
//! | [`depth`] | reads depth recordings (Azure Kinect, ROS 2 bags); matches depth frames to trigger pulses |
//! | `clocks` | the phone's clock, and another gyroscope's, in board time over the whole recording |
//! | `frames` | frames of phone and depth camera: their times, their pairs, their place on the trigger's grid |
//! | [`geometry`] | lenses, the depth camera's calibration, registration of depth images |
//! | [`layout`] | the data set formats: EuRoC, TUM, topics, Kalibr, ROS 2 |
//! | [`output`] | the output folder, its tables and images; a later run continues in it |
//! | `time`, `constants`, `faults` | integer times of each clock; constants of a rig; lists of unreadable parts |
//!
//! Inputs are read only, front to back, with bounded memory; nothing read from a
//! file can make the program panic. Missing and damaged parts are named in the
//! report, and the rest is extracted.

mod clocks;
mod constants;
pub mod depth;
pub mod error;
mod faults;
mod frames;
pub mod geometry;
pub mod inputs;
pub mod layout;
pub mod options;
pub mod output;
pub mod report;
pub mod run;
mod time;
