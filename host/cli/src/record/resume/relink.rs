//! A lost link: it is waited for, and the session goes on with it, or ends.

use std::time::{Duration, Instant};

use super::restart::reset_ends_session;
use crate::context::Interrupt;
use crate::outcome::{ExitStatus, Failure};
use crate::record::Stop;
use crate::record::journal::Journal;
use crate::record::link::BoardLink;
use crate::record::rig::Rig;
use board::BoardError;
use board::transport::LinkError;
use protocol::TICK_HZ;
use recording::finding::Finding;

/// How long a lost link is waited for at most while a session is being closed.
const TIME_CLOSING: Duration = Duration::from_secs(3);

/// Pause between tries to take it up.
const PAUSE: Duration = Duration::from_millis(300);

impl Rig<'_> {
    /// Waits for a lost link and goes on with it.
    pub(in crate::record) fn take_up_link(&mut self, error: &LinkError) -> Result<(), Stop> {
        let lost_at = self.now();
        let problem = Finding::bad("link_lost", error.to_string());
        self.journal.problem(problem)?;
        // Nothing will fill the chunk for a while.
        self.journal.write(|writer, _| writer.flush())?;
        // While closing, interrupts are no reason to stop.
        let (interrupt, patience) = if self.closing {
            (None, self.link.patience.min(TIME_CLOSING))
        } else {
            (Some(&self.context.interrupt), self.link.patience)
        };
        self.link
            .reopen(error, patience, interrupt, &mut self.journal)?;
        self.journal.file.reconnects += 1;
        if self.link.board.hello().epoch != self.link.epoch {
            // What it says of its new run is waiting: before that, its time.
            self.link.meet_new_run();
            if self.observers.watch.is_none() && !self.closing {
                // Whatever it is asked from here on, it knows nothing of this session.
                self.trigger_started = false;
                return Err(reset_ends_session(lost_at).into());
            }
            // Up to the new run's first messages: who asks on is in the new run.
            while let Some(event) = self.link.board.queued_event() {
                self.take(event)?;
            }
            return Ok(());
        }
        let now = self.link.axis.recorded(self.link.board.hello().now);
        self.observers.resume(now);
        let away = now.0.saturating_sub(lost_at.0) as f64 / f64::from(TICK_HZ);
        self.journal.info(
            "link_back",
            &format!("the link is back after {away:.3} s of board time"),
        )
    }
}

impl BoardLink<'_> {
    /// Opens the link again, which was lost by `error`.
    fn reopen(
        &mut self,
        error: &LinkError,
        patience: Duration,
        interrupt: Option<&Interrupt>,
        journal: &mut Journal<'_>,
    ) -> Result<(), Stop> {
        let lost = Instant::now();
        // A port that fell silent but is still there is opened exclusively: by us.
        self.board.hang_up();
        loop {
            if interrupt.is_some_and(Interrupt::requested) {
                return Err(Stop::Interrupted);
            }
            let again = self
                .connector
                .connect(Some(&self.id))
                .and_then(|link| self.board.reconnect(link));
            match again {
                Ok(()) => break,
                Err(error @ BoardError::OtherVersion { .. }) => return Err(error.into()),
                Err(error) => {
                    tracing::debug!("the link is still away: {error}");
                    // The port that was tried is held no longer than the try.
                    self.board.hang_up();
                }
            }
            if lost.elapsed() > patience {
                return Err(Failure::new(
                    ExitStatus::LinkLost,
                    format!(
                        "the link to the board did not come back within {} s ({error})",
                        patience.as_secs()
                    ),
                )
                .next_step("check the USB cable; what was recorded before is kept")
                .into());
            }
            let now = self.board.now();
            journal.write(|writer, _| writer.tick(now))?;
            std::thread::sleep(PAUSE);
        }
        self.last_sign = self.board.now();
        Ok(())
    }
}
