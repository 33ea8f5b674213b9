//! The messages of a recording: whether they agree with each other.
//!
//! Everything is followed message by message; nothing but a few states is kept,
//! so hours of recording need no memory.

use std::path::Path;

use recording::diagnostics::BoardCounters;
use recording::messages::Header;
use recording::session_file::SessionFile;
use recording::walk::{Event, FileReport, Message};
use recording::{Item, Topic};

use super::numbers::{Numbers, stream_of};
use super::pulses::Pulses;
use super::topics::Topics;
use super::{FORM, Findings, Report};

/// Kind of the log's entry for a frame that came damaged.
const DAMAGED: &str = "damaged";

/// The checks while they run.
pub(super) struct Content {
    topics: Topics,
    numbers: Numbers,
    pulses: Pulses,
    markers: usize,
    /// Something is missing in the file here, and anywhere.
    after_gap: bool,
    has_gaps: bool,
}

impl Content {
    /// Before the first message.
    pub(super) fn new(session: Option<&SessionFile>) -> Self {
        let imu = session.and_then(|session| session.imu.as_ref());
        Self {
            topics: Topics::default(),
            numbers: Numbers::new(imu.map(|imu| imu.setup.interval.into())),
            pulses: Pulses::new(session),
            markers: 0,
            after_gap: false,
            has_gaps: false,
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
        if let Some(session) = session.filter(|_| file.closed && !self.has_gaps) {
            self.compare_with(session, &mut findings);
        }
        let damaged_frames = self.numbers.damaged_frames();
        let streams = self.numbers.finish(self.has_gaps, &mut findings);
        let span = self.topics.span();
        Report {
            form: FORM,
            recording: recording.display().to_string(),
            severity: findings.worst(),
            file,
            board_time_s: span.map(|span| span.map(|at| at.as_secs_f64())),
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

    /// What the session counted against what is in the file.
    fn compare_with(&self, session: &SessionFile, findings: &mut Findings) {
        let (noted, marked) = (session.markers.len(), self.markers);
        if noted != marked {
            findings.bad("markers_differ", None, || {
                format!("the session file has {noted} marks, the recording {marked}")
            });
        }
        let (counted, missing) = (session.counts.lost(), self.numbers.missing());
        if counted > missing {
            findings.bad("losses_differ", None, || {
                format!(
                    "the session counted {counted} lost messages, but by the board's numbers \
                     {missing} are missing"
                )
            });
        }
    }

    /// Takes what was read of the file.
    pub(super) fn take(&mut self, event: Event<'_>, findings: &mut Findings) {
        match event {
            Event::Message(message) => self.message(&message, findings),
            Event::Damage(damage) => {
                findings.damage(&damage);
                if damage.is_gap() {
                    (self.after_gap, self.has_gaps) = (true, true);
                    self.pulses.forget();
                    self.numbers.forget();
                    self.topics.gap();
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
        self.topics.place(name, topic, &message.header, findings);
        self.after_gap &= matches!(topic, Some(Topic::Link | Topic::Log | Topic::ImuFlags));
    }

    /// What a message says, against the ones before it.
    fn item(&mut self, item: &Item, message: &Message<'_>, findings: &mut Findings) {
        let at = message.at();
        let stamped = |header: &Header, findings: &mut Findings| {
            let (nanos, stamp) = (message.header.log_time, header.stamp.nanos());
            if i64::try_from(nanos) != Ok(stamp) {
                findings.bad("stamp_differs", Some(at), || {
                    format!("a message of {nanos} ns has a header of {stamp} ns")
                });
            }
        };
        match item {
            Item::Imu(imu) => {
                stamped(&imu.header, findings);
                self.numbers.sample(message, self.after_gap, findings);
                if imu.angular_velocity.iter().any(|rate| !rate.is_finite()) {
                    findings.bad("not_a_number", Some(at), || {
                        String::from("an IMU sample is not a number")
                    });
                }
            }
            Item::Pulse(pulse) => {
                stamped(&pulse.header, findings);
                if at.0 != pulse.ticks {
                    findings.bad("stamp_differs", Some(at), || {
                        format!("a pulse of tick {} is logged at {}", pulse.ticks, at.0)
                    });
                }
                self.pulses.pulse(pulse, findings);
            }
            Item::Capture(capture) => {
                stamped(&capture.header, findings);
                if capture.after_loss {
                    findings.check("captures_lost", Some(at), || {
                        String::from("an edge on the strobe input was lost, as the board says")
                    });
                }
            }
            Item::ImuFlags(flags) => {
                stamped(&flags.header, findings);
                self.numbers.flags(at, flags);
            }
            Item::Status(status) => {
                stamped(&status.header, findings);
                if let Some(counters) = BoardCounters::of(status) {
                    self.numbers.status(counters, at, findings);
                    if !self.after_gap {
                        self.pulses.count(&counters, at, findings);
                    }
                } else {
                    findings.bad("status_counters", Some(at), || {
                        String::from("a status lacks counters of the board")
                    });
                }
            }
            Item::Log(log) if log.function == DAMAGED => {
                self.numbers.damaged(&log.msg, at, findings);
            }
            Item::Output(pulse) => stamped(&pulse.header, findings),
            Item::Gnss(pulse) => stamped(&pulse.header, findings),
            Item::Period(period) => self.pulses.follow(period),
            Item::Marker(_) => self.markers += 1,
            _ => {}
        }
        if let Some(stream) = stream_of(item.topic()) {
            let number = message.header.sequence;
            self.numbers.number(stream, number, at, findings);
        }
    }
}
