//! The link to the board, which may break, and the scale of its IMU, which may change
//! when the board is reset.

use std::time::Duration;

use protocol::{ImuFlags, ImuSample, TICK_HZ, Ticks};

use super::Connector;
use board::Board;
use board::Event;
use board::imu::{Sample, Scale};
use timebase::runs::{Axis, Pair};

/// A link on which no message comes for so long is as good as lost, whatever bytes
/// come: a status comes every second.
const SILENCE: Duration = Duration::from_secs(10);

/// After so long without a message its absence is told.
const QUIET: Duration = Duration::from_secs(5);

/// The link to the board.
pub struct BoardLink<'a> {
    /// The board.
    pub board: Board,
    /// Its ID in hex.
    pub(super) id: String,
    /// Finds the board again.
    pub(super) connector: &'a mut dyn Connector,
    /// How long a lost link is waited for, in real time.
    pub(super) patience: Duration,
    /// The run that the board is in: another one is a reset.
    pub(super) epoch: u32,
    /// Its runs on one axis of time: all times outside of calls to the board are
    /// on it.
    pub(super) axis: Axis,
    /// Both clocks when a new run was met, until it begins on the axis.
    pub(super) met: Option<Pair>,
    /// When the board was heard last, on the link's clock.
    pub(super) last_sign: Duration,
    /// That no message comes has been told.
    quiet_told: bool,
    scale: Scale,
    next_scale: Option<NextScale>,
}

/// Another scale that holds from the IMU's next set-up on.
#[derive(Clone, Copy, Debug)]
struct NextScale {
    scale: Scale,
    /// By this recorded time it was set up, whether its first sample came or not.
    latest: Ticks,
}

impl<'a> BoardLink<'a> {
    /// A link that is there. A lost one is waited for as long as `patience`.
    #[must_use]
    pub fn new(
        mut board: Board,
        scale: Scale,
        connector: &'a mut dyn Connector,
        patience: Duration,
    ) -> Self {
        board.keep_frames(true);
        Self {
            id: protocol::usb::serial_number(&board.hello().board_id).to_string(),
            connector,
            patience,
            epoch: board.hello().epoch,
            axis: Axis::default(),
            met: None,
            last_sign: board.now(),
            quiet_told: false,
            board,
            scale,
            next_scale: None,
        }
    }

    /// What comes next, within `wait`.
    pub(super) fn next_event(&mut self, wait: Duration) -> board::Result<Option<Event>> {
        let event = self.board.next_event(wait)?;
        // Only what was understood is a sign of life: no damaged frame is, and not that
        // an answer does not come.
        if let Some(Event::Message(_) | Event::Answer(_) | Event::Restarted { .. }) = event {
            self.last_sign = self.board.now();
            self.quiet_told = false;
        }
        Ok(event)
    }

    /// How long no message has come.
    fn silence(&self) -> Duration {
        self.board.now().saturating_sub(self.last_sign)
    }

    /// Whether no message has come for some time; true once each time.
    pub(super) fn has_become_quiet(&mut self) -> bool {
        let is_quiet = self.silence() > QUIET;
        is_quiet && !std::mem::replace(&mut self.quiet_told, is_quiet)
    }

    /// Board time as the host's clock has it, where no message tells it any more.
    pub(super) fn overdue(&self, latest: Ticks) -> Ticks {
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

    /// Whether nothing has come for so long that it is as good as lost.
    pub(super) fn is_silent(&self) -> bool {
        self.silence() > SILENCE
    }

    /// Asks the board for its time, where that is due. Never waits.
    pub(super) fn compare_clocks(&mut self) {
        let now = self.board.now();
        if self.axis.wants_to_ask(now) {
            let id = self.board.ask_time();
            self.axis.asked(id, now);
        }
    }

    pub(super) const fn scale(&self) -> &Scale {
        &self.scale
    }

    /// The scale that the board's IMU has now.
    pub(super) fn set_scale(&mut self, scale: Option<Scale>) {
        self.next_scale = None;
        self.scale = scale.unwrap_or(self.scale);
    }

    /// The scale after the set-up of the IMU that was asked for at the recorded time `now`.
    pub(super) fn expect_scale(&mut self, scale: Option<Scale>, now: Ticks) {
        self.next_scale = scale.map(|scale| NextScale {
            scale,
            latest: Ticks(now.0.saturating_add(u64::from(TICK_HZ))),
        });
    }

    /// A sample in SI units.
    pub(super) fn in_si(&mut self, raw: &ImuSample) -> Sample {
        let set_up = |next: &NextScale| raw.flags.has(ImuFlags::FIRST) || raw.at > next.latest;
        if let Some(next) = self.next_scale.take_if(|next| set_up(next)) {
            self.scale = next.scale;
        }
        self.scale.apply(raw)
    }
}
