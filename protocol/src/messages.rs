//! Messages between board and host.
//!
//! Host to board: commands ([`crate::commands`]), each with an id. Every command gets
//! exactly one [`Answer`] with that id. Commands are idempotent: sending one twice
//! changes nothing beyond the first time.
//!
//! Board to host: [`Hello`] on connect and on request, answers, and streams.
//! Each stream numbers its messages on its own (`seq`, wrapping at 2³²), the
//! number is given when the message is *made*, so a message that was dropped
//! in the board's outbox or lost on the line shows as a gap. All times are
//! absolute 64-bit ticks: a lost message hurts nothing but itself.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::board::{Hello, Status};
use crate::capture::Capture;
use crate::commands::{Command, Reply};
use crate::gnss::Pps;
use crate::imu::ImuSample;
use crate::trigger::{Arrived, Pulse};
use crate::units::Ticks;

/// Payload bytes of one [`Filler`].
pub const MAX_FILLER: usize = 240;

/// A command and the id under which it is answered.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HostToDevice {
    /// Chosen by the host; comes back in the [`Answer`].
    pub id: u32,
    /// The command.
    pub command: Command,
}

/// Board to host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(
    clippy::large_enum_variant,
    reason = "no allocation here; at most a few are alive at once"
)]
pub enum DeviceToHost {
    /// Who the board is.
    Hello(Hello),
    /// The answer to a command.
    Answer(Answer),
    /// Once a second.
    Status(Status),
    /// A pulse of a trigger output was made.
    Pulse(Pulse),
    /// A train has arrived where an align sent it.
    Arrived(Arrived),
    /// An edge on a capture input.
    Capture(Capture),
    /// A sample of the IMU.
    Imu(ImuSample),
    /// Load for tests.
    Filler(Filler),
    /// A pulse per second was made.
    Pps(Pps),
}

/// The one answer to a command.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// The id of the command.
    pub id: u32,
    /// Reply, or reason for the refusal.
    pub result: Result<Reply, Refusal>,
}

/// Why a command was refused. It has changed nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Refusal {
    /// The period is not within [`Period::MIN`] ..= [`Period::MAX`].
    PeriodOutOfRange,
    /// The pulse is shorter than the least width or not shorter than the period.
    WidthOutOfRange {
        /// Least ticks.
        min: u32,
        /// Most ticks, for this period.
        max: u32,
    },
    /// The first edge or the anchor is more than an hour away, or the first
    /// edge is too close or past.
    TimeOutOfRange {
        /// The board's time when it refused.
        now: Ticks,
    },
    /// The slew is above half a period, or pulses would touch.
    SlewOutOfRange {
        /// Most ticks a frame, for this period.
        max: u32,
    },
    /// There is no train to align or to change.
    TriggerStopped,
    /// A train with other parameters runs; stop it first.
    TriggerRunning,
    /// An align is on its way; wait for its [`Arrived`], or align with another
    /// period.
    AlignInProgress,
    /// A setting of the IMU that the sensor does not have.
    ImuSettingOutOfRange,
    /// The key of a self test was wrong.
    WrongKey,
    /// The pulse per second runs with other settings; stop it first.
    GnssRunning,
    /// The pulse per second is still being stopped; its last pulse is on.
    GnssStopping,
    /// A date before 2000 or after 2099 within the next hour of board time, or
    /// before the epoch.
    GnssDateOutOfRange,
    /// The sentences would end later than [`crate::NMEA_WINDOW_MS`] after their
    /// pulse.
    GnssWindowExceeded {
        /// When they would end, in µs after the pulse.
        ends_us: u32,
    },
    /// This board has no such output, or no pulse per second
    /// ([`BoardModel::has_outputs`](crate::BoardModel::has_outputs)).
    NotOnThisBoard,
    /// A trigger output or the pulse per second runs; stop it first.
    OutputRunning,
    /// A setting of the board is above its most.
    BoardSettingOutOfRange,
    /// The board's flash did not take the settings.
    NotKept,
}

/// Load for tests; the payload counts up from the low byte of `seq`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Filler {
    /// Sequence number of the filler stream.
    pub seq: u32,
    /// [`MAX_FILLER`] bytes, mostly.
    pub payload: Vec<u8, MAX_FILLER>,
}
