//! The board test: measurements that compare a real board with the simulated one.
//!
//! Wires: PA5 (the trigger) to PA3 and to PA2, later PE11 (output 2) to PA2, and the
//! IMU. Prompts ask for others on the way. The board measures itself: each edge that it makes
//! is captured by the same timer that made it, so a capture must follow its edge by a constant,
//! the delay of synchroniser and filter, and nothing else.
//!
//! [`run`] measures one [`Part`] after the other and returns a [`BoardTestReport`] of
//! [`Check`]s, each with the measurement, its limit, and the likely cause of a miss.
//!
//! - `train`: comparison of a train of pulses with the arithmetic and its captures. Pure.
//! - `parts`: the measurements.
//! - `serial`: bytes from the edges of a serial line. Pure.

mod parts;
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

/// Version of the JSON form of [`BoardTestReport`].
const FORMAT: u32 = 2;

/// A part of the test.
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

/// A message to the person at the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Prompt {
    /// Says which part is measured now.
    Measures(Part),
    /// Asks to move the wire at PA2 onto this pin.
    MoveStrobeWire(&'static str),
    /// Asks to unplug the clock of the IMU.
    UnplugClock,
    /// Asks to plug the clock in again.
    PlugClockIn,
    /// Asks to unplug SDA of the IMU.
    UnplugSda,
    /// Asks to plug SDA in again.
    PlugSdaIn,
    /// Asks to pull the data cable and plug it in again.
    Replug,
    /// Asks to let the computer sleep for a while.
    Sleep,
    /// Asks to press the reset button.
    PressReset,
    /// Asks to switch the board off and on.
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

/// The person at the board. The measurements show when something was done; nobody has to confirm
/// it.
#[derive(Clone, Copy)]
pub struct Operator<'a> {
    /// Shows a prompt.
    pub say: &'a dyn Fn(Prompt),
    /// True if somebody is there to follow prompts.
    pub is_there: bool,
    /// Returns true if the last request is to be skipped.
    pub skips: &'a dyn Fn() -> bool,
    /// Returns true if the test is to stop.
    pub stop: &'a dyn Fn() -> bool,
    /// Opens a new link to the board, waiting for it up to the given time.
    pub reconnect: &'a dyn Fn(Duration) -> Result<Box<dyn Link>, BoardError>,
}

/// One property of the board.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Check {
    /// The part of the test that it belongs to.
    pub part: Part,
    /// The measurement with units, and where to look after a miss as its next step. Good: within
    /// its limit. Check: could not be measured. Bad: outside.
    #[serde(flatten)]
    pub finding: Finding,
    /// The limit, in words.
    pub limit: String,
}

/// Histogram of the intervals of data-ready, in ticks.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct IntervalHistogram {
    /// Left end of the first bin.
    pub first: u64,
    /// Width of a bin.
    pub bin: u64,
    /// Intervals in each bin.
    pub counts: Vec<u64>,
}

/// Result of the board test.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct BoardTestReport {
    /// Version of this JSON form.
    pub format: u32,
    /// The board.
    pub board: BoardInfo,
    /// The settings that the board keeps at the end of the test.
    pub settings: BoardSettings,
    /// The checks, in the order in which they were made.
    pub checks: Vec<Check>,
    /// Intervals of data-ready.
    pub intervals: IntervalHistogram,
}

impl BoardTestReport {
    /// Returns the number of checks of this severity.
    #[must_use]
    pub fn count(&self, severity: Severity) -> usize {
        let same = |check: &&Check| check.finding.severity == severity;
        self.checks.iter().filter(same).count()
    }
}

/// Reason for which the test ended early.
#[derive(Debug, thiserror::Error)]
pub enum BringUpError {
    /// The board can no longer be reached, or refused a command.
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

/// Settings of the test.
#[derive(Clone, Copy, Debug)]
pub struct Plan<'a> {
    /// Parts to measure, in this order.
    pub parts: &'a [Part],
    /// Time for which [`Part::Clock`] compares the crystal with the computer's clock.
    pub clock: Duration,
    /// Duration of [`Part::Soak`].
    pub soak: Duration,
    /// True to keep the measured delays and crystal in the board ([`BoardSettings`]).
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
) -> Result<BoardTestReport, BringUpError> {
    let info = BoardInfo::new(board.hello());
    let mut test = parts::BoardTest::new(board, operator)?;
    let mut settings = test.settings(false)?;
    let measured = (plan.parts.iter()).try_for_each(|&part| test.measure(part, &plan));
    // A board that does not come back can neither be stopped nor asked.
    if !matches!(measured, Err(BringUpError::Gone)) {
        let stopped = test.stop_everything();
        measured?;
        stopped?;
        settings = test.settings(plan.keep)?;
    }
    Ok(BoardTestReport {
        format: FORMAT,
        board: info,
        settings,
        checks: test.checks,
        intervals: test.intervals,
    })
}
