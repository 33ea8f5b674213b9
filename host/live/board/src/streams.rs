//! The numbered streams of the board, with counts of messages received and lost on each.

use protocol::{DeviceToHost, Dropped, Output, Ticks};
use serde::{Deserialize, Serialize};

/// Follows running numbers, which wrap. Returns how many are missing before `number`, or `None` if
/// that is more than half of all numbers: `number` came twice or out of order.
pub const fn follow(expected: &mut Option<u32>, number: u32) -> Option<u32> {
    let gap = match *expected {
        Some(expected) => number.wrapping_sub(expected),
        None => 0,
    };
    *expected = Some(number.wrapping_add(1));
    if gap > u32::MAX / 2 { None } else { Some(gap) }
}

/// The numbered streams of the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Stream {
    /// [`DeviceToHost::Status`].
    Status,
    /// [`DeviceToHost::Pulse`] of the camera's trigger.
    Pulses,
    /// [`DeviceToHost::Capture`].
    Captures,
    /// [`DeviceToHost::Imu`].
    Imu,
    /// [`DeviceToHost::Filler`].
    Filler,
    /// [`DeviceToHost::Pulse`] of the auxiliary outputs.
    Outputs,
    /// [`DeviceToHost::Pps`].
    Pps,
}

impl Stream {
    /// All streams.
    pub const ALL: [Self; 7] = [
        Self::Status,
        Self::Pulses,
        Self::Captures,
        Self::Imu,
        Self::Filler,
        Self::Outputs,
        Self::Pps,
    ];

    /// Returns stream, number and time of a message, or `None` if it belongs to no stream. The
    /// time of filler is 0.
    #[must_use]
    pub const fn from_message(message: &DeviceToHost) -> Option<(Self, u32, Ticks)> {
        Some(match message {
            DeviceToHost::Status(status) => (Self::Status, status.seq, status.at),
            DeviceToHost::Pulse(pulse) => (Self::of_pulses(pulse.output), pulse.seq, pulse.at),
            DeviceToHost::Capture(capture) => (Self::Captures, capture.seq, capture.at),
            DeviceToHost::Imu(sample) => (Self::Imu, sample.seq, sample.at),
            DeviceToHost::Filler(filler) => (Self::Filler, filler.seq, Ticks::ZERO),
            DeviceToHost::Pps(pps) => (Self::Pps, pps.seq, pps.at),
            DeviceToHost::Hello(_) | DeviceToHost::Answer(_) | DeviceToHost::Arrived(_) => {
                return None;
            }
        })
    }

    /// Returns the stream of an output's pulses.
    const fn of_pulses(output: Output) -> Self {
        match output {
            Output::Camera => Self::Pulses,
            Output::Two | Output::Three | Output::Four => Self::Outputs,
        }
    }

    /// Returns its name in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Status => "status",
            Self::Pulses => "pulses",
            Self::Captures => "captures",
            Self::Imu => "imu",
            Self::Filler => "filler",
            Self::Outputs => "outputs",
            Self::Pps => "pps",
        }
    }

    /// Returns the board's counter of dropped messages of this stream, or `None` if the counter is
    /// shared with another stream or the board drops none. Pulses per second share the queue of the
    /// auxiliary outputs.
    #[must_use]
    pub const fn dropped(self, dropped: &Dropped) -> Option<u32> {
        // Field by field: a counter that is new has a stream that is.
        let Dropped {
            answers: _,
            pulses,
            captures,
            imu,
            status,
            outputs,
        } = *dropped;
        match self {
            Self::Status => Some(status),
            Self::Pulses => Some(pulses),
            Self::Captures => Some(captures),
            Self::Imu => Some(imu),
            Self::Outputs => Some(outputs),
            Self::Pps | Self::Filler => None,
        }
    }
}

impl std::fmt::Display for Stream {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Status => "status messages",
            Self::Pulses => "pulses",
            Self::Captures => "captures",
            Self::Imu => "IMU samples",
            Self::Filler => "filler messages",
            Self::Outputs => "pulses of auxiliary outputs",
            Self::Pps => "pulses per second",
        })
    }
}

/// Counts of messages received and lost on one stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StreamCount {
    /// Messages received.
    pub received: u64,
    /// Messages missing, by their numbers.
    pub lost: u64,
    /// Messages whose number came before, or lies so far ahead that it is unknown how
    /// many are missing.
    #[serde(default)]
    pub disordered: u64,
}

/// Counts of all streams.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StreamCounts {
    /// Status.
    pub status: StreamCount,
    /// Pulses.
    pub pulses: StreamCount,
    /// Captures.
    pub captures: StreamCount,
    /// IMU samples.
    pub imu: StreamCount,
    /// Filler.
    pub filler: StreamCount,
    /// Pulses of the auxiliary outputs.
    #[serde(default)]
    pub outputs: StreamCount,
    /// Pulses per second.
    #[serde(default)]
    pub pps: StreamCount,
}

impl StreamCounts {
    /// Returns the counts of one stream.
    #[must_use]
    pub const fn get(mut self, stream: Stream) -> StreamCount {
        *self.get_mut(stream)
    }

    /// Returns the number of messages missing on all streams.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.sum(|count| count.lost)
    }

    /// Returns the number of messages on all streams whose number does not follow.
    #[must_use]
    pub fn disordered(&self) -> u64 {
        self.sum(|count| count.disordered)
    }

    /// Sums saturating: the numbers may come from a file.
    fn sum(&self, field: fn(&StreamCount) -> u64) -> u64 {
        let counts = Stream::ALL.iter().map(|&stream| field(&self.get(stream)));
        counts.fold(0, u64::saturating_add)
    }

    pub(crate) const fn get_mut(&mut self, stream: Stream) -> &mut StreamCount {
        match stream {
            Stream::Status => &mut self.status,
            Stream::Pulses => &mut self.pulses,
            Stream::Captures => &mut self.captures,
            Stream::Imu => &mut self.imu,
            Stream::Filler => &mut self.filler,
            Stream::Outputs => &mut self.outputs,
            Stream::Pps => &mut self.pps,
        }
    }
}
