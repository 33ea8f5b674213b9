//! The session: all that is alive in it, and how it waits ([`Session::pump`]).
//!
//! Each part has one job: the [link](crate::link) to the board, the
//! [phones](crate::phones), the [log](crate::log), the [monitors](crate::link::monitors) of the
//! board's messages, the housekeeping, and the person. A function that waits takes the
//! session; one that does not takes the parts it needs.
//!
//! Whatever a session waits for, it waits by pumping: messages are recorded and
//! watched, the link is taken up again if it breaks, an interrupt is noticed.

use std::sync::Arc;
use std::time::Duration;

use board::transport::LinkError;
use board::{Board, BoardError, Event, StreamCounts};
use phone::task::Pending;
use protocol::{DeviceToHost, Pong, Reply, TICK_HZ, Ticks};
use recording::profile::Profile;

use crate::devices::{Choice, Clock, DepthRecorder, Operator, Phone};
use crate::error::{SessionError, Stop};
use crate::event::{Phase, Prompt, SessionEvent, Step};
use crate::housekeeping::Housekeeping;
use crate::link::BoardLink;
use crate::link::monitors::{Monitors, take_message};
use crate::log::Log;
use crate::phones::{Answers, Phones, call_off};
use crate::tracking::Tracking;

/// How long a session pumps at a time while it waits.
const WAIT: Duration = Duration::from_millis(20);

/// How long a lost link is waited for at most while a session is being closed.
const PATIENCE_CLOSING: Duration = Duration::from_secs(3);

/// All that is alive in a session.
pub struct Session<'a> {
    pub(crate) profile: &'a Profile,
    pub(crate) clock: &'a dyn Clock,
    pub(crate) operator: &'a mut dyn Operator,
    /// The link to the board.
    pub link: BoardLink<'a>,
    pub(crate) phones: Phones<'a>,
    /// The outputs.
    pub log: Log<'a>,
    /// The monitors of the board's messages.
    pub monitors: Monitors,
    pub(crate) housekeeping: Housekeeping<'a>,
    /// The phone's clock, if it is followed.
    pub(crate) tracking: Option<Tracking>,
    /// The trigger was started by this session.
    pub trigger_started: bool,
    phase: Phase,
    /// The session is being closed: interrupts are no reason to stop any more.
    pub(crate) closing: bool,
    /// The board was reset: it has nothing more to say to this session.
    pub(crate) was_reset: bool,
    /// The counts of the streams when it was.
    pub(crate) counts_at_reset: Option<StreamCounts>,
    /// The last frame, which is of the new run if the next event is a reset.
    frame: Option<Vec<u8>>,
}

impl<'a> Session<'a> {
    /// Puts the parts together.
    #[must_use]
    pub fn new(
        profile: &'a Profile,
        clock: &'a dyn Clock,
        operator: &'a mut dyn Operator,
        link: BoardLink<'a>,
        phones: Phones<'a>,
        mut log: Log<'a>,
        recorder: &'a mut dyn DepthRecorder,
    ) -> Self {
        log.now = link.board.hello().now;
        Self {
            profile,
            clock,
            operator,
            link,
            phones,
            log,
            monitors: Monitors::default(),
            housekeeping: Housekeeping::new(recorder, clock.now()),
            tracking: None,
            trigger_started: false,
            phase: Phase::Connecting,
            closing: false,
            was_reset: false,
            counts_at_reset: None,
            frame: None,
        }
    }

    /// Latest board time that was handled.
    #[must_use]
    pub const fn now(&self) -> Ticks {
        self.log.now
    }

    /// The part of the session that runs.
    #[must_use]
    pub const fn phase(&self) -> Phase {
        self.phase
    }

    /// Another part begins.
    pub(crate) fn enter(&mut self, phase: Phase) {
        self.phase = phase;
        self.log.tell(SessionEvent::Phase { phase });
    }

    /// Takes what the board has sent; waits at most for `wait` if that is nothing.
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
                Ok(Some(event)) => self.take(event)?,
                Ok(None) => {
                    // All that had come is taken.
                    self.monitors.time(self.log.now);
                    break;
                }
                Err(BoardError::Link(error)) => {
                    self.take_up_link(&error)?;
                    break;
                }
                Err(other) => return Err(other.into()),
            }
            wait = Duration::ZERO;
        }
        if let Some(tracking) = &mut self.tracking {
            tracking.look(&mut self.link, &mut self.log)?;
        }
        self.listen()?;
        let findings = std::mem::take(&mut self.monitors.findings);
        self.log.report_all(findings)?;
        let now = self.link.board.now();
        self.log.write(|writer, _| writer.tick(now))?;
        self.housekeeping
            .look(self.clock, &mut self.log, self.closing)
    }

    /// Pumps until `done` gives something.
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

    /// Pumps for so long in board time.
    pub(crate) fn pump_for(&mut self, ticks: u64) -> Result<(), Stop> {
        let until = self.now().0.saturating_add(ticks);
        self.pump_until(|session| (session.now().0 >= until).then_some(()))
    }

    /// Calls the board; takes up the link once if it breaks meanwhile.
    ///
    /// # Errors
    ///
    /// The board refuses or does not answer; or as [`Session::pump`].
    pub fn call<T>(&mut self, call: impl FnMut(&mut Board) -> board::Result<T>) -> Result<T, Stop> {
        Ok(self.try_call(call)??)
    }

    /// Calls the board as [`Session::call`], for who can go on without the answer.
    pub(crate) fn try_call<T>(
        &mut self,
        mut call: impl FnMut(&mut Board) -> board::Result<T>,
    ) -> Result<board::Result<T>, Stop> {
        match call(&mut self.link.board) {
            Err(BoardError::Link(error)) => {
                self.take_up_link(&error)?;
                Ok(call(&mut self.link.board))
            }
            other => Ok(other),
        }
    }

    /// Asks phones at the same time and pumps until all have answered. Their answers are
    /// in the result, by their places.
    pub(crate) fn ask_phones<T>(
        &mut self,
        places: impl IntoIterator<Item = usize>,
        ask: impl Fn(usize, &dyn Phone) -> Pending<T>,
        mut meanwhile: impl FnMut(&mut Self),
    ) -> Result<Answers<T>, Stop> {
        self.phones.call_off_checks();
        let asked = |place| (place, ask(place, self.phones.device(place)));
        let mut waiting: Vec<_> = places.into_iter().map(asked).collect();
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
            call_off(self.clock, waiting.into_iter().map(|(_, request)| request));
        }
        answers.sort_by_key(|&(place, _)| place);
        result.map(|()| answers)
    }

    /// Asks the person and pumps until there is an answer.
    pub(crate) fn ask(&mut self, prompt: Prompt) -> Result<Choice, Stop> {
        if !self.operator.is_present() {
            return Ok(Choice::Continue);
        }
        self.log.tell(SessionEvent::Prompt { prompt });
        self.pump_until(|session| session.operator.answer())
    }

    /// Runs a step; if it fails in a way that may pass, and somebody is there, it
    /// can be repeated or left out.
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
            self.log.tell(SessionEvent::StepFailed {
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

    /// Takes what came from the board.
    fn take(&mut self, event: Event) -> Result<(), Stop> {
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
                take_message(&self.link, &mut self.monitors, &mut self.log, message)?;
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

    /// Ends what the board was asked for: after a reset it knows nothing of this session, and
    /// its clock is another.
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
        if self.log.file.recorded.is_none() && !self.closing {
            return Err(SessionError::BoardReset { at: last, cause }.into());
        }
        self.log.report(SessionEvent::BoardReset { cause, last })?;
        match self.closing {
            true => Ok(()),
            false => Err(Stop::BoardReset),
        }
    }

    /// Waits for a lost link and goes on with it, if the board lives.
    fn take_up_link(&mut self, error: &LinkError) -> Result<(), Stop> {
        let lost_at = self.now();
        let patience = match self.closing {
            true => self.link.patience().min(PATIENCE_CLOSING),
            false => self.link.patience(),
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
        self.log.file.reconnects += 1;
        if self.link.is_other_run() {
            // What came of the former run is taken first, up to the reset.
            while let Some(event) = self.link.board.queued_event() {
                self.take(event)?;
            }
            return match self.was_reset {
                true => Ok(()),
                false => self.board_was_reset(lost_at),
            };
        }
        let now = self.link.board.hello().now;
        self.monitors.resume(now);
        let away_s = now.0.saturating_sub(lost_at.0) as f64 / f64::from(TICK_HZ);
        self.log.report(SessionEvent::LinkBack { away_s })
    }

    /// Sees to it that the board is still understood.
    fn listen(&mut self) -> Result<(), Stop> {
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
        match self.link.silent() {
            Some(error) => self.take_up_link(&error),
            None => Ok(()),
        }
    }
}
