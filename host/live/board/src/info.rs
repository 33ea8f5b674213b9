//! Description of a board for files and reports.

use protocol::usb::serial_number;
use protocol::{BoardModel, Hello, ResetCause};
use serde::{Deserialize, Serialize};

/// Identity and state of a board, as it reports them.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct BoardInfo {
    /// Unique ID in hex.
    pub id: String,
    /// Version of the firmware.
    pub firmware: String,
    /// Git revision of the firmware, if it was built from one.
    pub git_revision: Option<String>,
    /// True if the firmware was built from changed files.
    pub git_dirty: bool,
    /// Model of the board.
    pub model: BoardModel,
    /// Version of the protocol.
    pub protocol: u16,
    /// Ticks a second.
    pub tick_hz: u32,
    /// Number of the board's run.
    pub epoch: u32,
    /// Cause of its last reset.
    pub reset_cause: ResetCause,
}

impl BoardInfo {
    /// Creates the description from the board's greeting.
    #[must_use]
    pub fn new(hello: &Hello) -> Self {
        let (major, minor, patch) = hello.firmware_version;
        Self {
            id: serial_number(&hello.board_id).to_string(),
            firmware: format!("{major}.{minor}.{patch}"),
            git_revision: (!hello.git_revision.is_empty()).then(|| hello.git_revision.to_string()),
            git_dirty: hello.git_dirty,
            model: hello.board,
            protocol: hello.protocol_version,
            tick_hz: hello.tick_hz,
            epoch: hello.epoch,
            reset_cause: hello.reset_cause,
        }
    }
}
