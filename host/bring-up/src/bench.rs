//! The board's messages over a stretch of board time.

use std::time::Duration;

use board::{Board, BoardError, Event};
use protocol::{Arrived, Capture, DeviceToHost, ImuSample, Pulse, Status, TICK_HZ, TickDelta};

use crate::{BringUpError, Operator};

/// Ticks in a millisecond of board time.
const TICKS_PER_MS: u32 = TICK_HZ / 1_000;

/// How long the board may say nothing, on the link's clock. It sends a status once a
/// second of board time; a simulated one may be slower.
const PATIENCE: Duration = Duration::from_secs(20);

/// A distance in board time.
pub(crate) const fn millis(ms: u32) -> TickDelta {
    TickDelta(ms as i64 * TICKS_PER_MS as i64)
}

/// What the board has said.
#[derive(Clone, Debug, Default)]
pub(crate) struct Heard {
    pub(crate) pulses: Vec<Pulse>,
    /// Pulses of output 2.
    pub(crate) outputs: Vec<Pulse>,
    pub(crate) strobe: Vec<Capture>,
    pub(crate) imu: Vec<ImuSample>,
    pub(crate) statuses: Vec<Status>,
    pub(crate) arrived: Vec<Arrived>,
    /// Payload bytes of filler.
    pub(crate) filler: u64,
    /// Messages that are missing in their streams.
    pub(crate) lost: u64,
    /// Frames that could not be read.
    pub(crate) damaged: u64,
}

impl Heard {
    pub(crate) fn append(&mut self, mut later: Self) {
        self.pulses.append(&mut later.pulses);
        self.outputs.append(&mut later.outputs);
        self.strobe.append(&mut later.strobe);
        self.imu.append(&mut later.imu);
        self.statuses.append(&mut later.statuses);
        self.arrived.append(&mut later.arrived);
        self.filler += later.filler;
        self.lost += later.lost;
        self.damaged += later.damaged;
    }

    fn take(&mut self, message: DeviceToHost) {
        match message {
            DeviceToHost::Status(status) => self.statuses.push(status),
            DeviceToHost::Pulse(pulse) if pulse.output.is_camera() => self.pulses.push(pulse),
            DeviceToHost::Pulse(pulse) => self.outputs.push(pulse),
            DeviceToHost::Arrived(arrived) => self.arrived.push(arrived),
            DeviceToHost::Capture(capture) => self.strobe.push(capture),
            DeviceToHost::Imu(sample) => self.imu.push(sample),
            DeviceToHost::Filler(filler) => self.filler += filler.payload.len() as u64,
            DeviceToHost::Hello(_) | DeviceToHost::Answer(_) | DeviceToHost::Pps(_) => {}
        }
    }
}

/// Takes what the board says for `length` of board time, or until `done`.
pub(crate) fn hear(
    board: &mut Board,
    operator: &dyn Operator,
    length: TickDelta,
    mut done: impl FnMut(&Heard) -> bool,
) -> Result<Heard, BringUpError> {
    let mut heard = Heard::default();
    let end = board.ping()?.0 + length;
    let mut sign = board.now();
    while board.conversation().latest() < end && !done(&heard) {
        if operator.wants_to_stop() {
            return Err(BringUpError::Stopped);
        }
        match board.next_event(Duration::from_millis(100))? {
            Some(Event::Message(message)) => {
                sign = board.now();
                heard.take(message);
            }
            Some(Event::Lost { count, .. }) => heard.lost += u64::from(count),
            Some(Event::Disordered { .. }) => heard.lost += 1,
            Some(Event::Damaged(_)) => heard.damaged += 1,
            Some(Event::Restarted { .. }) => return Err(BringUpError::Reset),
            Some(Event::OtherVersion { found }) => {
                return Err(BoardError::OtherVersion { found }.into());
            }
            Some(Event::Frame(_) | Event::Answer(_) | Event::Expired { .. }) | None => {}
        }
        if board.now().saturating_sub(sign) > PATIENCE {
            let command = "any message";
            return Err(BoardError::NoAnswer { command }.into());
        }
    }
    Ok(heard)
}
