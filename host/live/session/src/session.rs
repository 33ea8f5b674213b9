//! The live parts of a session, and how it waits ([`Session::pump`]).
//!
//! Each part has one job: the [link](crate::link) to the board, the
//! [phones](crate::phones), the [log](crate::log), the [monitors](crate::link::monitors) of the
//! board's messages, the housekeeping, and the operator. A function that waits takes the
//! session; one that does not takes the parts it needs.
//!
//! A session always waits by pumping: meanwhile messages are recorded and watched, a broken
//! link is reopened, and interrupts are noticed.

use std::sync::Arc;
use std::time::Duration;

use board::transport::LinkError;
use board::{Board, BoardError, Event, StreamCounts};
use clock::ClockRelation;
use phone::task::Pending;
use protocol::{DeviceToHost, Pong, Reply, TICK_HZ, Ticks};
use recording::RecordingError;
use recording::profile::Profile;
use recording::session_file::{SessionFile, SessionOutcome};

use crate::devices::{Choice, Clock, Operator, Phone};
use crate::error::{SessionError, Stop};
use crate::event::{Phase, PhoneName, Prompt, SessionEvent, Step};
use crate::housekeeping::Housekeeping;
use crate::link::BoardLink;
use crate::link::monitors::{Monitors, handle_message};
use crate::log::Log;
use crate::phones::{Answers, Phones, cancel};
use crate::tracking::Tracking;

/// Longest pump while the session waits for a condition.
const WAIT: Duration = Duration::from_millis(20);

/// Longest wait for a lost link while the session is being closed.
const PATIENCE_CLOSING: Duration = Duration::from_secs(3);

/// The live parts of a session.
pub struct Session<'a> {
    pub(crate) profile: &'a Profile,
    pub(crate) clock: &'a dyn Clock,
    pub(crate) operator: &'a mut dyn Operator,
    /// The link to the board.
    pub link: BoardLink<'a>,
    pub(crate) phones: Phones<'a>,
    /// The outputs.
    pub log: Log<'a>,
    /// Content of `session.json`: everything decided and measured so far.
    pub file: SessionFile,
    /// The monitors of the board's messages.
    pub monitors: Monitors,
    pub(crate) housekeeping: Housekeeping<'a>,
    /// The phone's clock, if it is followed.
    pub(crate) tracking: Option<Tracking>,
    /// True if this session has started the trigger, and not stopped it.
    pub trigger_started: bool,
    pub(crate) phase: Phase,
    /// True while the session is being closed, when interrupts do not stop it.
    pub(crate) closing: bool,
    /// The counts of the streams at a reset of the board, which ends its part in the session.
    pub(crate) counts_at_reset: Option<StreamCounts>,
    /// True if the board was reset.
    pub(crate) was_reset: bool,
    /// The last frame, which belongs to the new run if the next event is a reset.
    pub(crate) frame: Option<Vec<u8>>,
}

impl<'a> Session<'a> {
    /// Returns the latest board time that was handled.
    #[must_use]
    pub const fn now(&self) -> Ticks {
        self.log.now
    }

    /// Returns the part of the session that runs.
    #[must_use]
    pub const fn phase(&self) -> Phase {
        self.phase
    }

    /// Begins another part.
    pub(crate) fn enter(&mut self, phase: Phase) {
        self.phase = phase;
        self.log.publish(SessionEvent::Phase { phase });
    }

    /// Writes `session.json`.
    pub(crate) fn save(&mut self) -> Result<(), RecordingError> {
        self.log.problems().clone_into(&mut self.file.problems);
        self.file.save(&self.log.folder)
    }

    /// Returns the outcome of a session with this result.
    pub(crate) fn outcome_of(&self, result: &Result<(), Stop>) -> SessionOutcome {
        match result {
            Err(Stop::Failed(_)) => SessionOutcome::Failed,
            Err(Stop::Interrupted) => SessionOutcome::Interrupted,
            Ok(()) | Err(Stop::BoardReset) if self.log.problems().is_empty() => {
                SessionOutcome::Good
            }
            Ok(()) | Err(Stop::BoardReset) => SessionOutcome::Loss,
        }
    }

    /// Sets the relation of the clock of the phone at index `place`, found from `source`.
    pub(crate) fn set_clock(
        &mut self,
        place: usize,
        phone: PhoneName,
        clock: ClockRelation,
        source: &str,
    ) -> Result<(), Stop> {
        self.file.phones[place].clock = Some(clock);
        let further = (place > 0).then(|| phone.name.clone());
        self.log
            .write(|writer, now| writer.clock_model(now, further.as_deref(), &clock, source))?;
        self.log.report(SessionEvent::ClockKnown {
            place,
            phone,
            clock,
        })
    }

    /// Handles pending events of the board, waiting up to `wait` if there are none.
    ///
    /// # Errors
    ///
    /// The user wants to stop, the link is lost for good, the board was reset, or the disk
    /// is full.
    pub fn pump(&mut self, wait: Duration) -> Result<(), Stop> {
        if self.operator.interrupted() && !self.closing {
            return Err(Stop::Interrupted);
        }
        let mut wait = wait;
        // Bounded, so that prompts stay alive even under full load.
        for _ in 0..2_000 {
            match self.link.next_event(wait) {
                Ok(Some(event)) => self.handle(event)?,
                Ok(None) => {
                    // Everything that had arrived is handled.
                    self.monitors.time(self.log.now);
                    break;
                }
                Err(BoardError::Link(error)) => {
                    self.reopen_link(&error)?;
                    break;
                }
                Err(other) => return Err(other.into()),
            }
            wait = Duration::ZERO;
        }
        if let Some(tracking) = &mut self.tracking {
            tracking.look(&mut self.link, &self.file, &mut self.log)?;
        }
        self.check_silence()?;
        let findings = std::mem::take(&mut self.monitors.findings);
        self.log.report_all(findings)?;
        let now = self.link.board.now();
        self.log.write(|writer, _| writer.tick(now))?;
        self.housekeeping
            .look(self.clock, &mut self.log, self.closing)
    }

    /// Pumps until `done` returns a value.
    ///
    /// # Errors
    ///
    /// As [`Session::pump`].
    pub fn pump_until<T>(
        &mut self,
        mut done: impl FnMut(&mut Self) -> Option<T>,
    ) -> Result<T, Stop> {
        loop {
            if let Some(result) = done(self) {
                return Ok(result);
            }
            self.pump(WAIT)?;
        }
    }

    /// Pumps for a number of ticks of board time.
    pub(crate) fn pump_for(&mut self, ticks: u64) -> Result<(), Stop> {
        let until = self.now().0.saturating_add(ticks);
        self.pump_until(|session| (session.now().0 >= until).then_some(()))
    }

    /// Calls the board, and once more after reopening the link if it breaks meanwhile.
    ///
    /// # Errors
    ///
    /// The board refuses or does not answer; or as [`Session::pump`].
    pub fn call<T>(&mut self, call: impl FnMut(&mut Board) -> board::Result<T>) -> Result<T, Stop> {
        Ok(self.try_call(call)??)
    }

    /// Calls the board as [`Session::call`] does, and returns a refusal or a missing answer as a
    /// value.
    pub(crate) fn try_call<T>(
        &mut self,
        mut call: impl FnMut(&mut Board) -> board::Result<T>,
    ) -> Result<board::Result<T>, Stop> {
        match call(&mut self.link.board) {
            Err(BoardError::Link(error)) => {
                self.reopen_link(&error)?;
                Ok(call(&mut self.link.board))
            }
            other => Ok(other),
        }
    }

    /// Sends a request to several phones at the same time and pumps until all have answered.
    /// Returns the answers in the order of the phones' indices.
    pub(crate) fn ask_phones<T>(
        &mut self,
        places: impl IntoIterator<Item = usize>,
        ask: impl Fn(usize, &dyn Phone) -> Pending<T>,
        mut meanwhile: impl FnMut(&mut Self),
    ) -> Result<Answers<T>, Stop> {
        self.phones.cancel_checks();
        let request = |place| (place, ask(place, self.phones.device(place)));
        let mut waiting: Vec<_> = places.into_iter().map(request).collect();
        let mut answers = Answers::new();
        let result = self.pump_until(|session| {
            meanwhile(session);
            waiting.retain(|(place, request)| match request.answer() {
                Some(answer) => {
                    answers.push((*place, answer));
                    false
                }
                None => true,
            });
            waiting.is_empty().then_some(())
        });
        if result.is_err() {
            cancel(self.clock, waiting.into_iter().map(|(_, request)| request));
        }
        answers.sort_by_key(|&(place, _)| place);
        result.map(|()| answers)
    }

    /// Asks the operator and pumps until there is an answer.
    pub(crate) fn ask(&mut self, prompt: Prompt) -> Result<Choice, Stop> {
        if !self.operator.is_present() {
            return Ok(Choice::Continue);
        }
        self.log.publish(SessionEvent::Prompt { prompt });
        self.pump_until(|session| session.operator.answer())
    }

    /// Runs a step. If it fails in a way that may pass, a present operator can repeat or skip
    /// it.
    pub(crate) fn step(
        &mut self,
        step: Step,
        mut run: impl FnMut(&mut Self) -> Result<(), Stop>,
    ) -> Result<(), Stop> {
        loop {
            let error = match run(self) {
                Err(Stop::Failed(error)) if error.is_repeatable() => error,
                other => return other,
            };
            if !self.operator.is_present() {
                return Err(error.into());
            }
            self.log.publish(SessionEvent::StepFailed {
                step,
                error: Arc::new(error),
            });
            let can_skip = true;
            match self.ask(Prompt::Repeat { step, can_skip })? {
                Choice::Continue | Choice::Repeat => {}
                Choice::Skip => return Ok(()),
                Choice::Quit => return Err(Stop::Interrupted),
            }
        }
    }

    /// Handles one event of the board.
    fn handle(&mut self, event: Event) -> Result<(), Stop> {
        let now = self.now();
        if self.was_reset || self.log.writer.is_none() {
            return Ok(());
        }
        if !matches!(event, Event::Restarted { .. })
            && let Some(frame) = self.frame.take()
        {
            self.log.write(|writer, at| writer.frame(at, frame))?;
        }
        match event {
            Event::Frame(frame) => self.frame = Some(frame),
            Event::Message(message) => {
                let log = &mut self.log;
                handle_message(&self.link, &mut self.monitors, &self.file, log, message)?;
            }
            Event::Lost { stream, count } => {
                self.monitors.lost(stream, count);
                self.log.report(SessionEvent::Lost {
                    stream: stream.to_string(),
                    count,
                })?;
            }
            Event::Disordered { stream } => self.monitors.disordered(stream),
            Event::Damaged(error) => self.log.report(SessionEvent::Damaged {
                reason: error.to_string(),
            })?,
            Event::Restarted { counts, .. } => {
                self.counts_at_reset = Some(counts);
                return self.board_was_reset(now);
            }
            Event::OtherVersion { found } => {
                return Err(BoardError::OtherVersion { found }.into());
            }
            Event::Answer(answer) => {
                // Calls take their answers themselves.
                if let Ok(Reply::Ping(Pong { received, .. })) = answer.result
                    && let Some(tracking) = &mut self.tracking
                {
                    let heard = self.link.board.now();
                    tracking.answered(&mut self.log, answer.id, heard, received)?;
                }
            }
            Event::Expired { id } => {
                if let Some(tracking) = &mut self.tracking {
                    tracking.expired(id);
                }
            }
        }
        Ok(())
    }

    /// Ends the board's part in the session: a reset has ended everything that it was asked
    /// for, and restarted its clock.
    fn board_was_reset(&mut self, last: Ticks) -> Result<(), Stop> {
        self.was_reset = true;
        self.trigger_started = false;
        self.tracking = None;
        self.frame = None;
        let mut cause = self.link.board.hello().reset_cause;
        while let Some(event) = self.link.board.queued_event() {
            if let Event::Message(DeviceToHost::Hello(hello)) = event {
                cause = hello.reset_cause;
            }
        }
        if self.file.recorded.is_none() && !self.closing {
            return Err(SessionError::BoardReset { at: last, cause }.into());
        }
        self.log.report(SessionEvent::BoardReset { cause, last })?;
        if self.closing {
            Ok(())
        } else {
            Err(Stop::BoardReset)
        }
    }

    /// Waits for a lost link to return, and continues if the board was not reset meanwhile.
    fn reopen_link(&mut self, error: &LinkError) -> Result<(), Stop> {
        let lost_at = self.now();
        let patience = if self.closing {
            self.link.patience().min(PATIENCE_CLOSING)
        } else {
            self.link.patience()
        };
        self.log.report(SessionEvent::LinkLost {
            reason: error.to_string(),
            patience_s: Some(patience.as_secs()),
        })?;
        // Nothing will fill the chunk for a while.
        self.log.write(|writer, _| writer.flush())?;
        // While closing, interrupts are no reason to stop.
        let is_interrupted = || self.operator.interrupted() && !self.closing;
        self.link
            .reopen(error, patience, self.clock, &is_interrupted, &mut self.log)?;
        self.file.reconnects += 1;
        if self.link.is_other_run() {
            // The messages of the former run come first, up to the reset.
            while let Some(event) = self.link.board.queued_event() {
                self.handle(event)?;
            }
            return if self.was_reset {
                Ok(())
            } else {
                self.board_was_reset(lost_at)
            };
        }
        let now = self.link.board.hello().now;
        self.monitors.resume(now);
        let away_s = now.0.saturating_sub(lost_at.0) as f64 / f64::from(TICK_HZ);
        self.log.report(SessionEvent::LinkBack { away_s })
    }

    /// Reports a board that has become quiet, and reopens a link that has been silent for too
    /// long.
    fn check_silence(&mut self) -> Result<(), Stop> {
        if self.was_reset {
            return Ok(());
        }
        if let Some(quiet) = self.link.has_become_quiet() {
            let damaged = self.link.board.conversation().damaged_frames();
            self.log.report(SessionEvent::BoardQuiet {
                seconds: quiet.as_secs(),
                damaged,
            })?;
        }
        match self.link.silence_error() {
            Some(error) => self.reopen_link(&error),
            None => Ok(()),
        }
    }
}
