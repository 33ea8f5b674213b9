//! The board's messages over a stretch of board time.

use protocol::{Arrived, Capture, DeviceToHost, ImuSample, Pulse, Status, TICK_HZ, TickDelta};

/// Ticks in a millisecond of board time.
const TICKS_PER_MS: u32 = TICK_HZ / 1_000;

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

    pub(crate) fn take(&mut self, message: DeviceToHost) {
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
