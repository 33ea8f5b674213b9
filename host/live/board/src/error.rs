//! Errors of a board and its link, and the board's refusals in words.

use protocol::{
    MAX_CRYSTAL_PPB, MAX_INPUT_DELAY, MAX_START_DELAY, PROTOCOL_VERSION, Refusal, ResetCause,
};

use crate::transport::LinkError;
use crate::transport::serial::OpenError;

/// Error of a board or its link.
#[derive(Debug, thiserror::Error)]
pub enum BoardError {
    /// The port cannot be opened.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// The system does not list its ports.
    #[error("cannot list the serial ports: {0}")]
    Ports(String),
    /// No port given, and none looks like the board.
    #[error("no board found on any serial port")]
    NoBoard,
    /// No port given, and more than one looks like the board.
    #[error("more than one board found: {}", ports.join(", "))]
    ManyBoards {
        /// Their ports.
        ports: Vec<String>,
    },
    /// The link broke.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// Not one byte came from the port.
    #[error("nothing answers on the port")]
    Silent,
    /// Bytes come, but not of this protocol.
    #[error(
        "what answers on the port is not a SmartDepthSync board ({bytes} bytes, none of them understood)"
    )]
    NotThisBoard {
        /// Bytes received.
        bytes: u64,
    },
    /// The board speaks another version of the protocol.
    #[error("the board speaks protocol version {found}, this program version {PROTOCOL_VERSION}")]
    OtherVersion {
        /// The board's.
        found: u16,
    },
    /// No answer came, though the board was connected.
    #[error("the board did not answer `{command}` in time")]
    NoAnswer {
        /// Short name of the command.
        command: &'static str,
    },
    /// The board refused.
    #[error("the board refused `{command}`: {}", explain(refusal))]
    Refused {
        /// Short name of the command.
        command: &'static str,
        /// Reason of the board.
        refusal: Refusal,
    },
    /// The board gave the answer of another command.
    #[error("the board answered `{command}` with something else")]
    OddReply {
        /// Short name of the command.
        command: &'static str,
    },
}

/// Returns a refusal in words.
fn explain(refusal: &Refusal) -> String {
    let micros = |ticks: u32| f64::from(ticks) * 1e6 / f64::from(protocol::TICK_HZ);
    match *refusal {
        Refusal::PeriodOutOfRange => String::from("the period must be within 1 ms and 1 s"),
        Refusal::WidthOutOfRange { min, max } => format!(
            "the pulse must be {:.3} µs to {:.3} µs wide at this period",
            micros(min),
            micros(max)
        ),
        Refusal::TimeOutOfRange { now } => format!(
            "the first edge or the anchor is past, too close, or more than an hour away (board \
             time is {:.6} s)",
            now.as_secs_f64()
        ),
        Refusal::SlewOutOfRange { max } => format!(
            "the slew must be at most {:.3} µs a frame at this period",
            micros(max)
        ),
        Refusal::TriggerStopped => String::from("the trigger does not run; start it first"),
        Refusal::TriggerRunning => {
            String::from("a trigger with other parameters runs; stop it first")
        }
        Refusal::AlignInProgress => {
            String::from("an align is on its way; wait until it has arrived")
        }
        Refusal::ImuSettingOutOfRange => String::from("the IMU has no such setting"),
        Refusal::NotOnThisBoard => String::from(
            "this board has the camera's trigger output alone: no outputs 2 to 4 and no pulse per \
             second for a lidar",
        ),
        Refusal::OutputRunning => {
            String::from("a trigger output or the pulse per second runs; stop it first")
        }
        Refusal::BoardSettingOutOfRange => format!(
            "a delay may be at most {MAX_START_DELAY} clocks or {MAX_INPUT_DELAY} ticks, the \
             crystal off by {} ppm",
            MAX_CRYSTAL_PPB / 1_000
        ),
        Refusal::NotKept => String::from("its flash did not take the settings"),
        Refusal::WrongKey => String::from("the key of the self test is wrong"),
        Refusal::GnssRunning => {
            String::from("the pulse per second runs with other settings; stop it first")
        }
        Refusal::GnssStopping => {
            String::from("the pulse per second is just being stopped; try again in a second")
        }
        Refusal::GnssDateOutOfRange => {
            String::from("the sentences can tell dates from 2000 to 2099 only")
        }
        Refusal::GnssWindowExceeded { ends_us } => format!(
            "the sentences would end {:.1} ms after their pulse; they must within {} ms: take a \
             shorter delay or a higher rate",
            f64::from(ends_us) / 1e3,
            protocol::NMEA_WINDOW_MS
        ),
    }
}

/// Result of a call to the board.
pub type Result<T> = std::result::Result<T, BoardError>;

/// Returns the cause of a reset in words.
#[must_use]
pub const fn reset_cause(cause: ResetCause) -> &'static str {
    match cause {
        ResetCause::PowerOn => "power on",
        ResetCause::BrownOut => "brown-out: the supply dipped",
        ResetCause::Pin => "reset pin",
        ResetCause::Software => "by the firmware itself",
        ResetCause::Watchdog => "watchdog: a task was stuck",
        ResetCause::Unknown => "unknown cause",
    }
}
