//! The further outputs: three trigger trains beside the camera's.
//!
//! All of them are in the one timebase. A period is Q32.32 ticks as everywhere;
//! a first edge or an anchor has a fraction too, so that a train can be put on an
//! exact multiple of another one and stay on it for ever: the next edge of
//! any train is told with its fraction ([`crate::TriggerStatus::next_fraction`]).

use serde::{Deserialize, Serialize};

use crate::trigger::{Pulse, TrainState, TriggerAlign, TriggerStart};
use crate::units::{Period, TICK_HZ, TickDelta, Ticks};

/// The shortest pulse of these outputs, in ticks: 50 µs.
///
/// The handler of the rising edge arms the falling one. It waits for the camera
/// trigger's, and for the others' at a coincidence (`docs/timing.md`).
pub const MIN_OUTPUT_WIDTH: u32 = 50 * (TICK_HZ / 1_000_000);

/// The shortest time from a falling edge of these outputs to the next rising
/// edge, in ticks: 100 µs.
pub const MIN_OUTPUT_GAP: u32 = 100 * (TICK_HZ / 1_000_000);

/// A trigger output beside the camera's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Output {
    /// PE11, TIM1 channel 2.
    Two,
    /// PE13, TIM1 channel 3.
    Three,
    /// PE14, TIM1 channel 4.
    Four,
}

impl Output {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Two, Self::Three, Self::Four];

    /// Its number on the board, from 2: the camera's trigger is output 1.
    #[must_use]
    pub const fn number(self) -> u8 {
        match self {
            Self::Two => 2,
            Self::Three => 3,
            Self::Four => 4,
        }
    }

    /// The output with this number.
    #[must_use]
    pub const fn from_number(number: u8) -> Option<Self> {
        match number {
            2 => Some(Self::Two),
            3 => Some(Self::Three),
            4 => Some(Self::Four),
            _ => None,
        }
    }
}

/// What an output is asked to do; as the camera trigger's commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum OutputAction {
    /// Start a train.
    Start(OutputStart),
    /// Move the train onto a grid.
    Align(OutputAlign),
    /// Set another period.
    Period(Period),
    /// Stop the train.
    Stop,
    /// Tell the state of the train.
    Query,
}

/// Parameters of a train on one of these outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OutputStart {
    /// Distance of the pulses, [`Period::MIN`] to [`Period::MAX`].
    pub period: Period,
    /// Length of a pulse in ticks: [`MIN_OUTPUT_WIDTH`] up to the period less
    /// [`MIN_OUTPUT_GAP`].
    pub width: u32,
    /// The first rising edge; `None`: as soon as possible.
    pub first_edge: Option<Ticks>,
    /// Fraction of `first_edge`, in 2⁻³² ticks; of no meaning without one.
    pub first_fraction: u32,
}

impl From<TriggerStart> for OutputStart {
    fn from(start: TriggerStart) -> Self {
        Self {
            period: start.period,
            width: start.width,
            first_edge: start.first_edge,
            first_fraction: 0,
        }
    }
}

/// "Some pulse edge falls at `anchor`, the period is `period`."
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OutputAlign {
    /// A tick of the wanted grid, at most an hour away.
    pub anchor: Ticks,
    /// Fraction of `anchor`, in 2⁻³² ticks.
    pub anchor_fraction: u32,
    /// The period from now on.
    pub period: Period,
    /// Most ticks a pulse; 0: jump at once. As
    /// [`crate::TriggerAlign::slew`].
    pub slew: u32,
}

impl From<TriggerAlign> for OutputAlign {
    fn from(to: TriggerAlign) -> Self {
        Self {
            anchor: to.anchor,
            anchor_fraction: 0,
            period: to.period,
            slew: to.slew,
        }
    }
}

/// A pulse of one of these outputs. Its `seq` counts the pulses of all three.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OutputPulse {
    /// The output.
    pub output: Output,
    /// The pulse; there is no read-back.
    pub pulse: Pulse,
}

/// An align of one of these outputs has reached its grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OutputArrived {
    /// The output.
    pub output: Output,
    /// The id of the align command.
    pub command: u32,
    /// The train.
    pub train: u32,
    /// The first pulse on the grid.
    pub pulse: u64,
    /// Its rising edge.
    pub at: Ticks,
    /// Difference from the grid: 0.
    pub remaining: TickDelta,
}

/// How the train of one of these outputs fares.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OutputStatus {
    /// What the train does.
    pub state: TrainState,
    /// Number of this train; 0: none yet.
    pub train: u32,
    /// Rising edges that this train has made.
    pub pulses: u64,
    /// Edges that came later than asked for. Must be 0.
    pub late: u32,
}

impl OutputStatus {
    /// An output that was never started.
    pub const IDLE: Self = Self {
        state: TrainState::Stopped,
        train: 0,
        pulses: 0,
        late: 0,
    };
}
