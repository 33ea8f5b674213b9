//! What board and host say to each other.
//!
//! Host to board: commands, each with an id. Every command gets exactly one
//! [`Answer`] with that id. Commands are idempotent: sending one twice changes
//! nothing beyond the first time.
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
use crate::gnss::{GnssReport, GnssSettings, Pps};
use crate::imu::{ImuConfig, ImuSample, ImuSetup};
use crate::outputs::{Output, OutputAction, OutputArrived, OutputPulse};
use crate::trigger::{AlignPlan, Arrived, Pulse, TriggerAlign, TriggerStart, TriggerStatus};
use crate::units::{Period, Ticks};

/// Payload bytes of one [`Filler`].
pub const MAX_FILLER: usize = 240;

/// A command and the id under which it is answered.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HostToDevice {
    /// Chosen by the host; comes back in the [`Answer`].
    pub id: u32,
    /// What to do.
    pub command: Command,
}

/// What the host can ask for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Command {
    /// Send a [`Hello`] (before the answer, which is [`Reply::Done`]).
    Hello,
    /// Answered with [`Reply::Pong`].
    Ping {
        /// Any number of the host's, returned as it is.
        host_time: u64,
    },
    /// Start the trigger train. Where a train runs that was started with the
    /// same parameters, nothing changes. Answered with [`Reply::Trigger`].
    TriggerStart(TriggerStart),
    /// Move the running train onto an absolute grid. Answered with
    /// [`Reply::Align`]; an [`Arrived`] follows. An align replaces one that is
    /// still on its way, whose [`Arrived`] then never comes.
    TriggerAlign(TriggerAlign),
    /// Set another period, from the next edge that is not armed yet on. The
    /// phase continues from that edge. Refused while an align is on its way.
    TriggerPeriod(Period),
    /// Stop the train after the pulse that is being made, if any.
    TriggerStop,
    /// Answered with [`Reply::Trigger`].
    TriggerQuery,
    /// Set up the IMU. Answered with [`Reply::Imu`]; sampling restarts.
    ImuConfigure(ImuConfig),
    /// Answered with [`Reply::Imu`].
    ImuQuery,
    /// Send filler at up to this many payload bytes a second; 0 is off,
    /// `u32::MAX` as much as USB takes. To load the link in tests.
    Filler {
        /// Payload bytes a second.
        bytes_per_second: u32,
    },
    /// Fail on purpose, to try out the recovery.
    SelfTest {
        /// Must be [`SELF_TEST_KEY`]; anything else is refused.
        key: u32,
        /// The failure to cause.
        failure: Failure,
    },
    /// A command to one of the further trigger outputs. Answered with
    /// [`Reply::Trigger`] or, for an align, [`Reply::Align`].
    Output {
        /// The output.
        output: Output,
        /// What it is asked to do.
        action: OutputAction,
    },
    /// Start the pulse per second and its sentences, on the next whole second of
    /// board time. Where it runs with the same settings, nothing changes.
    /// Answered with [`Reply::Gnss`].
    GnssStart(GnssSettings),
    /// Stop it. Answered with [`Reply::Gnss`].
    GnssStop,
    /// Answered with [`Reply::Gnss`].
    GnssQuery,
}

/// The key of [`Command::SelfTest`], so that no stray bytes crash a rig.
pub const SELF_TEST_KEY: u32 = 0x5EED_FA11;

/// The failures that [`Command::SelfTest`] can cause.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Failure {
    /// Panic with a known message; the next [`Hello`] must report it.
    Panic,
    /// A task that never yields; the watchdog must reset the board.
    Hang,
    /// An undefined instruction, which ends in a HardFault.
    HardFault,
    /// One task that stops being alive while all others go on; the watchdog
    /// must reset the board.
    Stall,
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
    /// A pulse of the trigger was made.
    Pulse(Pulse),
    /// The train has arrived where an align sent it.
    Arrived(Arrived),
    /// An edge on a capture input.
    Capture(Capture),
    /// A sample of the IMU.
    Imu(ImuSample),
    /// Load for tests.
    Filler(Filler),
    /// A pulse of one of the further trigger outputs was made.
    OutputPulse(OutputPulse),
    /// One of their trains has arrived where an align sent it.
    OutputArrived(OutputArrived),
    /// A pulse per second was made.
    Pps(Pps),
}

/// The one answer to a command.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// The id of the command.
    pub id: u32,
    /// What came of it.
    pub result: Result<Reply, Refusal>,
}

/// A command that was carried out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Reply {
    /// Done; there is nothing to tell.
    Done,
    /// To [`Command::Ping`].
    Pong {
        /// The number of the ping.
        host_time: u64,
        /// When the command was taken from the link.
        received: Ticks,
        /// When the answer was put into the outbox.
        sent: Ticks,
    },
    /// To start, period, stop and query of any trigger output.
    Trigger(TriggerStatus),
    /// To [`Command::TriggerAlign`]; an [`Arrived`] follows.
    Align(AlignPlan),
    /// To the IMU's commands.
    Imu(ImuSetup),
    /// To the commands of the pulse per second.
    Gnss(GnssReport),
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
    /// The rate is not possible with an inverted line: from boards that inverted it
    /// themselves.
    GnssBaudTooHigh,
}

/// Load for tests; the payload counts up from the low byte of `seq`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Filler {
    /// Sequence number of the filler stream.
    pub seq: u32,
    /// [`MAX_FILLER`] bytes, mostly.
    pub payload: Vec<u8, MAX_FILLER>,
}
