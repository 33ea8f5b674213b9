//! The phone's files, as the app saves them: a video, and in a folder named by
//! the video's date the gyroscope, the accelerometer and the frame timestamps.
//!
//! - [`files`]: finds what belongs together.
//! - [`csv`]: the rows, as a stream, with damaged rows named.

pub mod csv;
pub mod files;
