//! The trigger outputs: starting and moving a train of pulses, its pulses and its status.
//!
//! All four outputs are in the one timebase, take the same commands and send the same
//! messages. The first edge of a train and the next edge of a running one have a fraction
//! of a tick, as a period has, so that a train can be started on an exact multiple of
//! another one and stay on it for ever.

use serde::{Deserialize, Serialize};

use crate::edges::{EdgeTime, Period};
use crate::units::{TICK_HZ, TickDelta, Ticks};

/// The shortest pulse of the camera's output, in ticks: 10 µs.
///
/// The hardware loads the falling edge at the rising one, in less than a tenth of that
/// (`docs/architecture.md`). The camera needs more than 8 µs.
pub const MIN_PULSE_WIDTH: u32 = 10 * (TICK_HZ / 1_000_000);

/// The shortest time from a falling edge of the camera's output to the next rising
/// edge, in ticks: 40 µs, in which a handler arms the next pulse.
///
/// Twice what the handler took at worst on the simulated board with a full link and the
/// pessimistic waits of its buses (`docs/architecture.md`).
pub const MIN_PULSE_GAP: u32 = 40 * (TICK_HZ / 1_000_000);

/// The shortest pulse of the auxiliary outputs, in ticks: 50 µs.
///
/// The handler of the rising edge arms the falling one. It waits for the camera
/// trigger's, and for the others' at a coincidence (`docs/architecture.md`).
pub const MIN_OUTPUT_WIDTH: u32 = 50 * (TICK_HZ / 1_000_000);

/// The shortest time from a falling edge of the auxiliary outputs to the next rising
/// edge, in ticks: 100 µs.
pub const MIN_OUTPUT_GAP: u32 = 100 * (TICK_HZ / 1_000_000);

/// Shortest lead of a first edge: 100 µs.
pub const MIN_START_LEAD: TickDelta = TickDelta::from_micros(100);

/// Farthest distance of a first edge or an anchor from now, in ticks: an hour.
pub const MAX_TIME_AWAY: u64 = 3_600 * TICK_HZ as u64;

/// A trigger output.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Output {
    /// Output 1, PA5, TIM2 channel 1: the camera's, with a read-back.
    #[default]
    Camera,
    /// PE11, TIM1 channel 2.
    Two,
    /// PE13, TIM1 channel 3.
    Three,
    /// PE14, TIM1 channel 4.
    Four,
}

impl Output {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Camera, Self::Two, Self::Three, Self::Four];

    /// Those beside the camera's.
    pub const AUXILIARY: [Self; 3] = [Self::Two, Self::Three, Self::Four];

    /// Returns its number on the board, from 1.
    #[must_use]
    pub const fn number(self) -> u8 {
        self as u8 + 1
    }

    /// Returns the output with this number, if there is one.
    #[must_use]
    pub fn from_number(number: u8) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|output| output.number() == number)
    }

    /// Returns true if it is the camera's output.
    #[must_use]
    pub const fn is_camera(self) -> bool {
        matches!(self, Self::Camera)
    }
}

/// Parameters of a train.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TriggerStart {
    /// Distance of the pulses, [`Period::MIN`] to [`Period::MAX`].
    pub period: Period,
    /// Length of a pulse in ticks: [`MIN_PULSE_WIDTH`] up to the period less
    /// [`MIN_PULSE_GAP`]; of the auxiliary outputs [`MIN_OUTPUT_WIDTH`] up to the period
    /// less [`MIN_OUTPUT_GAP`].
    pub width: u32,
    /// The first rising edge, [`MIN_START_LEAD`] to [`MAX_TIME_AWAY`] from now;
    /// `None`: as soon as possible.
    pub first_edge: Option<EdgeTime>,
}

/// "Some pulse edge falls at `anchor`, the period is `period`."
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TriggerAlign {
    /// A tick of the wanted grid, in the past or the future, at most one hour
    /// away.
    pub anchor: Ticks,
    /// The period from now on.
    pub period: Period,
    /// The most ticks that the distance of two pulses may differ from `period`
    /// on the way there, beyond the one tick by which whole edges jitter around
    /// a fractional period; 0: jump at once. At most half a period, and at most
    /// what the pulse leaves free ([`crate::Refusal::SlewOutOfRange`]).
    pub slew: u32,
}

/// Effect of an align, as planned.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlignPlan {
    /// Distance by which the edges move, the short way round (late is positive).
    pub shift: TickDelta,
    /// Number of frames over which they move.
    pub frames: u32,
    /// The first pulse that falls on the grid.
    pub arrival_pulse: u64,
    /// The tick of that pulse.
    pub arrival: Ticks,
}

/// Status of a train.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TriggerStatus {
    /// State of the train.
    pub state: TrainState,
    /// Number of this train; every start counts one up. 0: none yet.
    pub train: u32,
    /// The period that is set.
    pub period: Period,
    /// Length of a pulse, in ticks.
    pub width: u32,
    /// Rising edges that this train has made.
    pub pulses: u64,
    /// The next rising edge: with `period`, all edges after it follow exactly.
    pub next_edge: EdgeTime,
    /// Edges that were armed too late and came at a later time than asked for.
    /// Must be 0.
    pub late: u32,
    /// The read-back of the trigger wire; the camera's output alone has one.
    pub readback: Readback,
}

/// State of a train.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum TrainState {
    /// No pulses.
    #[default]
    Stopped,
    /// The first edge lies ahead.
    Waiting,
    /// Pulses on the grid.
    Running,
    /// On the way to another phase.
    Slewing,
}

/// Captures of the trigger wire behind its buffer, matched to the pulses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Readback {
    /// Pulses that were seen on the wire.
    pub seen: u32,
    /// Pulses that were not, since the first one that was.
    pub missing: u32,
    /// Captures that fit no pulse.
    pub stray: u32,
    /// From the compare to the capture of the last seen pulse, in ticks. A
    /// capture belongs to a pulse if it comes before the falling edge, so a
    /// delay longer than the pulse counts as missing and stray.
    pub delay: Option<i32>,
}

/// Short status of the train of one of the auxiliary outputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct OutputStatus {
    /// State of the train.
    pub state: TrainState,
    /// Number of this train; 0: none yet.
    pub train: u32,
    /// Rising edges that this train has made.
    pub pulses: u64,
    /// Edges that came later than asked for. Must be 0.
    pub late: u32,
}

/// One pulse of a trigger output.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pulse {
    /// The output.
    pub output: Output,
    /// Sequence number: the pulses of the camera's output are one stream, those of the
    /// three auxiliary ones together another.
    pub seq: u32,
    /// The train it belongs to.
    pub train: u32,
    /// Number in the train, from 0.
    pub number: u64,
    /// The rising edge: the compare value that made it.
    pub at: Ticks,
    /// On the grid of the last align or start (false while slewing).
    pub aligned: bool,
    /// Delay of the read-back, in ticks, if the wire was seen.
    pub readback: Option<i32>,
}

/// An align has reached its grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Arrived {
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
