//! The messages of each topic: numbers without a gap, times that go on.

use std::collections::BTreeMap;

use board::follow;
use mcap::records::MessageHeader;
use protocol::Ticks;
use recording::Topic;
use recording::finding::Severity;
use recording::ticks_of_nanos;

use super::Findings;
use super::numbers::stream_of;

/// The most topics that are counted one by one.
const MAX_TOPICS: usize = 1_000;

/// Whether messages of a topic come in the order of their times. Pulses of several
/// outputs may fall on one tick.
const fn in_order(topic: Topic) -> bool {
    use Topic::{Capture, Gnss, Imu, Pulse, Status, Temperature};
    matches!(topic, Imu | Temperature | Pulse | Capture | Status | Gnss)
}

/// A topic's running number and time.
#[derive(Default)]
struct TopicState {
    expected: Option<u32>,
    last: Option<u64>,
    /// Something is missing in the file since its last message.
    after_gap: bool,
}

/// The checks of the topics while they run.
#[derive(Default)]
pub(super) struct Topics {
    topics: BTreeMap<String, TopicState>,
    span: Option<[Ticks; 2]>,
}

impl Topics {
    /// Something is missing in the file here.
    pub(super) fn gap(&mut self) {
        for state in self.topics.values_mut() {
            state.after_gap = true;
        }
    }

    /// First and last board time.
    pub(super) const fn span(&self) -> Option<[Ticks; 2]> {
        self.span
    }

    /// The number of a message in its topic, and its time.
    pub(super) fn place(
        &mut self,
        name: &str,
        topic: Option<Topic>,
        header: &MessageHeader,
        findings: &mut Findings,
    ) {
        let (nanos, number) = (header.log_time, header.sequence);
        let at = ticks_of_nanos(nanos);
        if self.topics.len() >= MAX_TOPICS && !self.topics.contains_key(name) {
            return;
        }
        let state = self.topics.entry(name.to_owned()).or_default();
        // Of what the board numbers, what is missing was lost on the way, unless the file is
        // damaged here.
        let after_gap = std::mem::take(&mut state.after_gap);
        let is_lost = topic.and_then(stream_of).is_some() && !after_gap;
        state.expected = state.expected.filter(|_| !is_lost);
        match follow(&mut state.expected, number) {
            None => findings.bad("order", Some(at), || {
                format!("message {number} of {name} comes twice or too late")
            }),
            Some(0) => {}
            Some(missing) => {
                let count = (Some(at), u64::from(missing));
                findings.add(Severity::Bad, "messages_cut_out", count, || {
                    format!("{missing} messages of {name} are gone from the file")
                });
            }
        }
        if !topic.is_some_and(in_order) {
            return;
        }
        if let Some(last) = state.last.replace(nanos)
            && nanos <= last
        {
            findings.bad("time_not_monotonic", Some(at), || {
                let older = (last - nanos) as f64 * 1e-9;
                format!("a message of {name} is {older:.6} s older than the one before it")
            });
        }
        let [from, to] = self.span.unwrap_or([at; 2]);
        self.span = Some([from.min(at), to.max(at)]);
    }
}
