//! ROS 1 bags (format 2.0), as the published system records them.
//!
//! Own reader: the existing crate maps the file into memory (a file that is cut
//! short under it ends the process), trusts the index position of the header
//! (0 in a bag that was not closed) and the sizes of compressed chunks.
//!
//! - [`reader`]: records, chunks and connections, front to back. Needs no index,
//!   so it also reads a `.bag.active` that a crash has left.
//! - [`messages`]: the message types of the published system.
//!
//! Limits: no encryption (a plug-in of rosbag), one message within one chunk.

pub mod messages;
pub mod reader;
