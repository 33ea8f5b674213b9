//! The messages of each topic: numbers without a gap, times that go on.

use std::collections::BTreeMap;

use mcap::records::MessageHeader;

use crate::verify::{Findings, Grade, TopicReport};
use recording::Topic;
use recording::reader::ticks_of_nanos;

/// The most topics that are counted one by one.
const MAX_TOPICS: usize = 1_000;

/// Whether messages of a topic come in the order of their times. Pulses of several
/// outputs may fall on one tick.
const fn in_order(topic: Topic) -> bool {
    matches!(
        topic,
        Topic::Imu
            | Topic::Temperature
            | Topic::Pulse
            | Topic::Capture
            | Topic::Status
            | Topic::Gnss
    )
}

/// A topic's running number and time.
#[derive(Default)]
struct TopicState {
    report: TopicReport,
    expected: Option<u32>,
    last: Option<u64>,
}

/// The checks of the topics while they run.
#[derive(Default)]
pub(super) struct Topics {
    topics: BTreeMap<String, TopicState>,
    span: Option<[u64; 2]>,
}

impl Topics {
    /// The board was reset: its time begins anew.
    pub(super) fn begin_run(&mut self) {
        for state in self.topics.values_mut() {
            state.last = None;
        }
    }

    /// First and last board time, ns.
    pub(super) const fn span(&self) -> Option<[u64; 2]> {
        self.span
    }

    pub(super) fn reports(self) -> BTreeMap<String, TopicReport> {
        let reports = self.topics.into_iter();
        reports.map(|(name, state)| (name, state.report)).collect()
    }

    /// The number of a message in its topic, and its time.
    pub(super) fn place(
        &mut self,
        name: &str,
        topic: Option<Topic>,
        header: &MessageHeader,
        findings: &mut Findings,
    ) {
        let at = header.log_time;
        if self.topics.len() >= MAX_TOPICS && !self.topics.contains_key(name) {
            return;
        }
        let state = self.topics.entry(name.to_owned()).or_default();
        state.report.messages += 1;
        if let Some(expected) = state.expected {
            let missing = header.sequence.wrapping_sub(expected);
            if missing > u32::MAX / 2 {
                findings.add(Grade::Error, "order", Some(ticks_of_nanos(at)), || {
                    format!(
                        "message {} of {name} comes twice or too late",
                        header.sequence
                    )
                });
            } else if missing > 0 {
                state.report.missing += u64::from(missing);
                findings.add_many(
                    Grade::Error,
                    "messages_cut_out",
                    Some(ticks_of_nanos(at)),
                    u64::from(missing),
                    || format!("{missing} messages of {name} are gone from the file"),
                );
            }
        }
        state.expected = Some(header.sequence.wrapping_add(1));
        if topic.is_some_and(in_order) {
            if let Some(last) = state.last
                && at <= last
            {
                findings.add(
                    Grade::Error,
                    "time_not_monotonic",
                    Some(ticks_of_nanos(at)),
                    || {
                        format!(
                            "a message of {name} is {:.6} s older than the one before it",
                            (last - at) as f64 * 1e-9
                        )
                    },
                );
            }
            state.last = Some(at);
            let [from, to] = self.span.unwrap_or([at; 2]);
            self.span = Some([from.min(at), to.max(at)]);
        }
    }
}
