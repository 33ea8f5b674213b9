//! Checks that the messages of a recording agree with each other.
//!
//! Messages are followed one by one and only a few states are kept, so memory does not grow with
//! the length of the recording.

use std::collections::BTreeMap;

use protocol::Ticks;

use super::findings::Findings;
use super::numbers::Numbers;
use super::pulses::Pulses;
use crate::diagnostics::BoardCounters;
use crate::session_file::SessionFile;
use crate::walk::{Event, Message};
use crate::{Item, Topic};

/// Function of the log entry for a frame that arrived damaged.
const DAMAGED: &str = "damaged";

/// Returns true if messages of a topic are written in the order of their times. Pulses of
/// several outputs may fall on one tick.
const fn in_order(topic: Topic) -> bool {
    use Topic::{Capture, Gnss, Imu, Pulse, Status, Temperature};
    matches!(topic, Imu | Temperature | Pulse | Capture | Status | Gnss)
}

/// The checks in progress.
pub(super) struct Content {
    /// Time of the last message on each topic whose times increase.
    last: BTreeMap<&'static str, Ticks>,
    /// First and last board time.
    pub(super) span: Option<[Ticks; 2]>,
    pub(super) numbers: Numbers,
    pub(super) pulses: Pulses,
    /// True if messages may be missing in the file right before the next one.
    after_gap: bool,
}

impl Content {
    /// Creates the state before the first message.
    pub(super) fn new(session: Option<&SessionFile>) -> Self {
        let imu = session.and_then(|session| session.imu.as_ref());
        Self {
            last: BTreeMap::new(),
            span: None,
            numbers: Numbers::new(imu.map(|imu| imu.setup.interval.into())),
            pulses: Pulses::new(session),
            after_gap: false,
        }
    }

    /// Checks the next part of the file.
    pub(super) fn check(&mut self, event: Event<'_>, findings: &mut Findings) {
        match event {
            Event::Message(message) => self.message(&message, findings),
            Event::Damage(damage) => {
                findings.damage(&damage);
                if damage.is_gap() {
                    self.after_gap = true;
                    self.numbers.forget();
                }
            }
        }
    }

    fn message(&mut self, message: &Message<'_>, findings: &mut Findings) {
        let (topic, name) = (message.channel.known, &message.channel.described.topic);
        match message.item() {
            Some(Ok(item)) => self.item(&item, message, findings),
            Some(Err(error)) => {
                findings.bad("message_damaged", Some(message.at()), || {
                    format!("a message of {name} cannot be read: {error}")
                });
            }
            None => {}
        }
        if let Some(topic) = topic.filter(|&topic| in_order(topic)) {
            self.time(topic.name(), message.at(), findings);
        }
        self.after_gap &= matches!(topic, Some(Topic::Link | Topic::Log | Topic::ImuFlags));
    }

    /// Checks that the times of a topic increase.
    fn time(&mut self, topic: &'static str, at: Ticks, findings: &mut Findings) {
        if let Some(last) = self.last.insert(topic, at)
            && at <= last
        {
            findings.bad("time_not_monotonic", Some(at), || {
                let older = last.as_secs_f64() - at.as_secs_f64();
                format!("a message of {topic} is {older:.6} s older than the one before it")
            });
        }
        let [from, to] = self.span.unwrap_or([at; 2]);
        self.span = Some([from.min(at), to.max(at)]);
    }

    /// Checks a message against the ones before it.
    fn item(&mut self, item: &Item, message: &Message<'_>, findings: &mut Findings) {
        let at = message.at();
        match item {
            Item::Imu(_) => self.numbers.sample(message, self.after_gap, findings),
            Item::Pulse(pulse) => self.pulses.pulse(pulse, findings),
            Item::Capture(capture) if capture.after_loss => {
                findings.check("captures_lost", Some(at), || {
                    String::from("an edge on the strobe input was lost, as the board says")
                });
            }
            Item::ImuFlags(flags) => self.numbers.flags(at, flags),
            Item::Status(status) => {
                if let Some(counters) = BoardCounters::from_message(status) {
                    self.numbers.status(counters, at, findings);
                }
            }
            Item::Log(log) if log.function == DAMAGED => {
                self.numbers.damaged(&log.msg, at, findings);
            }
            Item::Period(period) => self.pulses.follow(period),
            _ => {}
        }
        if let Some(stream) = item.topic().stream() {
            let number = message.header.sequence;
            self.numbers.number(stream, number, at, findings);
        }
    }
}
