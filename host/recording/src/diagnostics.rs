//! The board's status as a ROS 2 diagnostic message.

use super::messages::{DiagnosticArray, DiagnosticStatus, KeyValue};
use super::publish::header;

pub(crate) fn diagnostics(status: &protocol::Status, board_id: &str) -> DiagnosticArray {
    let part =
        |name: &str, level: u8, message: String, values: &[(&str, String)]| DiagnosticStatus {
            level,
            name: name.to_owned(),
            message,
            hardware_id: board_id.to_owned(),
            values: values
                .iter()
                .map(|(key, value)| KeyValue {
                    key: (*key).to_owned(),
                    value: value.clone(),
                })
                .collect(),
        };
    let dropped = &status.dropped;
    let any_dropped = dropped.total() > 0 || status.link.lost_frames() > 0;
    let trigger = &status.trigger;
    let imu = &status.imu;
    DiagnosticArray {
        header: header(status.at, "board"),
        status: vec![
            part(
                "board",
                u8::from(any_dropped),
                String::from(if any_dropped {
                    "messages were dropped"
                } else {
                    "ok"
                }),
                &[
                    ("epoch", status.epoch.to_string()),
                    ("cpu_permille", status.cpu_permille.to_string()),
                    ("stack_used", status.stack_used.to_string()),
                    ("stack_size", status.stack_size.to_string()),
                    ("connects", status.connects.to_string()),
                    ("dropped_answers", dropped.answers.to_string()),
                    ("dropped_pulses", dropped.pulses.to_string()),
                    ("dropped_captures", dropped.captures.to_string()),
                    ("dropped_imu", dropped.imu.to_string()),
                    ("dropped_status", dropped.status.to_string()),
                    ("dropped_outputs", dropped.outputs.to_string()),
                    ("link_lost_frames", status.link.lost_frames().to_string()),
                    (
                        "strobe_overcaptures",
                        status.strobe_overcaptures.to_string(),
                    ),
                    ("strobe_floods", status.strobe_floods.to_string()),
                ],
            ),
            part(
                "trigger",
                u8::from(trigger.late > 0 || trigger.readback.missing > 0),
                format!("{:?}", trigger.state),
                &[
                    ("train", trigger.train.to_string()),
                    ("pulses", trigger.pulses.to_string()),
                    ("period_q32", trigger.period.0.to_string()),
                    ("late", trigger.late.to_string()),
                    ("readback_seen", trigger.readback.seen.to_string()),
                    ("readback_missing", trigger.readback.missing.to_string()),
                    ("readback_stray", trigger.readback.stray.to_string()),
                    ("latency_ticks", status.trigger_latency.to_string()),
                    ("busy_ticks", status.trigger_busy.to_string()),
                ],
            ),
            part(
                "imu",
                match imu.state {
                    protocol::ImuState::Running => 0,
                    protocol::ImuState::Starting => 1,
                    protocol::ImuState::Failed => 2,
                },
                format!("{:?}", imu.state),
                &[
                    ("clock", format!("{:?}", imu.clock)),
                    ("samples", imu.samples.to_string()),
                    ("late", imu.late.to_string()),
                    ("overcaptures", imu.overcaptures.to_string()),
                    ("recoveries", imu.recoveries.to_string()),
                    (
                        "last_fault",
                        imu.last_fault
                            .map_or(String::new(), |fault| format!("{fault:?}")),
                    ),
                ],
            ),
            part(
                "outputs",
                u8::from(status.outputs.iter().any(|output| output.late > 0)),
                outputs_state(&status.outputs),
                &outputs_values(&status.outputs, status.output_latency),
            ),
            part(
                "gnss",
                u8::from(status.gnss.late > 0 || status.gnss.missed > 0),
                format!("{:?}", status.gnss.state),
                &[
                    ("pulses", status.gnss.pulses.to_string()),
                    ("sentences", status.gnss.sentences.to_string()),
                    ("missed", status.gnss.missed.to_string()),
                    ("late", status.gnss.late.to_string()),
                ],
            ),
        ],
    }
}

fn outputs_state(outputs: &[protocol::OutputStatus; 3]) -> String {
    outputs
        .map(|output| format!("{:?}", output.state))
        .join(", ")
}

fn outputs_values(
    [two, three, four]: &[protocol::OutputStatus; 3],
    latency: u32,
) -> [(&'static str, String); 7] {
    [
        ("pulses_2", two.pulses.to_string()),
        ("pulses_3", three.pulses.to_string()),
        ("pulses_4", four.pulses.to_string()),
        ("late_2", two.late.to_string()),
        ("late_3", three.late.to_string()),
        ("late_4", four.late.to_string()),
        ("latency_ticks", latency.to_string()),
    ]
}
