//! What is kept of a session and told to the person: the recording, the session
//! file, the live view, and lines on standard error.

use std::path::PathBuf;

use protocol::{TICK_HZ, Ticks};

use super::Stop;
use super::live::Live;
use crate::context::Context;
use recording::RecordingError;
use recording::finding::Finding;
use recording::finding::Severity;
use recording::session_file::{OtherPhone, SessionFile, SessionOutcome, Twist, Video};
use recording::writer::Writer;
use timebase::ClockModel;

/// The most problems that are kept one by one.
const MAX_PROBLEMS: usize = 1_000;

/// A message this far ahead of all others, in ticks, is not believed by itself: 10 s.
const FAR: u64 = 10 * TICK_HZ as u64;

/// The outputs of a session.
pub struct Journal<'a> {
    context: &'a Context,
    /// What is shown to the person.
    pub(super) live: Live,
    /// The MCAP file, until it is finished or has failed.
    pub(super) writer: Option<Writer>,
    /// The recording's folder.
    pub(super) folder: PathBuf,
    /// What is decided.
    pub file: SessionFile,
    /// Latest board time that was handled.
    pub(super) now: Ticks,
    /// A time far beyond it that one message told.
    ahead: Option<Ticks>,
    odd_told: bool,
    has_problems: bool,
}

impl<'a> Journal<'a> {
    /// A journal into a folder that is there.
    #[must_use]
    pub const fn new(
        context: &'a Context,
        live: Live,
        writer: Writer,
        folder: PathBuf,
        file: SessionFile,
    ) -> Self {
        Self {
            context,
            live,
            writer: Some(writer),
            folder,
            file,
            now: Ticks::ZERO,
            ahead: None,
            odd_told: false,
            has_problems: false,
        }
    }

    /// A message tells a board time. One that is far ahead of all others is believed once
    /// a second message says the same: a single wrong one must not end a recording. That
    /// there was one is told, once.
    pub(super) fn advance(&mut self, at: Ticks) -> Result<(), Stop> {
        let is_far = |from: Ticks| at.0.abs_diff(from.0) > FAR;
        if at > self.now && is_far(self.now) && self.ahead.is_none_or(is_far) {
            self.ahead = Some(at);
            return Ok(());
        }
        let behind = (at < self.now && is_far(self.now)).then_some(at);
        let odd = self.ahead.take().filter(|ahead| is_far(*ahead)).or(behind);
        self.now = self.now.max(at);
        match odd {
            Some(odd) if !std::mem::replace(&mut self.odd_told, true) => {
                let text = format!(
                    "a message of the board has the time {:.3} s, far from all others; it is \
                     recorded as it came, and further ones are not told",
                    odd.as_secs_f64()
                );
                self.problem(Finding::check("time_odd", text))
            }
            _ => Ok(()),
        }
    }

    /// Whether anything went wrong so far.
    #[must_use]
    pub const fn has_problems(&self) -> bool {
        self.has_problems
    }

    /// Writes into the recording, while it is open.
    pub(super) fn write(
        &mut self,
        write: impl FnOnce(&mut Writer, Ticks) -> Result<(), RecordingError>,
    ) -> Result<(), Stop> {
        match &mut self.writer {
            Some(writer) => Ok(write(writer, self.now)?),
            None => Ok(()),
        }
    }

    /// Says something, and keeps it in the recording.
    pub(super) fn tell(&mut self, severity: Severity, kind: &str, text: &str) -> Result<(), Stop> {
        match severity {
            Severity::Good => self.context.say(text),
            Severity::Check => self.context.say(format!("warning: {text}")),
            Severity::Bad => self.context.say(format!("ERROR: {text}")),
        }
        self.write(|writer, now| writer.log(now, severity, kind, text))
    }

    /// As [`Journal::tell`], for what is as it should be.
    pub(super) fn info(&mut self, kind: &str, text: &str) -> Result<(), Stop> {
        self.tell(Severity::Good, kind, text)
    }

    /// Warns, in the live view too; the outcome stays as it is.
    pub(super) fn warn(&mut self, kind: &str, text: &str) -> Result<(), Stop> {
        self.live.gauge.warning(kind, text);
        self.tell(Severity::Check, kind, text)
    }

    /// Something went wrong: says it, and keeps it in the session file too. It
    /// makes the outcome "with loss".
    pub(super) fn problem(&mut self, finding: Finding) -> Result<(), Stop> {
        self.has_problems = true;
        self.live.gauge.warning(&finding.kind, &finding.text);
        let count = self.file.problems.len();
        let mut keep = |kind: &str, text: &str| {
            let problem = Finding::new(finding.severity, kind, text).at(self.now);
            self.file.problems.push(problem);
        };
        if count < MAX_PROBLEMS {
            keep(&finding.kind, &finding.text);
        } else if count == MAX_PROBLEMS {
            keep("more", "further problems are in /session/log only");
        }
        self.tell(finding.severity, &finding.kind, &finding.text)
    }

    /// A problem while closing, where nothing can be done about a failure.
    pub(super) fn last_problem(&mut self, kind: &'static str, text: impl Into<String>) {
        if self.problem(Finding::bad(kind, text)).is_err() {
            self.writer = None;
        }
    }

    /// Tells what was found; anything but information is a problem.
    pub(super) fn tell_all(&mut self, findings: Vec<Finding>) -> Result<(), Stop> {
        for finding in findings {
            if finding.severity == Severity::Good {
                self.info(&finding.kind, &finding.text)?;
            } else {
                self.problem(finding)?;
            }
        }
        Ok(())
    }

    /// How the session ends with this result.
    pub(super) fn outcome_of(&self, result: &Result<(), Stop>) -> SessionOutcome {
        match result {
            Err(Stop::Failed(_)) => SessionOutcome::Failed,
            Err(Stop::Interrupted) => SessionOutcome::Interrupted,
            Ok(()) if self.has_problems() => SessionOutcome::Loss,
            Ok(()) => SessionOutcome::Good,
        }
    }

    /// Writes the session file.
    pub(super) fn save(&self) -> Result<(), Stop> {
        Ok(self.file.save(&self.folder)?)
    }

    /// What is kept of a further phone, by its place in the profile.
    pub(super) fn other_phone(&mut self, place: usize) -> Option<&mut OtherPhone> {
        self.file.phones.get_mut(place.checked_sub(1)?)
    }

    /// The relation of the clock of the phone at a place.
    pub(super) fn clock(&self, place: usize) -> Option<ClockModel> {
        match place.checked_sub(1) {
            None => self.file.clock,
            Some(index) => self.file.phones.get(index)?.clock,
        }
    }

    /// A new relation of the clock of the phone at a place.
    pub(super) fn set_clock(
        &mut self,
        place: usize,
        clock: ClockModel,
        source: &str,
    ) -> Result<(), Stop> {
        let other = self.other_phone(place).map(|phone| {
            phone.clock = Some(clock);
            phone.name.clone()
        });
        if other.is_none() {
            self.file.clock = Some(clock);
        }
        self.write(|writer, now| writer.clock_model(now, other.as_deref(), &clock, source))
    }

    /// The video of the phone at a place, once it has begun.
    pub(super) fn video(&self, place: usize) -> Option<Video> {
        match place.checked_sub(1) {
            None => self.file.video,
            Some(index) => self.file.phones.get(index)?.video,
        }
    }

    /// Keeps that a video of the phone at a place has begun.
    pub(super) fn set_video(&mut self, place: usize, video: Video) {
        match self.other_phone(place) {
            Some(phone) => phone.video = Some(video),
            None => self.file.video = Some(video),
        }
    }

    /// Keeps a twist of the phone at a place.
    pub(super) fn keep_twist(&mut self, place: usize, twist: Twist) {
        match self.other_phone(place) {
            Some(phone) => phone.twists.push(twist),
            None => self.file.twists.push(twist),
        }
    }
}
