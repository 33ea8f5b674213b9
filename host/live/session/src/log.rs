//! The log of a session: passes every event to the recording, to the problems of
//! `session.json`, and to the listener.

use std::path::PathBuf;

use board::finding::{EventKind, Finding};
use protocol::{TICK_HZ, Ticks};
use recording::RecordingError;
use recording::writer::Writer;

use crate::error::Stop;
use crate::event::{SessionEvent, Stamped};

/// Largest number of problems that are kept one by one.
const MAX_PROBLEMS: usize = 1_000;

/// Distance from which a message's time is far ahead of all others, ticks: 10 s.
const FAR: u64 = 10 * TICK_HZ as u64;

/// Receives the events of a session as they happen.
pub type Listener<'a> = &'a mut dyn FnMut(&Stamped);

/// The outputs of a session.
pub struct Log<'a> {
    listener: Listener<'a>,
    /// The MCAP file, until it is finished or has failed.
    pub(crate) writer: Option<Writer>,
    /// The recording's folder.
    pub(crate) folder: PathBuf,
    /// Latest board time that was handled.
    pub(crate) now: Ticks,
    /// The problems that were reported.
    problems: Vec<Finding>,
    /// The time of one message that was far ahead of `now`.
    ahead: Option<Ticks>,
    has_odd_time: bool,
}

impl<'a> Log<'a> {
    /// Creates a log that writes into an existing folder.
    #[must_use]
    pub const fn new(listener: Listener<'a>, writer: Writer, folder: PathBuf) -> Self {
        Self {
            listener,
            writer: Some(writer),
            folder,
            now: Ticks::ZERO,
            problems: Vec::new(),
            ahead: None,
            has_odd_time: false,
        }
    }

    /// Advances the latest board time to that of a message. A time far ahead of all others
    /// counts only once a second message has the same, so that a single wrong one does not end
    /// a recording; it is reported once.
    pub(crate) fn advance(&mut self, at: Ticks) -> Result<(), Stop> {
        let is_far = |from: Ticks| at.0.abs_diff(from.0) > FAR;
        if at > self.now && is_far(self.now) && self.ahead.is_none_or(is_far) {
            self.ahead = Some(at);
            return Ok(());
        }
        let late = (at < self.now && is_far(self.now)).then_some(at);
        let odd = self.ahead.take().filter(|ahead| is_far(*ahead)).or(late);
        self.now = self.now.max(at);
        match odd {
            Some(odd) if !std::mem::replace(&mut self.has_odd_time, true) => {
                self.report(SessionEvent::TimeOdd { odd })
            }
            _ => Ok(()),
        }
    }

    /// Returns the problems that were reported, in order.
    #[must_use]
    pub fn problems(&self) -> &[Finding] {
        &self.problems
    }

    /// Writes into the recording, while it is open.
    pub(crate) fn write(
        &mut self,
        write: impl FnOnce(&mut Writer, Ticks) -> Result<(), RecordingError>,
    ) -> Result<(), Stop> {
        match &mut self.writer {
            Some(writer) => Ok(write(writer, self.now)?),
            None => Ok(()),
        }
    }

    /// Passes an event to the listener alone.
    pub(crate) fn publish(&mut self, event: SessionEvent) {
        (self.listener)(&Stamped {
            at: self.now,
            event,
        });
    }

    /// Reports an event to the listener, in the recording's log, and among the problems if it
    /// is one.
    pub(crate) fn report(&mut self, event: SessionEvent) -> Result<(), Stop> {
        self.report_at(self.now, event)
    }

    /// Reports an event as [`Log::report`] does, with a time other than the latest.
    pub(crate) fn report_at(&mut self, at: Ticks, event: SessionEvent) -> Result<(), Stop> {
        let notice = event.notice();
        let stamped = Stamped { at, event };
        (self.listener)(&stamped);
        let Some(notice) = notice else {
            return Ok(());
        };
        let Finding {
            kind,
            severity,
            text,
            ..
        } = notice.finding;
        if notice.is_problem && self.problems.len() <= MAX_PROBLEMS {
            let problem = if self.problems.len() == MAX_PROBLEMS {
                let more = "further problems are in /session/log only";
                Finding::new(severity, EventKind::More, more)
            } else {
                Finding::new(severity, kind.clone(), text.as_str())
            };
            // The other steps help only while the session runs.
            let next_step = match stamped.event {
                SessionEvent::Found { finding } => finding.next_step,
                _ => None,
            };
            self.problems.push(Finding {
                next_step,
                ..problem.at(at)
            });
        }
        if !notice.is_logged {
            return Ok(());
        }
        self.write(|writer, _| writer.log(at, severity, &kind.to_string(), &text))
    }

    /// Reports a problem while closing, when nothing can be done about a failure to write.
    pub(crate) fn report_at_end(&mut self, event: SessionEvent) {
        if self.report(event).is_err() {
            self.writer = None;
        }
    }

    /// Reports the findings of the watch.
    pub(crate) fn report_all(&mut self, findings: Vec<Finding>) -> Result<(), Stop> {
        findings
            .into_iter()
            .try_for_each(|finding| self.report(SessionEvent::Found { finding }))
    }
}
