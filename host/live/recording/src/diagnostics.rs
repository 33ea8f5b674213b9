//! The board's status as a ROS 2 diagnostic message, and the counters that are read back of it.

use std::str::FromStr;

use protocol::{Dropped, ImuState, Status};
use serde_json::Value;

use super::messages::{DiagnosticArray, DiagnosticStatus, KeyValue};
use super::publish::header;

/// Counters of the board, as a recorded status has them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BoardCounters {
    /// The board's number of its run.
    pub epoch: u32,
    /// Messages that it dropped.
    pub dropped: Dropped,
    /// Samples that it read from the IMU.
    pub imu_samples: u32,
    /// The trigger's train.
    pub train: u32,
    /// Pulses of that train.
    pub pulses: u64,
}

impl BoardCounters {
    /// Reads them; `None` if one is missing.
    #[must_use]
    pub fn of(array: &DiagnosticArray) -> Option<Self> {
        fn value<T: FromStr>(array: &DiagnosticArray, part: &str, key: &str) -> Option<T> {
            let part = array.status.iter().find(|found| found.name == part)?;
            let found = part.values.iter().find(|found| found.key == key)?;
            found.value.parse().ok()
        }
        let board = |key| value(array, "board", key);
        Some(Self {
            epoch: board("epoch")?,
            dropped: Dropped {
                answers: board("dropped_answers")?,
                pulses: board("dropped_pulses")?,
                captures: board("dropped_captures")?,
                imu: board("dropped_imu")?,
                status: board("dropped_status")?,
                outputs: board("dropped_outputs")?,
            },
            imu_samples: value(array, "imu", "samples")?,
            train: value(array, "trigger", "train")?,
            pulses: value(array, "trigger", "pulses")?,
        })
    }
}

/// The status in five parts, each with all its numbers by their names in [`Status`].
pub(crate) fn diagnostics(status: &Status, board_id: &str) -> DiagnosticArray {
    let (trigger, imu, gnss) = (&status.trigger, &status.imu, &status.gnss);
    let is_lossy = status.dropped.total() > 0 || status.link.lost_frames > 0;
    let said = if is_lossy {
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
    // Its numbers always are one of JSON.
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
        // All that no other part has.
        ("board", u8::from(is_lossy), String::from(said)),
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
        header: header(status.at, "board"),
        status: parts.map(status_of).to_vec(),
    }
}

/// All values within one, by their names from the outside in.
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
        // Not known.
        Value::Null => {}
        value => to.push(KeyValue {
            key: name.to_owned(),
            value: value
                .as_str()
                .map_or_else(|| value.to_string(), str::to_owned),
        }),
    }
}
