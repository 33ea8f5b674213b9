//! Checks that the messages of a recording agree with each other.
//!
//! Messages are followed one by one and only a few states are kept, so memory does not grow with
//! the length of the recording.

use std::collections::BTreeMap;

use protocol::{TICK_HZ, Ticks};

use super::fault::Fault;
use super::findings::Findings;
use super::numbers::Numbers;
use super::pulses::Pulses;
use super::stated::Stated;
use crate::contents::Tally;
use crate::diagnostics::BoardCounters;
use crate::session_file::SessionFile;
use crate::walk::{Event, Message};
use crate::{Item, Topic};

/// Function of the log entry for a frame that arrived damaged.
const DAMAGED: &str = "damaged";

/// Longest time that a message may be older than the latest before it, ticks: 10 s. The board sends
/// its queues one after the other, each of less than a second.
const IN_STEP: u64 = 10 * TICK_HZ as u64;

/// Returns true if messages of a topic are written in the order of their times. Pulses of
/// several outputs may fall on one tick.
const fn in_order(topic: Topic) -> bool {
    use Topic::{Capture, Gnss, Imu, Pulse, Status, Temperature};
    matches!(topic, Imu | Temperature | Pulse | Capture | Status | Gnss)
}

/// The checks in progress.
pub(super) struct Content<'a> {
    /// Time of the last message on each topic whose times increase.
    last: BTreeMap<&'static str, Ticks>,
    /// First and last board time.
    pub(super) span: Option<[Ticks; 2]>,
    /// Messages by topic.
    pub(super) tally: Tally,
    /// Messages with a stamp that was compared with their time.
    pub(super) stamps: u64,
    /// True if there are topics of this program.
    pub(super) is_own: bool,
    /// True if there is any damage.
    pub(super) is_damaged: bool,
    pub(super) numbers: Numbers,
    pub(super) pulses: Pulses,
    pub(super) stated: Stated<'a>,
    /// True if messages may be missing in the file right before the next one.
    after_gap: bool,
}

impl<'a> Content<'a> {
    /// Creates the state before the first message.
    pub(super) fn new(session: Option<&'a SessionFile>) -> Self {
        let imu = session.and_then(|session| session.imu.as_ref());
        Self {
            last: BTreeMap::new(),
            span: None,
            tally: Tally::default(),
            stamps: 0,
            is_own: false,
            is_damaged: false,
            numbers: Numbers::new(imu.map(|imu| imu.setup.interval.into())),
            pulses: Pulses::new(session),
            stated: Stated::new(session),
            after_gap: false,
        }
    }

    /// Checks the next part of the file.
    pub(super) fn check(&mut self, event: Event<'_>, findings: &mut Findings) {
        match event {
            Event::Message(message) => self.message(&message, findings),
            Event::Damage(damage) => {
                self.is_damaged = true;
                if damage.is_gap() {
                    self.after_gap = true;
                    self.numbers.forget();
                }
                let at = damage.at();
                findings.add(&Fault::Damage(damage), at);
            }
        }
    }

    fn message(&mut self, message: &Message<'_>, findings: &mut Findings) {
        let (topic, name) = (message.channel.known, &message.channel.described.topic);
        self.tally.add(name, &message.header, message.data);
        self.is_own |= topic.is_some();
        match message.item() {
            Some(Ok(item)) => self.item(&item, message, findings),
            Some(Err(error)) => {
                let topic = name.clone();
                findings.add(&Fault::MessageDamaged { topic, error }, Some(message.at()));
            }
            None => {}
        }
        if let Some(topic) = topic.filter(|&topic| in_order(topic)) {
            self.time(topic.name(), message.at(), findings);
        }
        self.after_gap &= matches!(topic, Some(Topic::Link | Topic::Log | Topic::ImuFlags));
    }

    /// Checks that the times of a topic increase, and that they are in step with the others.
    fn time(&mut self, topic: &'static str, at: Ticks, findings: &mut Findings) {
        let seconds = |later: Ticks| later.as_secs_f64() - at.as_secs_f64();
        let last = self.last.insert(topic, at);
        let [from, to] = self.span.unwrap_or([at; 2]);
        if let Some(last) = last.filter(|last| at <= *last) {
            let older_s = seconds(last);
            findings.add(&Fault::NotMonotonic { topic, older_s }, Some(at));
        } else if to.0.saturating_sub(at.0) > IN_STEP {
            let late_s = seconds(to);
            findings.add(&Fault::OutOfStep { topic, late_s }, Some(at));
        }
        self.span = Some([from.min(at), to.max(at)]);
    }

    /// Checks that a message states its time in itself as the file does.
    fn stamp(&mut self, item: &Item, message: &Message<'_>, findings: &mut Findings) {
        let header = &message.header;
        let is_same = |stamp: i64| u64::try_from(stamp).is_ok_and(|stamp| stamp == header.log_time);
        let ticks = match item {
            Item::Pulse(pulse) | Item::Output(pulse) => Some(Ticks(pulse.ticks)),
            Item::Capture(capture) => Some(Ticks(capture.ticks)),
            _ => None,
        };
        let Some(stamp) = item.stamp() else { return };
        self.stamps += 1;
        let is_right = is_same(stamp.nanos())
            && ticks.is_none_or(|ticks| ticks.as_nanos() == header.log_time)
            && header.publish_time == header.log_time;
        if !is_right {
            let topic = item.topic().name();
            findings.add(&Fault::StampDiffers { topic }, Some(message.at()));
        }
    }

    /// Checks a message against the ones before it.
    fn item(&mut self, item: &Item, message: &Message<'_>, findings: &mut Findings) {
        let at = message.at();
        self.stamp(item, message, findings);
        self.stated.see(item, at, findings);
        match item {
            Item::Imu(_) => self.numbers.sample(message, self.after_gap, findings),
            Item::Pulse(pulse) => self.pulses.pulse(pulse, findings),
            Item::Capture(capture) if capture.after_loss => {
                findings.add(&Fault::CapturesLost, Some(at));
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
