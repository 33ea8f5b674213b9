//! Offset of times for ROS: exactly board time plus [`OFFSET_NS`]. Board time begins near 0, which
//! ROS treats as unset, and can be negative for other devices' data, which ROS cannot represent.

use std::io;
use std::path::Path;

use crate::output::whole_file::write_whole;
use crate::time::{BoardNanos, SECOND};

/// Offset added to board time, ns: 1,000 s.
const OFFSET_NS: i64 = 1_000 * SECOND;

/// Returns the time for ROS.
pub(super) fn moved(at: BoardNanos) -> BoardNanos {
    BoardNanos(at.0.saturating_add(OFFSET_NS))
}

/// Writes the offset to `times.yaml`.
pub(super) fn write_offset(folder: &Path) -> io::Result<()> {
    let text = format!(
        "# every time below this folder is board time plus this, exactly\noffset_ns: {OFFSET_NS}\n"
    );
    write_whole(&folder.join("times.yaml"), text.as_bytes())
}
