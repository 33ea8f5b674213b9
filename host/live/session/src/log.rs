//! The log of a session: every event goes through it, into the recording, into
//! `session.json`, and to whoever listens.

use std::path::PathBuf;

use clock::ClockRelation;
use protocol::{TICK_HZ, Ticks};
use recording::RecordingError;
use recording::session_file::{PhoneRecord, SessionFile, SessionOutcome};
use recording::writer::Writer;

use crate::error::Stop;
use crate::event::{PhoneName, SessionEvent, Stamped};
use board::finding::Finding;

/// The most problems that are kept one by one.
const MAX_PROBLEMS: usize = 1_000;

/// A message this far ahead of all others, in ticks, counts for nothing by itself: 10 s.
const FAR: u64 = 10 * TICK_HZ as u64;

/// Who listens to a session.
pub type Listener<'a> = &'a mut dyn FnMut(&Stamped);

/// The outputs of a session.
pub struct Log<'a> {
    listener: Listener<'a>,
    /// The MCAP file, until it is finished or has failed.
    pub(crate) writer: Option<Writer>,
    /// The recording's folder.
    pub(crate) folder: PathBuf,
    /// What is decided.
    pub file: SessionFile,
    /// Latest board time that was handled.
    pub(crate) now: Ticks,
    /// A time far beyond it that one message had.
    ahead: Option<Ticks>,
    has_odd_time: bool,
    has_problems: bool,
}

impl<'a> Log<'a> {
    /// A log into a folder that is there.
    #[must_use]
    pub const fn new(
        listener: Listener<'a>,
        writer: Writer,
        folder: PathBuf,
        file: SessionFile,
    ) -> Self {
        Self {
            listener,
            writer: Some(writer),
            folder,
            file,
            now: Ticks::ZERO,
            ahead: None,
            has_odd_time: false,
            has_problems: false,
        }
    }

    /// Takes the board time of a message. One that is far ahead of all others counts once
    /// a second message has the same: a single wrong one must not end a recording. That
    /// there was one is reported, once.
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

    /// Tells whether anything went wrong so far.
    #[must_use]
    pub const fn has_problems(&self) -> bool {
        self.has_problems
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

    /// Gives an event to the listener alone.
    pub(crate) fn tell(&mut self, event: SessionEvent) {
        (self.listener)(&Stamped {
            at: self.now,
            event,
        });
    }

    /// Reports an event: to the listener, in the recording's log, and in the session file
    /// if it is a problem.
    pub(crate) fn report(&mut self, event: SessionEvent) -> Result<(), Stop> {
        self.report_at(self.now, event)
    }

    /// As [`Log::report`], for an event whose time is not the latest.
    pub(crate) fn report_at(&mut self, at: Ticks, event: SessionEvent) -> Result<(), Stop> {
        let stamped = Stamped { at, event };
        let event = &stamped.event;
        let Some(kind) = event.kind() else {
            self.tell(stamped.event);
            return Ok(());
        };
        let (severity, text) = (event.severity(), event.to_string());
        if event.is_problem() {
            self.has_problems = true;
            let count = self.file.problems.len();
            let more = "further problems are in /session/log only";
            let (kind, text) = match count {
                MAX_PROBLEMS => ("more", more),
                _ => (kind, text.as_str()),
            };
            if count <= MAX_PROBLEMS {
                let next_step = match event {
                    SessionEvent::Found { finding } => finding.next_step.clone(),
                    _ => None,
                };
                self.file.problems.push(Finding {
                    next_step,
                    ..Finding::new(severity, kind, text).at(at)
                });
            }
        }
        (self.listener)(&stamped);
        self.write(|writer, _| writer.log(at, severity, kind, &text))
    }

    /// Reports a problem while closing, where nothing can be done about a failure.
    pub(crate) fn report_at_end(&mut self, event: SessionEvent) {
        if self.report(event).is_err() {
            self.writer = None;
        }
    }

    /// Reports what the watch has found.
    pub(crate) fn report_all(&mut self, findings: Vec<Finding>) -> Result<(), Stop> {
        findings
            .into_iter()
            .try_for_each(|finding| self.report(SessionEvent::Found { finding }))
    }

    /// How the session ends with this result.
    #[must_use]
    pub const fn outcome_of(&self, result: &Result<(), Stop>) -> SessionOutcome {
        match result {
            Err(Stop::Failed(_)) => SessionOutcome::Failed,
            Err(Stop::Interrupted) => SessionOutcome::Interrupted,
            Ok(()) | Err(Stop::BoardReset) if self.has_problems() => SessionOutcome::Loss,
            Ok(()) | Err(Stop::BoardReset) => SessionOutcome::Good,
        }
    }

    /// Writes the session file.
    pub(crate) fn save(&self) -> Result<(), Stop> {
        Ok(self.file.save(&self.folder)?)
    }

    /// The phone at a place.
    pub(crate) fn phone(&self, place: usize) -> &PhoneRecord {
        &self.file.phones[place]
    }

    /// The phone at a place, to be changed.
    pub(crate) fn phone_mut(&mut self, place: usize) -> &mut PhoneRecord {
        &mut self.file.phones[place]
    }

    /// Keeps a new relation of the clock of the phone at a place.
    pub(crate) fn set_clock(
        &mut self,
        place: usize,
        phone: PhoneName,
        clock: ClockRelation,
        source: &str,
    ) -> Result<(), Stop> {
        self.phone_mut(place).clock = Some(clock);
        let further = (place > 0).then(|| phone.name.clone());
        self.write(|writer, now| writer.clock_model(now, further.as_deref(), &clock, source))?;
        self.report(SessionEvent::ClockKnown {
            place,
            phone,
            clock,
        })
    }
}
