//! The board's status as a ROS 2 diagnostic message, and the counters that the verification reads
//! back from it.
//!
//! The message has strings alone. All numbers of a [`Status`] are written under their names in
//! the source, by way of its JSON form, so that a new counter is in each recording without a
//! change here.

use protocol::{Dropped, ImuState, Status};
use serde_json::Value;

use super::messages::{DiagnosticArray, DiagnosticStatus, Header, KeyValue};

/// Counters of the board in a recorded status.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct BoardCounters {
    /// Number of the board's run: a reset begins a new one.
    pub(crate) epoch: u32,
    /// Messages that the board dropped because a queue was full.
    pub(crate) dropped: Dropped,
}

impl BoardCounters {
    /// Reads the counters; returns `None` if one is missing.
    pub(crate) fn from_message(array: &DiagnosticArray) -> Option<Self> {
        let board = array.status.iter().find(|part| part.name == "board")?;
        let counter = |key| {
            let found = board.values.iter().find(|found| found.key == key)?;
            found.value.parse::<u32>().ok()
        };
        Some(Self {
            epoch: counter("epoch")?,
            dropped: Dropped {
                answers: counter("dropped_answers")?,
                pulses: counter("dropped_pulses")?,
                captures: counter("dropped_captures")?,
                imu: counter("dropped_imu")?,
                status: counter("dropped_status")?,
                outputs: counter("dropped_outputs")?,
            },
        })
    }
}

/// Converts a status to a message of five parts, each with all its numbers by their names in
/// [`Status`].
pub(crate) fn diagnostics(status: &Status, board_id: &str) -> DiagnosticArray {
    let (trigger, imu, gnss) = (&status.trigger, &status.imu, &status.gnss);
    let is_lossy = status.dropped.total() > 0 || status.link.lost_frames > 0;
    let words = if is_lossy {
        "messages were dropped"
    } else {
        "ok"
    };
    let imu_level = match imu.state {
        ImuState::Running => 0,
        ImuState::Starting => 1,
        ImuState::Failed => 2,
    };
    let outputs = status.outputs.map(|output| format!("{:?}", output.state));
    let is_late = status.outputs.iter().any(|output| output.late > 0);
    let trigger_fails = trigger.late > 0 || trigger.readback.missing > 0;
    let gnss_fails = gnss.late > 0 || gnss.missed > 0;
    // A status always has a JSON form.
    let mut all = serde_json::to_value(status).unwrap_or_default();
    let parts = [
        (
            "trigger",
            u8::from(trigger_fails),
            format!("{:?}", trigger.state),
        ),
        ("imu", imu_level, format!("{:?}", imu.state)),
        ("outputs", u8::from(is_late), outputs.join(", ")),
        ("gnss", u8::from(gnss_fails), format!("{:?}", gnss.state)),
        // Everything that is not in another part.
        ("board", u8::from(is_lossy), String::from(words)),
    ];
    let status_of = |(name, level, message): (&str, u8, String)| {
        let own = match all.get_mut(name) {
            Some(part) => part.take(),
            None => all.take(),
        };
        let mut values = Vec::new();
        leaves("", &own, &mut values);
        DiagnosticStatus {
            level,
            name: name.to_owned(),
            message,
            hardware_id: board_id.to_owned(),
            values,
        }
    };
    DiagnosticArray {
        header: Header::at(status.at, "board"),
        status: parts.map(status_of).to_vec(),
    }
}

/// Appends all numbers and words within a value, each under the names that lead to it, joined by
/// `_`.
fn leaves(name: &str, value: &Value, to: &mut Vec<KeyValue>) {
    let within = |own: &str| match name {
        "" => own.to_owned(),
        name => format!("{name}_{own}"),
    };
    match value {
        Value::Object(map) => map
            .iter()
            .for_each(|(own, value)| leaves(&within(own), value, to)),
        Value::Array(list) => {
            let numbered = list.iter().enumerate();
            numbered.for_each(|(own, value)| leaves(&within(&own.to_string()), value, to));
        }
        // Unknown values are left out.
        Value::Null => {}
        value => to.push(KeyValue {
            key: name.to_owned(),
            value: value
                .as_str()
                .map_or_else(|| value.to_string(), str::to_owned),
        }),
    }
}
