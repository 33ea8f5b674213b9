//! Does a board do in hardware what the simulated one does?
//!
//! Wires: PA5 (the trigger) to PA3 and to PA2, later PE11 (output 2) to PA2, and the
//! IMU. Others are put on and off on the way. The board then measures itself: each edge that it makes is captured by the
//! same timer that made it, so a capture must follow its edge by a constant, the
//! delay of synchroniser and filter, and nothing else.
//!
//! [`run`] measures, one [`Part`] after the other, and gives a [`Report`] of
//! [`Check`]s, each with what was measured, its limit, and what a miss means.
//!
//! - `received`: the board's messages over a stretch of board time.
//! - `train`: a train of pulses against the arithmetic and its captures. Pure.
//! - `parts`: what is done on the board.
//! - `serial`: bytes from the edges of a serial line. Pure.
mod parts;
mod received;
mod serial;
mod train;

use std::fmt;
use std::time::Duration;

use crate::BoardError;
use crate::BoardInfo;
use crate::finding::{Finding, Severity};
use crate::transport::Link;
use protocol::BoardSettings;
use serde::Serialize;

/// Version of the JSON form of [`Report`].
const FORMAT: u32 = 2;

/// What is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Part {
    /// The trigger's edges, widths and aligns, against read-back and strobe input.
    Trigger,
    /// The auxiliary outputs against the strobe input.
    Outputs,
    /// The pulse per second and its serial line, on the strobe input.
    Lidar,
    /// Intervals of data-ready; the IMU without its clock; its recovery from an unplugged SDA.
    Imu,
    /// Throughput of USB, and what a host that does not read loses.
    Link,
    /// The board's crystal against the computer's clock; the supply.
    Clock,
    /// Trigger and messages while the board leaves the bus, the cable is pulled, the computer
    /// sleeps.
    Replug,
    /// The board after each failure and each reset.
    Resets,
    /// The trigger after its buffer and divider.
    Buffer,
    /// Hours of trigger and IMU with a computer that sleeps.
    Soak,
}

impl Part {
    /// All but those that are only measured on request.
    pub const ALL: [Self; 8] = [
        Self::Trigger,
        Self::Outputs,
        Self::Lidar,
        Self::Imu,
        Self::Link,
        Self::Clock,
        Self::Replug,
        Self::Resets,
    ];
}

/// What the person at the board reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Prompt {
    /// The part that is measured now.
    Measures(Part),
    /// To put the wire at PA2 onto this pin.
    MoveStrobeWire(&'static str),
    /// To unplug the clock of the IMU.
    UnplugClock,
    /// To plug it in again.
    PlugClockIn,
    /// To unplug SDA of the IMU.
    UnplugSda,
    /// To plug SDA in again.
    PlugSdaIn,
    /// To pull the data cable and plug it in again.
    Replug,
    /// To let the computer sleep for a while.
    Sleep,
    /// To press the reset button.
    PressReset,
    /// To switch the board off and on.
    SwitchPower,
}

impl fmt::Display for Prompt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = match self {
            Self::Measures(Part::Trigger) => "trigger: edges, widths, aligns ...",
            Self::Measures(Part::Outputs) => "outputs 2 to 4 ...",
            Self::Measures(Part::Lidar) => "pulse per second, serial line ...",
            Self::Measures(Part::Imu) => "IMU: data-ready ...",
            Self::Measures(Part::Link) => "USB: throughput, a host that does not read ...",
            Self::Measures(Part::Clock) => "crystal ...",
            Self::Measures(Part::Replug) => "USB: leaving the bus and coming back ...",
            Self::Measures(Part::Resets) => "panic, fault, hang, resets ...",
            Self::Measures(Part::Buffer) => "trigger after buffer and divider ...",
            Self::Measures(Part::Soak) => "soak ...",
            Self::MoveStrobeWire(pin) => return write!(f, "-> move the wire at PA2 to {pin}"),
            Self::UnplugClock => "-> unplug the IMU's clock (CLKIN)",
            Self::PlugClockIn => "-> plug the clock in again",
            Self::UnplugSda => "-> unplug SDA of the IMU (PB7)",
            Self::PlugSdaIn => "-> plug SDA in again",
            Self::Replug => "-> pull the data cable and plug it in again; the supply stays",
            Self::Sleep => "-> let the computer sleep for ten seconds (`systemctl suspend`)",
            Self::PressReset => "-> press the reset button",
            Self::SwitchPower => "-> take the board's supply off and put it back",
        };
        f.write_str(text)
    }
}

/// Whoever is at the board. Whether something was done is seen in what the board measures;
/// nobody has to confirm it.
#[derive(Clone, Copy)]
pub struct Operator<'a> {
    /// Tells them what is measured, and what to do.
    pub say: &'a dyn Fn(Prompt),
    /// Whether anybody is there to do it.
    pub is_there: bool,
    /// Whether to leave out what they were told to do last.
    pub skips: &'a dyn Fn() -> bool,
    /// Whether to stop.
    pub stop: &'a dyn Fn() -> bool,
    /// Opens a new link to the board, which comes back within so long.
    pub reconnect: &'a dyn Fn(Duration) -> Result<Box<dyn Link>, BoardError>,
}

/// One property of the board.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Check {
    /// What it belongs to.
    pub part: Part,
    /// What was measured, with units; its next step is where to look after a miss. Good:
    /// within its limit. Check: could not be measured. Bad: outside.
    #[serde(flatten)]
    pub finding: Finding,
    /// What it must be.
    pub limit: String,
}

/// How often each interval of data-ready came, in ticks.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Histogram {
    /// Left end of the first bin.
    pub first: u64,
    /// Width of a bin.
    pub bin: u64,
    /// Intervals in each bin.
    pub counts: Vec<u64>,
}

/// What was found.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Report {
    /// Version of this form.
    pub format: u32,
    /// The board.
    pub board: BoardInfo,
    /// What the board keeps, at the end of the test.
    pub settings: BoardSettings,
    /// The checks, in the order in which they were made.
    pub checks: Vec<Check>,
    /// Intervals of data-ready.
    pub intervals: Histogram,
}

impl Report {
    /// Number of checks that came out so.
    #[must_use]
    pub fn count(&self, severity: Severity) -> usize {
        let same = |check: &&Check| check.finding.severity == severity;
        self.checks.iter().filter(same).count()
    }
}

/// Why nothing more can be measured.
#[derive(Debug, thiserror::Error)]
pub enum BringUpError {
    /// The board cannot be reached any more, or refused a command.
    #[error(transparent)]
    Board(#[from] BoardError),
    /// The board was reset while it was being measured.
    #[error("the board was reset while it was being measured")]
    Reset,
    /// The board did not come back; a check says so.
    #[error("the board did not come back")]
    Gone,
    /// The trigger runs: something else uses the board.
    #[error("the trigger is running")]
    InUse,
    /// The operator wants to stop.
    #[error("stopped")]
    Stopped,
}

/// What is to be measured.
#[derive(Clone, Copy, Debug)]
pub struct Plan<'a> {
    /// Which parts.
    pub parts: &'a [Part],
    /// How long [`Part::Clock`] compares the crystal with the computer's clock.
    pub clock: Duration,
    /// How long [`Part::Soak`] takes.
    pub soak: Duration,
    /// Keep the measured delays and crystal in the board ([`BoardSettings`]).
    pub keep: bool,
}

/// Measures the parts, in their order. The outputs are stopped at the end, also after an error.
///
/// # Errors
///
/// The board is in use, does not answer, or is reset meanwhile; or the operator stops.
pub fn run(
    board: &mut crate::Board,
    operator: Operator<'_>,
    plan: Plan<'_>,
) -> Result<Report, BringUpError> {
    let info = BoardInfo::of(board.hello());
    let mut session = parts::Session::new(board, operator)?;
    let mut settings = session.settings(false)?;
    let measured = (plan.parts.iter()).try_for_each(|&part| session.measure(part, &plan));
    // A board that does not come back can neither be stopped nor asked.
    if !matches!(measured, Err(BringUpError::Gone)) {
        let stopped = session.stop_everything();
        measured?;
        stopped?;
        settings = session.settings(plan.keep)?;
    }
    Ok(Report {
        format: FORMAT,
        board: info,
        settings,
        checks: session.checks,
        intervals: session.intervals,
    })
}
