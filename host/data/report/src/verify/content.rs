//! The messages of a recording: whether they agree with each other.
//!
//! Everything is followed message by message; nothing but a few states is kept,
//! so hours of recording need no memory.

use std::collections::BTreeMap;
use std::path::Path;

use protocol::Ticks;
use recording::diagnostics::BoardCounters;
use recording::session_file::SessionFile;
use recording::walk::{Event, FileReport, Message};
use recording::{Item, Topic};

use super::numbers::{Numbers, stream_of};
use super::pulses::Pulses;
use super::{FORM, Findings, Report};

/// Kind of the log's entry for a frame that came damaged.
const DAMAGED: &str = "damaged";

/// Whether messages of a topic come in the order of their times. Pulses of several
/// outputs may fall on one tick.
const fn in_order(topic: Topic) -> bool {
    use Topic::{Capture, Gnss, Imu, Pulse, Status, Temperature};
    matches!(topic, Imu | Temperature | Pulse | Capture | Status | Gnss)
}

/// The checks while they run.
pub(super) struct Content {
    /// Time of the last message of each topic whose times go on.
    last: BTreeMap<&'static str, Ticks>,
    /// First and last board time.
    span: Option<[Ticks; 2]>,
    numbers: Numbers,
    pulses: Pulses,
    /// Something is missing in the file here.
    after_gap: bool,
}

impl Content {
    /// Before the first message.
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

    /// What came of it, of `recording` whose bytes are `file`.
    pub(super) fn finish(
        self,
        recording: &Path,
        file: FileReport,
        session: Option<&SessionFile>,
        mut findings: Findings,
    ) -> Report {
        let damaged_frames = self.numbers.damaged_frames();
        let streams = self.numbers.finish(&mut findings);
        Report {
            form: FORM,
            recording: recording.display().to_string(),
            severity: findings.worst(),
            file,
            board_time_s: self.span.map(|span| span.map(|at| at.as_secs_f64())),
            damaged_frames,
            grid: self.pulses.report(),
            streams,
            findings: findings.0,
            alignment: session
                .and_then(|session| session.alignment)
                .map(|alignment| alignment.promise()),
            report: None,
        }
    }

    /// Takes what was read of the file.
    pub(super) fn take(&mut self, event: Event<'_>, findings: &mut Findings) {
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

    /// Times of a topic go on.
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

    /// What a message says, against the ones before it.
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
                if let Some(counters) = BoardCounters::of(status) {
                    self.numbers.status(counters, at, findings);
                }
            }
            Item::Log(log) if log.function == DAMAGED => {
                self.numbers.damaged(&log.msg, at, findings);
            }
            Item::Period(period) => self.pulses.follow(period),
            _ => {}
        }
        if let Some(stream) = stream_of(item.topic()) {
            let number = message.header.sequence;
            self.numbers.number(stream, number, at, findings);
        }
    }
}
