//! Matroska files as the Azure Kinect recorder writes them.
//!
//! An own reader, and a small one, because what a crash of the recorder leaves
//! must be read: the segment's size unknown, *no* segment information (the
//! recorder writes it at the end, into a void that it reserved), tags without
//! the start offset, no cues, and a last cluster that stops anywhere. The
//! demuxers that were looked at refuse such files at opening (they follow the
//! seek head, or want every size within the file) and give no attachments.
//!
//! - `ebml`: elements, sizes, values.
//! - `header`: tracks, tags, attachments.
//! - `reader`: the segment and its clusters.
//!
//! Limits: one segment a file (what follows is ignored), no encryption, no
//! compressed tracks. Memory is bounded by one cluster (`reader::MAX_CLUSTER`).

mod block;
mod ebml;
mod header;
mod id;
mod reader;

pub(crate) use header::{Header, Track};
pub use reader::MkvError;
pub(crate) use reader::{Cluster, Frame, Mkv};
