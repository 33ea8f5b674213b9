//! The link to the board, which may be lost and return.

pub mod monitors;
pub mod watch;

use std::time::Duration;

use board::imu::{Sample, Scale};
use board::transport::LinkError;
use board::{Board, BoardError, Event};
use protocol::{ImuSample, TICK_HZ, Ticks};

use crate::devices::{Clock, Connector};
use crate::error::{SessionError, Stop};
use crate::log::Log;

/// Silence after which the link counts as lost, whatever bytes arrive: the board sends a status
/// every second.
const SILENCE: Duration = Duration::from_secs(10);

/// Silence after which it is reported.
const QUIET: Duration = Duration::from_secs(5);

/// Pause between attempts to reopen a lost link.
const PAUSE: Duration = Duration::from_millis(300);

/// The link to the board.
pub struct BoardLink<'a> {
    /// The board.
    pub board: Board,
    id: String,
    /// Opens the link again.
    connector: &'a mut dyn Connector,
    /// Longest wait for a lost link.
    patience: Duration,
    /// Number of the board's run at the beginning; another one means that it was reset.
    epoch: u32,
    /// Time of the last message, on the link's clock.
    last_sign: Duration,
    /// True if the silence was reported.
    is_quiet: bool,
    scale: Scale,
}

impl<'a> BoardLink<'a> {
    /// Takes over an open link. If it is lost, `patience` is the longest wait for its return.
    #[must_use]
    pub fn new(
        board: Board,
        scale: Scale,
        connector: &'a mut dyn Connector,
        patience: Duration,
    ) -> Self {
        Self {
            id: protocol::usb::serial_number(&board.hello().board_id).to_string(),
            connector,
            patience,
            epoch: board.hello().epoch,
            last_sign: board.now(),
            is_quiet: false,
            board,
            scale,
        }
    }

    /// Sets whether raw frames are returned among the events.
    pub(crate) const fn keep_frames(&mut self, keep: bool) {
        self.board.keep_frames(keep);
    }

    /// Returns the board's ID in hex.
    pub(crate) fn id(&self) -> &str {
        &self.id
    }

    /// Returns the next event, waiting up to `wait` for it.
    pub(crate) fn next_event(&mut self, wait: Duration) -> board::Result<Option<Event>> {
        let event = self.board.next_event(wait)?;
        // Damaged frames and expired commands are not signs of life.
        if let Some(Event::Message(_) | Event::Answer(_) | Event::Restarted { .. }) = event {
            self.last_sign = self.board.now();
            self.is_quiet = false;
        }
        Ok(event)
    }

    /// Returns the time since the last message.
    fn silence(&self) -> Duration {
        self.board.now().saturating_sub(self.last_sign)
    }

    /// Returns the length of a silence that is long enough to report, once per silence.
    pub(crate) fn has_become_quiet(&mut self) -> Option<Duration> {
        let is_quiet = self.silence() > QUIET;
        let is_new = is_quiet && !std::mem::replace(&mut self.is_quiet, is_quiet);
        is_new.then_some(QUIET)
    }

    /// Returns the board time, extended by the host's clock while the board is silent.
    pub(crate) fn overdue(&self, latest: Ticks) -> Ticks {
        let silence = self.silence();
        let beyond = if silence > QUIET {
            silence
        } else {
            Duration::ZERO
        };
        let ticks = beyond.as_micros() * u128::from(TICK_HZ / 1_000_000);
        Ticks(
            latest
                .0
                .saturating_add(u64::try_from(ticks).unwrap_or(u64::MAX)),
        )
    }

    /// Returns an error if the silence is so long that the link counts as lost.
    pub(crate) fn silence_error(&self) -> Option<LinkError> {
        (self.silence() > SILENCE).then(|| LinkError::Gone {
            reason: format!("no message came for {} s", SILENCE.as_secs()),
        })
    }

    /// Returns true if the board was reset since the beginning of the session.
    pub(crate) fn is_other_run(&self) -> bool {
        self.board.hello().epoch != self.epoch
    }

    /// Sets the scale of the IMU.
    pub(crate) const fn set_scale(&mut self, scale: Scale) {
        self.scale = scale;
    }

    /// Converts a sample into SI units.
    pub(crate) fn in_si(&self, raw: &ImuSample) -> Sample {
        self.scale.apply(raw)
    }

    /// Returns the longest wait for a lost link while the session is not being closed.
    pub(crate) const fn patience(&self) -> Duration {
        self.patience
    }

    /// Reopens a link that was lost by `error`, trying for up to `patience`.
    pub(crate) fn reopen(
        &mut self,
        error: &LinkError,
        patience: Duration,
        clock: &dyn Clock,
        is_interrupted: &dyn Fn() -> bool,
        log: &mut Log<'_>,
    ) -> Result<(), Stop> {
        let lost = clock.now();
        // A silent port that still exists is open exclusively, so it must be closed first.
        self.board.hang_up();
        loop {
            if is_interrupted() {
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
                    // Closes the port that was tried.
                    self.board.hang_up();
                }
            }
            if clock.now().saturating_sub(lost) > patience {
                return Err(SessionError::LinkLost {
                    waited: patience,
                    error: error.clone(),
                }
                .into());
            }
            let now = self.board.now();
            log.write(|writer, _| writer.tick(now))?;
            clock.wait(PAUSE);
        }
        self.last_sign = self.board.now();
        Ok(())
    }
}
