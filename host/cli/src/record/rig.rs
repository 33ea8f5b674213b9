//! All that is alive in a session, and how it waits ([`Rig::pump`]).
//!
//! Each part has one job: the [link](super::link) to the board, the
//! [phones](super::phones), the [journal](super::journal) of what is kept and told, the
//! [observers](super::observers) of the board's messages, the rounds to disk and depth
//! recorder, and the [operator](super::operator). A function that waits takes the rig; one that does not takes
//! the parts it needs.
//!
//! Whatever a session waits for, it waits by pumping: messages are recorded and
//! watched, the link is taken up again if it breaks, Ctrl-C is noticed.

use std::time::Duration;

use super::Stop;
use super::journal::Journal;
use super::link::BoardLink;
use super::live::Step;
use super::observers::{Observers, take_message};
use super::operator::Operator;
use super::phones::Phones;
use super::resume::restart::{Pending, reset_ends_session};
use super::rounds::Rounds;
use super::track::{self, Tracking};
use crate::context::Context;
use board::Event;
use board::transport::LinkError;
use board::{Board, BoardError};
use protocol::{Pong, Reply, Ticks};
use recording::finding::Severity;
use recording::profile::Profile;

/// A twist is enough when its expected 1-sigma is this part of the gate's: the
/// phase then depends on the profile's constants more than on the twist.
const ENOUGH: f64 = 0.1;

/// How long a session pumps at a time while it waits.
const WAIT: Duration = Duration::from_millis(20);

/// All that is alive in a session.
pub struct Rig<'a> {
    pub(super) context: &'a Context,
    pub(super) profile: &'a Profile,
    /// The link to the board.
    pub link: BoardLink<'a>,
    pub(super) phones: Phones<'a>,
    pub(super) operator: Operator,
    /// What is kept and told.
    pub journal: Journal<'a>,
    /// Who looks at the board's messages.
    pub observers: Observers,
    pub(super) rounds: Rounds,
    /// The phone's clock, if it is followed.
    pub(super) tracking: Option<Tracking>,
    /// The trigger was started by this session.
    pub trigger_started: bool,
    /// The session is being closed: interrupts are no reason to stop any more.
    pub(super) closing: bool,
    /// What is to be done after a reset.
    pub(super) pending: Option<Pending>,
}

impl<'a> Rig<'a> {
    /// Puts the parts together.
    #[must_use]
    pub fn new(
        context: &'a Context,
        profile: &'a Profile,
        link: BoardLink<'a>,
        phones: Phones<'a>,
        operator: Operator,
        mut journal: Journal<'a>,
    ) -> Self {
        journal.now = link.board.hello().now;
        Self {
            context,
            profile,
            link,
            phones,
            operator,
            journal,
            observers: Observers::default(),
            rounds: Rounds::new(),
            tracking: None,
            trigger_started: false,
            closing: false,
            pending: None,
        }
    }

    /// Latest board time that was handled.
    #[must_use]
    pub const fn now(&self) -> Ticks {
        self.journal.now
    }

    /// Takes what the board has sent; waits at most for `wait` if that is nothing.
    ///
    /// # Errors
    ///
    /// The user wants to stop, the link is lost for good, or the disk is full.
    pub fn pump(&mut self, wait: Duration) -> Result<(), Stop> {
        if self.context.interrupt.requested() && !self.closing {
            return Err(Stop::Interrupted);
        }
        if self.observers.watch.is_some() {
            self.link.compare_clocks();
        }
        let mut wait = wait;
        // Bounded, so that prompts stay alive even under full load.
        for _ in 0..2_000 {
            match self.link.next_event(wait) {
                Ok(Some(event)) => self.take(event)?,
                Ok(None) => {
                    // All that had come is taken.
                    self.observers.time(self.journal.now);
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
            tracking.look(&mut self.link, &mut self.journal)?;
        }
        self.listen()?;
        let findings = std::mem::take(&mut self.observers.findings);
        self.journal.tell_all(findings)?;
        self.restore()?;
        let now = self.link.board.now();
        self.journal.write(|writer, _| writer.tick(now))?;
        self.show();
        self.rounds.look(&mut self.journal, self.closing)
    }

    /// Pumps until `done` says so.
    ///
    /// # Errors
    ///
    /// As [`Rig::pump`].
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
    pub(super) fn pump_for(&mut self, ticks: u64) -> Result<(), Stop> {
        let until = self.now().0.saturating_add(ticks);
        self.pump_until(|rig| (rig.now().0 >= until).then_some(()))
    }

    /// Calls the board; takes up the link once if it breaks meanwhile.
    ///
    /// # Errors
    ///
    /// The board refuses or does not answer; or as [`Rig::pump`].
    pub fn call<T>(&mut self, call: impl FnMut(&mut Board) -> board::Result<T>) -> Result<T, Stop> {
        Ok(self.try_call(call)??)
    }

    /// The same, for who can go on without the answer.
    pub(super) fn try_call<T>(
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

    /// Takes what came from the board.
    pub(super) fn take(&mut self, event: Event) -> Result<(), Stop> {
        let now = self.now();
        let Some(writer) = &mut self.journal.writer else {
            return Ok(());
        };
        match event {
            Event::Frame(frame) => writer.frame(now, frame)?,
            Event::Message(message) => {
                let message = self.link.axis.message(message);
                let (link, journal) = (&mut self.link, &mut self.journal);
                take_message(link, &mut self.observers, journal, message)?;
            }
            Event::Lost { stream, count } => {
                self.journal.live.gauge.lost(count);
                self.observers.lost(stream, count);
                let text = format!("{count} {stream} lost on the link");
                writer.log(now, Severity::Check, "lost", &text)?;
            }
            Event::Disordered { stream } => self.observers.disordered(stream),
            Event::Damaged(error) => {
                self.journal.live.gauge.damaged();
                writer.log(now, Severity::Check, "damaged", &error.to_string())?;
            }
            Event::Restarted { .. } => {
                let goes_on = self.observers.watch.is_some() || self.closing;
                self.trigger_started = false;
                self.begin_run()?;
                track::give_up(self)?;
                if !goes_on {
                    return Err(reset_ends_session(now).into());
                }
            }
            Event::OtherVersion { found } => {
                return Err(BoardError::OtherVersion { found }.into());
            }
            Event::Answer(answer) => {
                // Calls take their answers themselves.
                if let Ok(Reply::Ping(Pong { received, .. })) = answer.result {
                    let heard = self.link.board.now();
                    self.link.axis.answered(answer.id, heard, received);
                    let at = self.link.axis.recorded(received);
                    if let Some(tracking) = &mut self.tracking {
                        tracking.answered(&mut self.journal, answer.id, heard, at)?;
                    }
                }
            }
            Event::Expired { id } => {
                self.link.axis.expired(id);
                if let Some(tracking) = &mut self.tracking {
                    tracking.expired(id);
                }
            }
        }
        Ok(())
    }

    /// Sees to it that the board is still understood.
    fn listen(&mut self) -> Result<(), Stop> {
        if self.link.has_become_quiet() {
            let damaged = self.link.board.conversation().damaged_frames();
            let text = format!(
                "no message came from the board for 5 s; {damaged} damaged frames came so far"
            );
            self.journal.tell(Severity::Check, "board_quiet", &text)?;
        }
        if self.link.is_silent() {
            let reason = String::from("no message came for 10 s");
            self.take_up_link(&LinkError::Gone { reason })?;
        }
        Ok(())
    }

    /// Puts the latest state before the person's eyes; never waits for that.
    fn show(&mut self) {
        let file = &self.journal.file;
        let step = if self.closing {
            Step::Closing
        } else if self.observers.gyro.is_some() {
            Step::Twist(file.twists.len() + 1)
        } else if let (Some(_), Some(span)) = (&self.observers.watch, file.recorded) {
            Step::Recording(span.from)
        } else if self.trigger_started {
            Step::Aligning
        } else {
            Step::Preparing
        };
        let length = f64::from(self.profile.phone.twist_s);
        let enough = self.profile.align.max_offset_sigma_us * ENOUGH;
        let live = &mut self.journal.live;
        live.step(step, (length, enough));
        live.gauge.latest.losses.reconnects = file.reconnects;
        live.gauge.know_phones(&file.phones);
        live.show(
            self.journal.now,
            &self.journal.folder,
            file.clock.as_ref(),
            file.alignment.as_ref(),
            self.operator.is_present(),
        );
    }
}
