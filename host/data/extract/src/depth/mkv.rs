//! Matroska files as the Azure Kinect recorder writes them.
//!
//! This is a small reader of its own because it must read what a crashed recorder
//! leaves: an unknown segment size, *no* segment information (the
//! recorder writes it at the end, into a reserved void), tags without
//! the start offset, no cues, and a last cluster that stops anywhere. Existing
//! demuxers refuse to open such files (they follow the
//! seek head, or require every size to be within the file) and do not return attachments.
//!
//! - `ebml`: elements, sizes, values.
//! - `header`: tracks, tags, attachments.
//! - `block`: frames of a block, checksums.
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
