//! The board's messages, sorted by their streams.

use protocol::{Arrived, Capture, DeviceToHost, ImuSample, Pps, Pulse, Status};

use crate::conversation::Event;
use crate::streams::Stream;

/// Messages of the board over some time, each stream in its order.
#[derive(Clone, Debug, Default)]
pub struct Received {
    /// Pulses of the camera's trigger.
    pub pulses: Vec<Pulse>,
    /// Pulses of the auxiliary outputs.
    pub outputs: Vec<Pulse>,
    /// Edges of the strobe.
    pub strobe: Vec<Capture>,
    /// Pulses per second.
    pub pps: Vec<Pps>,
    /// Samples of the IMU.
    pub imu: Vec<ImuSample>,
    /// States of the board.
    pub statuses: Vec<Status>,
    /// Arrivals of trains on their grids.
    pub arrived: Vec<Arrived>,
    /// Payload bytes of filler.
    pub filler: u64,
    /// Messages that are missing in their streams, which the board counts.
    pub lost: u64,
    /// The same of filler, which it does not.
    pub lost_filler: u64,
    /// Frames that could not be read.
    pub damaged: u64,
}

impl Received {
    /// Appends the messages of a later stretch.
    pub fn append(&mut self, mut later: Self) {
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

    /// Adds the message of an event to its stream, or counts what is missing or damaged. Other
    /// events are ignored.
    pub fn add(&mut self, event: Event) {
        match event {
            Event::Message(message) => self.add_message(message),
            Event::Lost { stream, count } => match stream {
                Stream::Filler => self.lost_filler += u64::from(count),
                _ => self.lost += u64::from(count),
            },
            Event::Disordered { .. } => self.lost += 1,
            Event::Damaged(_) => self.damaged += 1,
            Event::Frame(_)
            | Event::Answer(_)
            | Event::Expired { .. }
            | Event::Restarted { .. }
            | Event::OtherVersion { .. } => {}
        }
    }

    fn add_message(&mut self, message: DeviceToHost) {
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
    #[must_use]
    pub fn dropped(&self) -> Option<u64> {
        let all = self.statuses.last()?.dropped;
        Some(all.total() - u64::from(all.answers))
    }
}
