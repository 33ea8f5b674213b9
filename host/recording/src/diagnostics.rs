//! The board's status as a ROS 2 diagnostic message, and the counters that are read back of it.

use std::fmt::Display;
use std::str::FromStr;

use protocol::{Dropped, GnssStatus, ImuState, ImuStatus, Status};

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

pub(crate) fn diagnostics(status: &Status, board_id: &str) -> DiagnosticArray {
    DiagnosticArray {
        header: header(status.at, "board"),
        status: [
            board(status),
            trigger(status),
            imu(&status.imu),
            outputs(status),
            gnss(&status.gnss),
        ]
        .map(|part| DiagnosticStatus {
            hardware_id: board_id.to_owned(),
            ..part
        })
        .to_vec(),
    }
}

fn part(
    name: &str,
    level: u8,
    message: String,
    values: &[(&str, &dyn Display)],
) -> DiagnosticStatus {
    DiagnosticStatus {
        level,
        name: name.to_owned(),
        message,
        hardware_id: String::new(),
        values: values
            .iter()
            .map(|(key, value)| KeyValue {
                key: (*key).to_owned(),
                value: value.to_string(),
            })
            .collect(),
    }
}

fn board(status: &Status) -> DiagnosticStatus {
    let dropped = &status.dropped;
    let lost_frames = status.link.lost_frames;
    let any_dropped = dropped.total() > 0 || lost_frames > 0;
    let message = if any_dropped {
        "messages were dropped"
    } else {
        "ok"
    };
    part(
        "board",
        u8::from(any_dropped),
        String::from(message),
        &[
            ("epoch", &status.epoch),
            ("cpu_permille", &status.cpu_permille),
            ("stack_used", &status.stack_used),
            ("stack_size", &status.stack_size),
            ("supply_mv", &status.supply_mv.unwrap_or_default()),
            ("usb_resets", &status.usb.resets),
            ("usb_suspends", &status.usb.suspends),
            ("usb_stuck", &status.usb.stuck),
            ("connects", &status.connects),
            ("dropped_answers", &dropped.answers),
            ("dropped_pulses", &dropped.pulses),
            ("dropped_captures", &dropped.captures),
            ("dropped_imu", &dropped.imu),
            ("dropped_status", &dropped.status),
            ("dropped_outputs", &dropped.outputs),
            ("link_lost_frames", &lost_frames),
            ("strobe_overcaptures", &status.strobe_overcaptures),
            ("strobe_floods", &status.strobe_floods),
        ],
    )
}

fn trigger(status: &Status) -> DiagnosticStatus {
    let trigger = &status.trigger;
    part(
        "trigger",
        u8::from(trigger.late > 0 || trigger.readback.missing > 0),
        format!("{:?}", trigger.state),
        &[
            ("train", &trigger.train),
            ("pulses", &trigger.pulses),
            ("period_q32", &trigger.period.0),
            ("late", &trigger.late),
            ("readback_seen", &trigger.readback.seen),
            ("readback_missing", &trigger.readback.missing),
            ("readback_stray", &trigger.readback.stray),
            ("latency_ticks", &status.trigger_latency),
            ("busy_ticks", &(status.handlers.trigger.cycles / 2)),
        ],
    )
}

fn imu(imu: &ImuStatus) -> DiagnosticStatus {
    let level = match imu.state {
        ImuState::Running => 0,
        ImuState::Starting => 1,
        ImuState::Failed => 2,
    };
    let last_fault = imu
        .last_fault
        .map_or(String::new(), |fault| format!("{fault:?}"));
    part(
        "imu",
        level,
        format!("{:?}", imu.state),
        &[
            ("clock", &format!("{:?}", imu.clock)),
            ("samples", &imu.samples),
            ("late", &imu.late),
            ("overcaptures", &imu.overcaptures),
            ("recoveries", &imu.recoveries),
            ("last_fault", &last_fault),
        ],
    )
}

fn outputs(status: &Status) -> DiagnosticStatus {
    let [two, three, four] = &status.outputs;
    let states = [two, three, four].map(|output| format!("{:?}", output.state));
    part(
        "outputs",
        u8::from(status.outputs.iter().any(|output| output.late > 0)),
        states.join(", "),
        &[
            ("pulses_2", &two.pulses),
            ("pulses_3", &three.pulses),
            ("pulses_4", &four.pulses),
            ("late_2", &two.late),
            ("late_3", &three.late),
            ("late_4", &four.late),
            ("latency_ticks", &status.output_latency),
        ],
    )
}

fn gnss(gnss: &GnssStatus) -> DiagnosticStatus {
    part(
        "gnss",
        u8::from(gnss.late > 0 || gnss.missed > 0),
        format!("{:?}", gnss.state),
        &[
            ("pulses", &gnss.pulses),
            ("sentences", &gnss.sentences),
            ("missed", &gnss.missed),
            ("late", &gnss.late),
        ],
    )
}
