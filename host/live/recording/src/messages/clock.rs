//! Relations of clocks.

use ::clock::{ClockRelation, Wander};
use serde::{Deserialize, Serialize};

use super::{Header, RosMessage, Time};
use crate::session_file::is_possible;

/// `sensor_msgs/msg/TimeReference`: one instant in two times.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TimeReference {
    /// The instant in board time.
    pub header: Header,
    /// The instant in the other time.
    pub time_ref: Time,
    /// Name of the other time, or of the instant.
    pub source: String,
}

impl RosMessage for TimeReference {
    const TYPE: &'static str = "sensor_msgs/msg/TimeReference";
    const DEFINITION: &'static str =
        "std_msgs/Header header\nbuiltin_interfaces/Time time_ref\nstring source\n";
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
    /// Change of the skew: rms within a minute.
    pub wander: f64,
    /// Origin of the relation: `twist 1`, `twists 1 and 2`.
    pub source: String,
}

impl ClockModel {
    /// Returns the relation; `None` if no two clocks can have it.
    #[must_use]
    pub fn relation(&self) -> Option<ClockRelation> {
        let [a, b, c, d] = self.covariance;
        let relation = ClockRelation {
            reference: self.reference_s,
            offset: self.offset_s,
            skew: self.skew,
            covariance: [[a, b], [c, d]],
            wander: Wander(self.wander),
        };
        is_possible(&relation).then_some(relation)
    }
}

impl RosMessage for ClockModel {
    const TYPE: &'static str = "smartdepthsync_msgs/msg/ClockModel";
    const DEFINITION: &'static str =
        include_str!("../../ros/smartdepthsync_msgs/msg/ClockModel.msg");
}

/// `smartdepthsync_msgs/msg/ClockExchange`: a clock was asked for its time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClockExchange {
    /// Latest board time known then; `frame_id` is `board`, or the phone's name.
    pub header: Header,
    /// Time of the question on the computer's clock, ns.
    pub sent_ns: i64,
    /// Time of the answer on the computer's clock, ns.
    pub received_ns: i64,
    /// Reading in between, ns: of the board's clock, or of the phone's boot clock.
    pub clock_ns: i64,
    /// The phone's `CLOCK_MONOTONIC`, ns; 0 for the board.
    pub monotonic_ns: i64,
}

impl RosMessage for ClockExchange {
    const TYPE: &'static str = "smartdepthsync_msgs/msg/ClockExchange";
    const DEFINITION: &'static str =
        include_str!("../../ros/smartdepthsync_msgs/msg/ClockExchange.msg");
}
