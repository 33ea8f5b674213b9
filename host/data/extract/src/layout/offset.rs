//! Board time begins near 0, which ROS treats as unset, and what came before the board
//! has no time there. So what goes into ROS has board time plus [`OFFSET_NS`] exactly.

use std::io;
use std::path::Path;

use crate::output::image::write_whole;
use crate::time::{BoardNanos, SECOND};

/// Added to board time, ns: 1,000 s.
const OFFSET_NS: i64 = 1_000 * SECOND;

pub(super) fn moved(at: BoardNanos) -> BoardNanos {
    BoardNanos(at.0.saturating_add(OFFSET_NS))
}

/// Says it in `times.yaml`.
pub(super) fn write_offset(folder: &Path) -> io::Result<()> {
    let text = format!(
        "# every time below this folder is board time plus this, exactly\noffset_ns: {OFFSET_NS}\n"
    );
    write_whole(&folder.join("times.yaml"), text.as_bytes())
}
