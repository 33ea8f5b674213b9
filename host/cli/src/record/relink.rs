//! A lost link: it is waited for, and the session goes on with it, or ends.

use std::time::{Duration, Instant};

use protocol::{TICK_HZ, Ticks};

use super::Stop;
use super::rig::Rig;
use super::watch::Finding;
use crate::outcome::{ExitStatus, Failure};
use board::BoardError;
use board::transport::LinkError;
use recording::writer::Severity;

/// How long a lost link is waited for at most while a session is being closed.
const TIME_CLOSING: Duration = Duration::from_secs(3);

/// Pause between tries to take it up.
const PAUSE: Duration = Duration::from_millis(300);

impl Rig<'_> {
    /// Waits for a lost link and goes on with it.
    pub(super) fn take_up_link(&mut self, error: &LinkError) -> Result<(), Stop> {
        let lost = Instant::now();
        let lost_at = self.now;
        self.problem(Finding::error("link_lost", error.to_string()))?;
        // Nothing will fill the chunk for a while.
        if let Some(writer) = &mut self.writer {
            writer.flush().map_err(Failure::from)?;
        }
        // A port that fell silent but is still there is opened exclusively: by us.
        self.board.hang_up();
        let patience = if self.closing {
            self.link_patience.min(TIME_CLOSING)
        } else {
            self.link_patience
        };
        loop {
            if self.context.interrupt.requested() && !self.closing {
                return Err(Stop::Interrupted);
            }
            let again = self
                .connector
                .connect(Some(&self.board_id))
                .and_then(|link| self.board.reconnect(link));
            match again {
                Ok(()) => break,
                Err(BoardError::OtherVersion { found }) => {
                    return Err(Failure::from(BoardError::OtherVersion { found }).into());
                }
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
            if let Some(writer) = &mut self.writer {
                writer.tick(self.board.now()).map_err(Failure::from)?;
            }
            std::thread::sleep(PAUSE);
        }
        self.last_sign = self.board.now();
        self.file.reconnects += 1;
        if self.board.hello().epoch != self.epoch {
            // What it says of its new run is waiting: before that, its time.
            self.meet_new_run();
            if self.watch.is_none() && !self.closing {
                // Whatever it is asked from here on, it knows nothing of this session.
                self.trigger_started = false;
                return Err(restarted(lost_at).into());
            }
            // Up to the new run's first messages: who asks on is in the new run.
            while let Some(event) = self.board.queued_event() {
                self.take(event)?;
            }
            return Ok(());
        }
        let now = self.axis.recorded(self.board.hello().now);
        if let Some(watch) = &mut self.watch {
            watch.resume(now);
        }
        let away = now.0.saturating_sub(lost_at.0) as f64 / f64::from(TICK_HZ);
        self.tell(
            Severity::Info,
            "link_back",
            &format!("the link is back after {away:.3} s of board time"),
        )
    }
}

/// The board began anew while nothing was recorded that could go on.
pub(super) fn restarted(last: Ticks) -> Failure {
    Failure::new(
        ExitStatus::LinkLost,
        format!(
            "the board was reset {:.3} s after its last one: what was found out about its clock is \
             void, so the session ends here",
            last.as_secs_f64()
        ),
    )
    .next_step("`smartdepthsync info` says why it was reset; then record again")
}
