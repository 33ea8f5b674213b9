//! The board's messages over a stretch of board time.

use protocol::{Arrived, Capture, DeviceToHost, ImuSample, Pps, Pulse, Status, TICK_HZ, TickDelta};

/// Ticks in a millisecond of board time.
const TICKS_PER_MS: u32 = TICK_HZ / 1_000;

/// Returns a distance in board time.
pub(crate) const fn millis(ms: u32) -> TickDelta {
    TickDelta(ms as i64 * TICKS_PER_MS as i64)
}

/// Messages of the board, each stream in its order.
#[derive(Clone, Debug, Default)]
pub(crate) struct Received {
    pub(crate) pulses: Vec<Pulse>,
    /// Pulses of the auxiliary outputs.
    pub(crate) outputs: Vec<Pulse>,
    pub(crate) strobe: Vec<Capture>,
    pub(crate) pps: Vec<Pps>,
    pub(crate) imu: Vec<ImuSample>,
    pub(crate) statuses: Vec<Status>,
    pub(crate) arrived: Vec<Arrived>,
    /// Payload bytes of filler.
    pub(crate) filler: u64,
    /// Messages that are missing in their streams, which the board counts.
    pub(crate) lost: u64,
    /// The same of filler, which it does not.
    pub(crate) lost_filler: u64,
    /// Frames that could not be read.
    pub(crate) damaged: u64,
}

impl Received {
    /// Appends the messages of a later stretch.
    pub(crate) fn append(&mut self, mut later: Self) {
        self.pulses.append(&mut later.pulses);
        self.outputs.append(&mut later.outputs);
        self.strobe.append(&mut later.strobe);
        self.imu.append(&mut later.imu);
        self.statuses.append(&mut later.statuses);
        self.arrived.append(&mut later.arrived);
        self.filler += later.filler;
        self.pps.append(&mut later.pps);
        self.lost += later.lost;
        self.lost_filler += later.lost_filler;
        self.damaged += later.damaged;
    }

    /// Adds a message to its stream.
    pub(crate) fn add(&mut self, message: DeviceToHost) {
        match message {
            DeviceToHost::Status(status) => self.statuses.push(status),
            DeviceToHost::Pulse(pulse) if pulse.output.is_camera() => self.pulses.push(pulse),
            DeviceToHost::Pulse(pulse) => self.outputs.push(pulse),
            DeviceToHost::Arrived(arrived) => self.arrived.push(arrived),
            DeviceToHost::Capture(capture) => self.strobe.push(capture),
            DeviceToHost::Imu(sample) => self.imu.push(sample),
            DeviceToHost::Filler(filler) => self.filler += filler.payload.len() as u64,
            DeviceToHost::Pps(pps) => self.pps.push(pps),
            DeviceToHost::Hello(_) | DeviceToHost::Answer(_) => {}
        }
    }

    /// Returns the number of messages of the numbered streams that the board has dropped since its
    /// reset.
    pub(crate) fn dropped(&self) -> Option<u64> {
        let all = self.statuses.last()?.dropped;
        Some(all.total() - u64::from(all.answers))
    }
}
