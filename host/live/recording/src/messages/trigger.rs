//! Pulses of the trigger and of the auxiliary outputs, and edges on the strobe input.

use protocol::EdgeGrid;
use serde::{Deserialize, Serialize};

use super::{Header, RosMessage};

/// `smartdepthsync_msgs/msg/Pulse`: one pulse of the trigger or of an auxiliary output.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pulse {
    /// Time of the rising edge.
    pub header: Header,
    /// The same time in ticks of 48 MHz.
    pub ticks: u64,
    /// Number of the train; a start begins a new one.
    pub train: u32,
    /// Number of the pulse in its train, from 0.
    pub number: u64,
    /// In a recording: the pulse is on the phone's frames. Live: it is on the grid of the last
    /// align or start.
    pub aligned: bool,
    /// The pulse was seen on the wire.
    pub readback: bool,
    /// Time from the edge to its read-back, ticks; 0 if not seen.
    pub readback_ticks: i32,
}

impl RosMessage for Pulse {
    const TYPE: &'static str = "smartdepthsync_msgs/msg/Pulse";
    const DEFINITION: &'static str = include_str!("../../ros/smartdepthsync_msgs/msg/Pulse.msg");
}

/// `smartdepthsync_msgs/msg/Capture`: an edge on a capture input.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Capture {
    /// Time of the edge.
    pub header: Header,
    /// The same time in ticks of 48 MHz.
    pub ticks: u64,
    /// Name of the input: `strobe`.
    pub channel: String,
    /// The edge rises from low to high.
    pub rising: bool,
    /// An edge before this one was lost.
    pub after_loss: bool,
}

impl RosMessage for Capture {
    const TYPE: &'static str = "smartdepthsync_msgs/msg/Capture";
    const DEFINITION: &'static str = include_str!("../../ros/smartdepthsync_msgs/msg/Capture.msg");
}

/// `smartdepthsync_msgs/msg/TriggerPeriod`: the trigger has another period from an edge on, to
/// stay on the phone's frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TriggerPeriod {
    /// Time of that edge.
    pub header: Header,
    /// Grid from this edge on, anchored at the edge, which is on the old grid too; in the file
    /// `ticks`, `fraction` and `period_q32`.
    pub grid: EdgeGrid,
    /// Lateness of the grid on the phone's frames before the change, µs.
    pub phase_us: f64,
    /// 1-sigma of `phase_us`, µs.
    pub phase_sigma_us: f64,
}

impl RosMessage for TriggerPeriod {
    const TYPE: &'static str = "smartdepthsync_msgs/msg/TriggerPeriod";
    const DEFINITION: &'static str =
        include_str!("../../ros/smartdepthsync_msgs/msg/TriggerPeriod.msg");
}
