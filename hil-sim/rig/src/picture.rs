//! Pictures of the rig's cameras, and their encoding as a video.

pub mod ball;
pub mod rolling_shutter;
pub mod video_writer;
