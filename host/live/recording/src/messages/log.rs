//! Status of the board, log of the session, and frames of the link.

use serde::{Deserialize, Serialize};

use super::{HEADER, Header, RosMessage, TIME, Time};

const KEY_VALUE: (&str, &str) = ("diagnostic_msgs/KeyValue", "string key\nstring value\n");
const DIAGNOSTIC_STATUS: (&str, &str) = (
    "diagnostic_msgs/DiagnosticStatus",
    "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\nstring name\nstring message\n\
     string hardware_id\ndiagnostic_msgs/KeyValue[] values\n",
);

/// `diagnostic_msgs/msg/KeyValue`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyValue {
    /// Name.
    pub key: String,
    /// Value as text.
    pub value: String,
}

/// `diagnostic_msgs/msg/DiagnosticStatus`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosticStatus {
    /// 0 good, 1 warning, 2 error, 3 stale.
    pub level: u8,
    /// Name of the part: `trigger`, `imu`, `outputs`, `gnss` or `board`.
    pub name: String,
    /// State in words.
    pub message: String,
    /// The board's ID.
    pub hardware_id: String,
    /// The figures.
    pub values: Vec<KeyValue>,
}

/// `diagnostic_msgs/msg/DiagnosticArray`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosticArray {
    /// Time of the status.
    pub header: Header,
    /// One for each part of the board.
    pub status: Vec<DiagnosticStatus>,
}

impl RosMessage for DiagnosticArray {
    const TYPE: &'static str = "diagnostic_msgs/msg/DiagnosticArray";
    const DEFINITION: &'static str =
        "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n";
    const USES: &'static [(&'static str, &'static str)] =
        &[HEADER, TIME, DIAGNOSTIC_STATUS, KEY_VALUE];
}

/// `rcl_interfaces/msg/Log`: an event of the session.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Log {
    /// Board time.
    pub stamp: Time,
    /// 20 information, 30 warning, 40 error.
    pub level: u8,
    /// Name of the program.
    pub name: String,
    /// The event in words.
    pub msg: String,
    /// Empty.
    pub file: String,
    /// Kind of the event, a stable word.
    pub function: String,
    /// 0.
    pub line: u32,
}

impl RosMessage for Log {
    const TYPE: &'static str = "rcl_interfaces/msg/Log";
    const DEFINITION: &'static str = "byte DEBUG=10\nbyte INFO=20\nbyte WARN=30\nbyte ERROR=40\n\
        byte FATAL=50\nbuiltin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\n\
        string file\nstring function\nuint32 line\n";
    const USES: &'static [(&'static str, &'static str)] = &[TIME];
}

/// `smartdepthsync_msgs/msg/LinkFrame`: one frame of the link as it came.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkFrame {
    /// Latest board time known when it came.
    pub header: Header,
    /// The bytes between two delimiters (COBS).
    pub data: Vec<u8>,
}

impl RosMessage for LinkFrame {
    const TYPE: &'static str = "smartdepthsync_msgs/msg/LinkFrame";
    const DEFINITION: &'static str =
        include_str!("../../ros/smartdepthsync_msgs/msg/LinkFrame.msg");
}
