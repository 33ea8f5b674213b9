//! Frames in recordings, also of boards of an older version.
//!
//! Host and board must agree on the version; a recording may be older than both.
//! What versions 2 and 3 said otherwise than this one is declared here once more, for
//! reading alone.

use heapless::String;
use serde::Deserialize;

use crate::PROTOCOL_VERSION;
use crate::board::{BoardModel, Dropped, Handlers, Hello, MAX_PANIC, ResetCause, Status};
use crate::capture::Capture;
use crate::framing::{FrameError, LinkCounters, MAX_FRAME, body, parse};
use crate::gnss::{GnssStatus, Pps};
use crate::imu::{ImuSample, ImuStatus};
use crate::messages::{DeviceToHost, Filler};
use crate::trigger::{Arrived, Output, OutputStatus, Pulse, TriggerStatus};
use crate::units::{TickDelta, Ticks};

/// The oldest version whose frames are read.
pub const OLDEST_RECORDED: u16 = 2;

/// Variant of the hellos, in all versions.
const HELLO: u8 = 0;

/// Variant of the answers, in all versions.
const ANSWER: u8 = 1;

/// A frame of the link as a recording has it, without its delimiter, of a board that
/// spoke `version`. `None`: an answer of an older version, which nobody needs.
///
/// # Errors
///
/// The frame is damaged or no message of that version; the version is not read.
pub fn read_recorded(version: u16, frame: &[u8]) -> Result<Option<DeviceToHost>, FrameError> {
    let mut buffer = [0; MAX_FRAME];
    let copy = buffer.get_mut(..frame.len()).ok_or(FrameError::Oversize)?;
    copy.copy_from_slice(frame);
    let message = body(copy)?;
    match (version, message.first()) {
        (PROTOCOL_VERSION, _) => parse(message).map(Some),
        (2 | 3, Some(&ANSWER)) => Ok(None),
        (3, Some(&HELLO)) => parse(message).map(|Message3::Hello(hello)| Some(hello.today())),
        // Nothing else has changed since.
        (3, _) => parse(message).map(Some),
        (2, _) => parse(message).map(Message2::today),
        _ => Err(FrameError::Message),
    }
}

#[derive(Deserialize)]
enum Message3 {
    Hello(Hello3),
}

#[derive(Deserialize)]
struct Hello3 {
    protocol_version: u16,
    firmware_version: (u8, u8, u8),
    git_revision: String<12>,
    git_dirty: bool,
    board_id: [u8; 12],
    tick_hz: u32,
    now: Ticks,
    epoch: u32,
    reset_cause: ResetCause,
    last_panic: Option<String<MAX_PANIC>>,
}

#[derive(Deserialize)]
#[allow(
    clippy::large_enum_variant,
    reason = "no allocation here; one is alive at once"
)]
enum Message2 {
    Hello(Hello3),
    Answer(()),
    Status(Status2),
    Pulse(Pulse2),
    Arrived(Arrived2),
    Capture(Capture),
    Imu(ImuSample),
    Filler(Filler),
    OutputPulse(Output2, Pulse2),
    OutputArrived(Output2, Arrived2),
    Pps(Pps),
}

/// The outputs beside the camera's.
#[derive(Deserialize)]
enum Output2 {
    Two,
    Three,
    Four,
}

#[derive(Deserialize)]
struct Pulse2 {
    seq: u32,
    train: u32,
    number: u64,
    at: Ticks,
    aligned: bool,
    readback: Option<i32>,
}

#[derive(Deserialize)]
struct Arrived2 {
    command: u32,
    train: u32,
    pulse: u64,
    at: Ticks,
    remaining: TickDelta,
}

#[derive(Deserialize)]
struct Status2 {
    seq: u32,
    at: Ticks,
    epoch: u32,
    dropped: Dropped,
    link: LinkCounters,
    connects: u32,
    cpu_permille: u16,
    stack_used: u32,
    stack_size: u32,
    trigger: TriggerStatus,
    trigger_latency: u32,
    /// Time in the trigger's handler over the last second, in ticks.
    trigger_busy: u32,
    strobe_overcaptures: u32,
    strobe_floods: u32,
    imu: ImuStatus,
    outputs: [OutputStatus; 3],
    output_latency: u32,
    gnss: GnssStatus,
}

impl From<Output2> for Output {
    fn from(output: Output2) -> Self {
        match output {
            Output2::Two => Self::Two,
            Output2::Three => Self::Three,
            Output2::Four => Self::Four,
        }
    }
}

impl Hello3 {
    fn today(self) -> DeviceToHost {
        DeviceToHost::Hello(Hello {
            protocol_version: self.protocol_version,
            firmware_version: self.firmware_version,
            git_revision: self.git_revision,
            git_dirty: self.git_dirty,
            board_id: self.board_id,
            tick_hz: self.tick_hz,
            now: self.now,
            epoch: self.epoch,
            reset_cause: self.reset_cause,
            last_panic: self.last_panic,
            // There was no other.
            board: BoardModel::Discovery,
        })
    }
}

impl Pulse2 {
    fn of(self, output: Output) -> DeviceToHost {
        DeviceToHost::Pulse(Pulse {
            output,
            seq: self.seq,
            train: self.train,
            number: self.number,
            at: self.at,
            aligned: self.aligned,
            readback: self.readback,
        })
    }
}

impl Arrived2 {
    fn of(self, output: Output) -> DeviceToHost {
        DeviceToHost::Arrived(Arrived {
            output,
            command: self.command,
            train: self.train,
            pulse: self.pulse,
            at: self.at,
            remaining: self.remaining,
        })
    }
}

impl From<Status2> for Status {
    fn from(status: Status2) -> Self {
        let mut handlers = Handlers::default();
        // Two cycles are a tick. The number of calls was not told.
        handlers.trigger.cycles = status.trigger_busy.saturating_mul(2);
        Self {
            seq: status.seq,
            at: status.at,
            epoch: status.epoch,
            dropped: status.dropped,
            link: status.link,
            connects: status.connects,
            cpu_permille: status.cpu_permille,
            stack_used: status.stack_used,
            stack_size: status.stack_size,
            trigger: status.trigger,
            trigger_latency: status.trigger_latency,
            handlers,
            die_decidegrees: None,
            strobe_overcaptures: status.strobe_overcaptures,
            strobe_floods: status.strobe_floods,
            imu: status.imu,
            outputs: status.outputs,
            output_latency: status.output_latency,
            gnss: status.gnss,
        }
    }
}

impl Message2 {
    fn today(self) -> Option<DeviceToHost> {
        Some(match self {
            Self::Answer(()) => return None,
            Self::Hello(hello) => hello.today(),
            Self::Status(status) => DeviceToHost::Status(status.into()),
            Self::Pulse(pulse) => pulse.of(Output::Camera),
            Self::Arrived(arrived) => arrived.of(Output::Camera),
            Self::Capture(capture) => DeviceToHost::Capture(capture),
            Self::Imu(sample) => DeviceToHost::Imu(sample),
            Self::Filler(filler) => DeviceToHost::Filler(filler),
            Self::OutputPulse(output, pulse) => pulse.of(output.into()),
            Self::OutputArrived(output, arrived) => arrived.of(output.into()),
            Self::Pps(pps) => DeviceToHost::Pps(pps),
        })
    }
}
