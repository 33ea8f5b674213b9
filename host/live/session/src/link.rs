//! The link to the board, which may break and come back.

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

/// A link on which no message comes for so long is as good as lost, whatever bytes
/// come: a status comes every second.
const SILENCE: Duration = Duration::from_secs(10);

/// After so long without a message its absence is reported.
const QUIET: Duration = Duration::from_secs(5);

/// Pause between tries to take a lost link up.
const PAUSE: Duration = Duration::from_millis(300);

/// The link to the board.
pub struct BoardLink<'a> {
    /// The board.
    pub board: Board,
    id: String,
    /// Finds the board again.
    connector: &'a mut dyn Connector,
    /// How long a lost link is waited for.
    patience: Duration,
    /// The run that the board is in: another one is a reset.
    epoch: u32,
    /// When the board was heard last, on the link's clock.
    last_sign: Duration,
    /// True if it was reported that no message comes.
    is_quiet: bool,
    scale: Scale,
}

impl<'a> BoardLink<'a> {
    /// A link that is there. A lost one is waited for as long as `patience`.
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

    /// Tells whether the frames of the link are given out too.
    pub(crate) const fn keep_frames(&mut self, keep: bool) {
        self.board.keep_frames(keep);
    }

    /// The board's ID in hex.
    pub(crate) fn id(&self) -> &str {
        &self.id
    }

    /// Takes the next event, within `wait`.
    pub(crate) fn next_event(&mut self, wait: Duration) -> board::Result<Option<Event>> {
        let event = self.board.next_event(wait)?;
        // Only what was understood is a sign of life: no damaged frame is, and not that
        // an answer does not come.
        if let Some(Event::Message(_) | Event::Answer(_) | Event::Restarted { .. }) = event {
            self.last_sign = self.board.now();
            self.is_quiet = false;
        }
        Ok(event)
    }

    /// How long no message has come.
    fn silence(&self) -> Duration {
        self.board.now().saturating_sub(self.last_sign)
    }

    /// How long no message has come, if that is some time; once each time.
    pub(crate) fn has_become_quiet(&mut self) -> Option<Duration> {
        let is_quiet = self.silence() > QUIET;
        let is_new = is_quiet && !std::mem::replace(&mut self.is_quiet, is_quiet);
        is_new.then_some(QUIET)
    }

    /// Board time by the host's clock, where no message tells it any more.
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

    /// The error of a link on which nothing has come for so long that it is as good as lost.
    pub(crate) fn silent(&self) -> Option<LinkError> {
        (self.silence() > SILENCE).then(|| LinkError::Gone {
            reason: format!("no message came for {} s", SILENCE.as_secs()),
        })
    }

    /// Tells whether the board is in another run than at the beginning of the session.
    pub(crate) fn is_other_run(&self) -> bool {
        self.board.hello().epoch != self.epoch
    }

    /// The IMU has another scale now.
    pub(crate) const fn set_scale(&mut self, scale: Scale) {
        self.scale = scale;
    }

    /// Converts a sample into SI units.
    pub(crate) fn in_si(&self, raw: &ImuSample) -> Sample {
        self.scale.apply(raw)
    }

    /// How long a lost link is waited for, while it is not closed.
    pub(crate) const fn patience(&self) -> Duration {
        self.patience
    }

    /// Opens the link again, which was lost by `error`, within `patience`.
    pub(crate) fn reopen(
        &mut self,
        error: &LinkError,
        patience: Duration,
        clock: &dyn Clock,
        is_interrupted: &dyn Fn() -> bool,
        log: &mut Log<'_>,
    ) -> Result<(), Stop> {
        let lost = clock.now();
        // A port that fell silent but is still there is opened exclusively: by us.
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
                    // The port that was tried is held no longer than the try.
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
