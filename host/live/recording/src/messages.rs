//! The messages of a recording as ROS 2 types: Rust structs whose fields, in order, are the CDR
//! form, each beside its definition in the ROS 2 message language, which goes into the file.
//!
//! A message uses the standard ROS type where there is one. The types of `smartdepthsync_msgs`
//! exist only as definitions inside the file; readers that use those definitions (Foxglove,
//! `rosbags`, `mcap-ros2-support`) need nothing else.
//!
//! - `imu`: samples of the board's IMU. `trigger`: pulses and edges. `clock`: relations of
//!   clocks. `log`: status, log and link. [`camera`]: images, for data sets.
//! - `cdr`: the binary form.

pub mod camera;
mod cdr;
mod clock;
mod imu;
mod log;
mod trigger;

use protocol::Ticks;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

pub use cdr::{CdrError, from_cdr, to_cdr};
pub use clock::{ClockExchange, ClockModel, TimeReference};
pub use imu::{Imu, ImuFlags, Temperature};
pub use log::{DiagnosticArray, DiagnosticStatus, KeyValue, LinkFrame, Log};
pub use trigger::{Capture, Pulse, TriggerPeriod};

/// Line in a schema before each type that a message uses.
pub(crate) const SEPARATOR: &str =
    "================================================================================\n";

/// A ROS 2 message.
pub trait RosMessage: Serialize + DeserializeOwned {
    /// Full name of the type, for example `sensor_msgs/msg/Imu`.
    const TYPE: &'static str;
    /// Definition in the ROS 2 message language, without the types it uses.
    const DEFINITION: &'static str;
    /// Name and definition of each type it uses; by default those of a header.
    const USES: &'static [(&'static str, &'static str)] = &[HEADER, TIME];

    /// Returns the definition as an MCAP schema of encoding `ros2msg`.
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

/// `builtin_interfaces/msg/Time`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Time {
    /// Whole seconds.
    pub sec: i32,
    /// Nanoseconds after them, below 10⁹.
    pub nanosec: u32,
}

impl Time {
    /// Converts from board time; saturates beyond 68 years.
    pub(crate) fn at(board: Ticks) -> Self {
        Self::from_nanos(i64::try_from(board.as_nanos()).unwrap_or(i64::MAX))
    }

    /// Converts from nanoseconds; saturates beyond 68 years.
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

    /// Converts to nanoseconds.
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
    /// Name of the device that the message is about.
    pub frame_id: String,
}

impl Header {
    /// Creates a header from board time and the name of the device.
    pub(crate) fn at(board: Ticks, frame_id: &str) -> Self {
        Self {
            stamp: Time::at(board),
            frame_id: frame_id.to_owned(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_of_any_sign_survive() {
        for nanos in [0, 1, -1, 1_999_999_999, -1_000_000_001, 949_113_215_987_860] {
            assert_eq!(Time::from_nanos(nanos).nanos(), nanos);
        }
        assert_eq!(Time::from_nanos(i64::MAX).sec, i32::MAX);
    }
}
