//! The messages of a recording as ROS 2 types: Rust structs whose fields, in
//! order, are the CDR form, each beside its definition in the ROS 2 message
//! language, which goes into the file.
//!
//! Where ROS has a type for the thing, it is that type. The types of
//! `smartdepthsync_msgs` exist only as definitions inside the file; readers that
//! take definitions from there (Foxglove, `rosbags`, `mcap-ros2-support`) need
//! nothing else.

pub mod camera;

use protocol::EdgeGrid;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// Stands in a schema before each type that a message uses.
pub const SEPARATOR: &str =
    "================================================================================\n";

/// A ROS 2 message.
pub trait RosMessage: Serialize + DeserializeOwned {
    /// Full name of the type.
    const TYPE: &'static str;
    /// Definition in the ROS 2 message language, without the types it uses.
    const DEFINITION: &'static str;
    /// The types it uses, each with its definition: those of the header, if it says nothing
    /// else.
    const USES: &'static [(&'static str, &'static str)] = &[HEADER, TIME];

    /// The definition as an MCAP schema of encoding `ros2msg`.
    #[must_use]
    fn schema() -> String {
        let mut text = String::from(Self::DEFINITION);
        for (name, definition) in Self::USES {
            text.push_str(SEPARATOR);
            text.push_str(&format!("MSG: {name}\n{definition}"));
        }
        text
    }
}

const TIME: (&str, &str) = ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n");
const HEADER: (&str, &str) = (
    "std_msgs/Header",
    "builtin_interfaces/Time stamp\nstring frame_id\n",
);
const VECTOR3: (&str, &str) = ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n");
const QUATERNION: (&str, &str) = (
    "geometry_msgs/Quaternion",
    "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
);
const KEY_VALUE: (&str, &str) = ("diagnostic_msgs/KeyValue", "string key\nstring value\n");
const DIAGNOSTIC_STATUS: (&str, &str) = (
    "diagnostic_msgs/DiagnosticStatus",
    "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\nstring name\nstring message\n\
     string hardware_id\ndiagnostic_msgs/KeyValue[] values\n",
);

/// `builtin_interfaces/msg/Time`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Time {
    /// Whole seconds.
    pub sec: i32,
    /// The rest, below 10⁹.
    pub nanosec: u32,
}

impl Time {
    /// From nanoseconds; saturates after 68 years of seconds.
    #[must_use]
    pub fn from_nanos(nanos: i64) -> Self {
        let Ok(sec) = i32::try_from(nanos.div_euclid(1_000_000_000)) else {
            return Self {
                sec: if nanos < 0 { i32::MIN } else { i32::MAX },
                nanosec: 0,
            };
        };
        Self {
            sec,
            // The remainder is within 0 and 999,999,999.
            nanosec: nanos.rem_euclid(1_000_000_000) as u32,
        }
    }

    /// In nanoseconds.
    #[must_use]
    pub fn nanos(self) -> i64 {
        i64::from(self.sec) * 1_000_000_000 + i64::from(self.nanosec)
    }
}

/// `std_msgs/msg/Header`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// Board time.
    pub stamp: Time,
    /// What it belongs to.
    pub frame_id: String,
}

/// `sensor_msgs/msg/Imu`. Orientation is not known: its covariance begins with −1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Imu {
    /// Time of the data-ready edge; filter delays are not subtracted.
    pub header: Header,
    /// Not known.
    pub orientation: [f64; 4],
    /// −1, then zeros: no orientation.
    pub orientation_covariance: [f64; 9],
    /// rad/s.
    pub angular_velocity: [f64; 3],
    /// rad²/s²; zeros: not known.
    pub angular_velocity_covariance: [f64; 9],
    /// m/s².
    pub linear_acceleration: [f64; 3],
    /// m²/s⁴; zeros: not known.
    pub linear_acceleration_covariance: [f64; 9],
}

impl RosMessage for Imu {
    const TYPE: &'static str = "sensor_msgs/msg/Imu";
    const DEFINITION: &'static str = "std_msgs/Header header\n\
        geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n\
        geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n\
        geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n";
    const USES: &'static [(&'static str, &'static str)] = &[HEADER, TIME, QUATERNION, VECTOR3];
}

/// `smartdepthsync_msgs/msg/ImuFlags`: something was unusual about a sample of the IMU.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImuFlags {
    /// Time of the sample.
    pub header: Header,
    /// It was read so late that it may be the next one.
    pub late: bool,
    /// A value is at the end of its range.
    pub saturated: bool,
    /// It is the first after a set-up.
    pub first: bool,
    /// An edge of data-ready before it was lost.
    pub after_loss: bool,
}

impl RosMessage for ImuFlags {
    const TYPE: &'static str = "smartdepthsync_msgs/msg/ImuFlags";
    const DEFINITION: &'static str = include_str!("../ros/smartdepthsync_msgs/msg/ImuFlags.msg");
}

/// `sensor_msgs/msg/Temperature`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Temperature {
    /// Time of the IMU sample.
    pub header: Header,
    /// °C.
    pub temperature: f64,
    /// 0: not known.
    pub variance: f64,
}

impl RosMessage for Temperature {
    const TYPE: &'static str = "sensor_msgs/msg/Temperature";
    const DEFINITION: &'static str =
        "std_msgs/Header header\nfloat64 temperature\nfloat64 variance\n";
}

/// `sensor_msgs/msg/TimeReference`: one instant in two times.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TimeReference {
    /// In board time.
    pub header: Header,
    /// In the other time.
    pub time_ref: Time,
    /// What the other time is, or which instant this is.
    pub source: String,
}

impl RosMessage for TimeReference {
    const TYPE: &'static str = "sensor_msgs/msg/TimeReference";
    const DEFINITION: &'static str =
        "std_msgs/Header header\nbuiltin_interfaces/Time time_ref\nstring source\n";
}

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
    /// What it is about.
    pub name: String,
    /// In words.
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
    /// One for each part of the rig.
    pub status: Vec<DiagnosticStatus>,
}

impl RosMessage for DiagnosticArray {
    const TYPE: &'static str = "diagnostic_msgs/msg/DiagnosticArray";
    const DEFINITION: &'static str =
        "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n";
    const USES: &'static [(&'static str, &'static str)] =
        &[HEADER, TIME, DIAGNOSTIC_STATUS, KEY_VALUE];
}

/// `rcl_interfaces/msg/Log`: what was said during the session.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Log {
    /// Board time.
    pub stamp: Time,
    /// 20 information, 30 warning, 40 error.
    pub level: u8,
    /// Who says it.
    pub name: String,
    /// What.
    pub msg: String,
    /// Empty.
    pub file: String,
    /// Kind of the event, as a word.
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

/// `smartdepthsync_msgs/msg/Pulse`: all about one pulse of the trigger.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pulse {
    /// Time of the rising edge.
    pub header: Header,
    /// The same in ticks of 48 MHz.
    pub ticks: u64,
    /// Number of the train; a start begins a new one.
    pub train: u32,
    /// Number of the pulse in its train, from 0.
    pub number: u64,
    /// Of a recording, on the phone's frames; live, on the grid of the last align or start.
    pub aligned: bool,
    /// The pulse was seen on the wire.
    pub readback: bool,
    /// From the edge to its read-back, in ticks; 0 if not seen.
    pub readback_ticks: i32,
}

impl RosMessage for Pulse {
    const TYPE: &'static str = "smartdepthsync_msgs/msg/Pulse";
    const DEFINITION: &'static str = include_str!("../ros/smartdepthsync_msgs/msg/Pulse.msg");
}

/// `smartdepthsync_msgs/msg/Capture`: an edge on a capture input.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Capture {
    /// Time of the edge.
    pub header: Header,
    /// The same in ticks of 48 MHz.
    pub ticks: u64,
    /// The input: `strobe`.
    pub channel: String,
    /// Low to high.
    pub rising: bool,
    /// An edge before this one was lost.
    pub after_loss: bool,
}

impl RosMessage for Capture {
    const TYPE: &'static str = "smartdepthsync_msgs/msg/Capture";
    const DEFINITION: &'static str = include_str!("../ros/smartdepthsync_msgs/msg/Capture.msg");
}

/// `smartdepthsync_msgs/msg/ClockModel`: phone time as a function of board time,
/// `phone = board + offset + skew · (board − reference)`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClockModel {
    /// The reference.
    pub header: Header,
    /// The reference in seconds of board time.
    pub reference_s: f64,
    /// Phone minus board at the reference, in seconds.
    pub offset_s: f64,
    /// Rate of the phone's clock against the board's, minus one.
    pub skew: f64,
    /// Covariance of (offset, skew), by rows: s², s, s, 1.
    pub covariance: [f64; 4],
    /// How much the skew may change: rms within a minute.
    pub wander: f64,
    /// Where it comes from: `twist 1`, `twists 1 and 2`.
    pub source: String,
}

impl RosMessage for ClockModel {
    const TYPE: &'static str = "smartdepthsync_msgs/msg/ClockModel";
    const DEFINITION: &'static str = include_str!("../ros/smartdepthsync_msgs/msg/ClockModel.msg");
}

/// `smartdepthsync_msgs/msg/ClockExchange`: a clock was asked for its time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClockExchange {
    /// Latest board time known then; `frame_id` is `board`, or the phone's name.
    pub header: Header,
    /// When it was asked, by the computer's clock, ns.
    pub sent_ns: i64,
    /// When the answer came, by the same.
    pub received_ns: i64,
    /// What the clock read in between, ns: the board's, or the phone's boot clock.
    pub clock_ns: i64,
    /// The phone's `CLOCK_MONOTONIC`, ns; 0 of the board.
    pub monotonic_ns: i64,
}

impl RosMessage for ClockExchange {
    const TYPE: &'static str = "smartdepthsync_msgs/msg/ClockExchange";
    const DEFINITION: &'static str =
        include_str!("../ros/smartdepthsync_msgs/msg/ClockExchange.msg");
}

/// `smartdepthsync_msgs/msg/TriggerPeriod`: the trigger has another period from an edge on,
/// to stay on the phone's frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TriggerPeriod {
    /// That edge's time.
    pub header: Header,
    /// The grid from there on, anchored at an edge that is on the old grid too; in the file
    /// `ticks`, `fraction` and `period_q32`.
    pub grid: EdgeGrid,
    /// By how much the grid was late on the phone's frames, µs.
    pub phase_us: f64,
    /// 1-sigma of it, µs.
    pub phase_sigma_us: f64,
}

impl RosMessage for TriggerPeriod {
    const TYPE: &'static str = "smartdepthsync_msgs/msg/TriggerPeriod";
    const DEFINITION: &'static str =
        include_str!("../ros/smartdepthsync_msgs/msg/TriggerPeriod.msg");
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
    const DEFINITION: &'static str = include_str!("../ros/smartdepthsync_msgs/msg/LinkFrame.msg");
}

/// The encapsulation header of little-endian CDR.
const CDR_LE: [u8; 4] = [0, 1, 0, 0];

/// Why a message cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum CdrError {
    /// It is not little-endian CDR.
    #[error("a message does not begin as little-endian CDR does")]
    Encapsulation,
    /// The bytes are not of its type.
    #[error("a message is not of its type: {0}")]
    Content(#[from] cdr_encoding::Error),
}

/// Puts a message into its CDR form with the encapsulation header.
///
/// # Errors
///
/// A text or list is longer than 32 bits.
pub fn to_cdr<M: Serialize>(message: &M) -> Result<Vec<u8>, CdrError> {
    let mut bytes = CDR_LE.to_vec();
    bytes.extend(cdr_encoding::to_vec::<M, byteorder::LittleEndian>(message)?);
    Ok(bytes)
}

/// Reads a message from its CDR form.
///
/// # Errors
///
/// The bytes are no CDR, or not of this type.
pub fn from_cdr<M: DeserializeOwned>(bytes: &[u8]) -> Result<M, CdrError> {
    let body = bytes.strip_prefix(&CDR_LE).ok_or(CdrError::Encapsulation)?;
    let (message, _) = cdr_encoding::from_bytes::<M, byteorder::LittleEndian>(body)?;
    Ok(message)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cdr_has_the_layout_of_ros_2() {
        let message = TimeReference {
            header: Header {
                stamp: Time { sec: 1, nanosec: 2 },
                frame_id: String::from("ab"),
            },
            time_ref: Time {
                sec: -1,
                nanosec: 3,
            },
            source: String::from("x"),
        };
        let bytes = to_cdr(&message).unwrap();
        // Encapsulation; 1; 2; length 3 "ab\0", one byte of padding; −1; 3;
        // length 2 "x\0".
        let expected: [&[u8]; 8] = [
            &[0, 1, 0, 0],
            &[1, 0, 0, 0],
            &[2, 0, 0, 0],
            &[3, 0, 0, 0, b'a', b'b', 0, 0],
            &[0xFF; 4],
            &[3, 0, 0, 0],
            &[2, 0, 0, 0],
            b"x\0",
        ];
        assert_eq!(bytes, expected.concat());
        assert_eq!(from_cdr::<TimeReference>(&bytes).unwrap(), message);
    }

    #[test]
    fn doubles_are_aligned_to_eight_bytes_behind_the_encapsulation() {
        let message = Temperature {
            header: Header {
                stamp: Time::default(),
                frame_id: String::new(),
            },
            temperature: 1.0,
            variance: 0.0,
        };
        let bytes = to_cdr(&message).unwrap();
        // 4 + 8 (time) + 5 (empty text with its zero) + 3 padding + 16.
        assert_eq!(bytes.len(), 4 + 16 + 16);
        assert_eq!(bytes[20..28], 1.0_f64.to_le_bytes());
    }

    #[test]
    fn times_of_any_sign_survive() {
        for nanos in [0, 1, -1, 1_999_999_999, -1_000_000_001, 949_113_215_987_860] {
            assert_eq!(Time::from_nanos(nanos).nanos(), nanos);
        }
        assert_eq!(Time::from_nanos(i64::MAX).sec, i32::MAX);
    }

    #[test]
    fn bytes_of_another_kind_are_an_error() {
        assert!(matches!(
            from_cdr::<Imu>(&[0, 0, 0, 0]),
            Err(CdrError::Encapsulation)
        ));
        assert!(matches!(
            from_cdr::<Imu>(&[0, 1, 0, 0, 5]),
            Err(CdrError::Content(_))
        ));
        assert!(
            from_cdr::<LinkFrame>(&[0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 255, 255, 255, 255])
                .is_err()
        );
    }
}
