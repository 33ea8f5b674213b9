//! The further outputs: three trigger trains beside the camera's, and the pulse
//! per second with its sentences that a lidar takes for a GNSS receiver.
//!
//! All of them are in the one timebase. A period is Q32.32 ticks as everywhere;
//! a first edge or an anchor has a fraction too, so that a train can be put on an
//! exact multiple of another one and stay on it for ever: the next edge of
//! any train is told with its fraction ([`crate::TriggerStatus::next_fraction`]).

use serde::{Deserialize, Serialize};

use crate::messages::{Pulse, TrainState, TriggerAlign, TriggerStart};
use crate::units::{Period, TICK_HZ, TickDelta, Ticks};

/// The shortest pulse of these outputs, in ticks: 50 µs.
///
/// Their handler waits for the camera trigger's, and for one another at a
/// coincidence (`docs/timing.md`).
pub const MIN_OUTPUT_WIDTH: u32 = 50 * (TICK_HZ / 1_000_000);

/// The shortest time from a falling edge of these outputs to the next rising
/// edge, in ticks: 100 µs.
pub const MIN_OUTPUT_GAP: u32 = 100 * (TICK_HZ / 1_000_000);

/// The longest pulse per second, in ticks: half a second.
pub const MAX_PPS_WIDTH: u32 = TICK_HZ / 2;

/// Sentences must have ended this long after the leading edge of their pulse, in ms.
/// Velodyne's HDL-32E wants them to begin at most so long after the pulse's end (user
/// manual, "External GPS Time Synchronization").
pub const NMEA_WINDOW_MS: u32 = 500;

/// How late the board may begin to send them, in ms; it leaves out what would be
/// later.
pub const NMEA_SLACK_MS: u32 = 5;

/// The longest text of one second, in bytes: `$GPRMC` and `$GPZDA` with their
/// line ends.
pub const MAX_NMEA: usize = 128;

/// The first second that the sentences can tell: 2000-01-01, as Unix time.
pub const MIN_UTC: i64 = 946_684_800;

/// The first second that they cannot: 2100-01-01, as Unix time. `$GPRMC` has two
/// digits of the year.
pub const END_UTC: i64 = 4_102_444_800;

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
    /// Which output.
    pub output: Output,
    /// The pulse; there is no read-back.
    pub pulse: Pulse,
}

/// An align of one of these outputs has reached its grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OutputArrived {
    /// Which output.
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

/// Settings of the pulse per second and its sentences.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct GnssSettings {
    /// Unix time of tick 0: the pulse at tick `n` · 48,000,000 begins the UTC
    /// second `utc_at_zero + n`. Leap seconds are not known.
    pub utc_at_zero: i64,
    /// Rate of the serial line.
    pub baud: Baud,
    /// The line is low when idle, as behind an RS-232 driver: what Velodyne's
    /// VLP-16 wants (user manual 63-9243, 7.4.3). Otherwise high, as a UART's is.
    pub line_inverted: bool,
    /// Which sentences.
    pub sentences: Sentences,
    /// From the pulse's leading edge to the first bit of the sentences, in ms;
    /// with the sentences at most [`NMEA_WINDOW_MS`].
    pub delay_ms: u16,
    /// Length of the pulse in ticks, [`MIN_OUTPUT_WIDTH`] to [`MAX_PPS_WIDTH`].
    pub pulse_width: u32,
    /// The pulse goes from high to low.
    pub pulse_inverted: bool,
}

impl GnssSettings {
    /// How long the sentences of one second are at most, in bytes.
    #[must_use]
    pub const fn longest_text(&self) -> u32 {
        match self.sentences {
            Sentences::Rmc => RMC_LEN,
            Sentences::RmcZda => RMC_LEN + ZDA_LEN,
        }
    }

    /// When the sentences of one second have ended, in µs after its pulse.
    #[must_use]
    pub const fn ends_us(&self) -> u32 {
        // A start bit, eight bits, a stop bit.
        let bits = self.longest_text() * 10;
        (self.delay_ms as u32 + NMEA_SLACK_MS) * 1_000
            + (bits * 1_000).div_ceil(self.baud.hz()) * 1_000
    }
}

/// `$GPRMC,hhmmss.00,A,0000.0000,N,00000.0000,E,0.0,0.0,ddmmyy,,,A*hh` and the
/// line end.
const RMC_LEN: u32 = 67;

/// `$GPZDA,hhmmss.00,dd,mm,yyyy,00,00*hh` and the line end.
const ZDA_LEN: u32 = 38;

/// Rates of the serial line. It takes 8 data bits, no parity, one stop bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Baud {
    /// 4,800 Bd.
    B4800,
    /// 9,600 Bd: Velodyne's.
    B9600,
    /// 19,200 Bd.
    B19200,
    /// 38,400 Bd; not with an inverted line.
    B38400,
    /// 57,600 Bd; not with an inverted line.
    B57600,
    /// 115,200 Bd; not with an inverted line.
    B115200,
}

impl Baud {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::B4800,
        Self::B9600,
        Self::B19200,
        Self::B38400,
        Self::B57600,
        Self::B115200,
    ];

    /// Bits a second.
    #[must_use]
    pub const fn hz(self) -> u32 {
        match self {
            Self::B4800 => 4_800,
            Self::B9600 => 9_600,
            Self::B19200 => 19_200,
            Self::B38400 => 38_400,
            Self::B57600 => 57_600,
            Self::B115200 => 115_200,
        }
    }
}

/// Sentences of each second.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Sentences {
    /// `$GPRMC`.
    Rmc,
    /// `$GPRMC`, then `$GPZDA`.
    RmcZda,
}

/// How the pulse per second fares. Counters count from reset and saturate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct GnssStatus {
    /// What the pulse does.
    pub state: TrainState,
    /// Pulses since it was started.
    pub pulses: u64,
    /// Seconds whose sentences were sent.
    pub sentences: u32,
    /// Seconds whose sentences were not, because the time for them was over.
    pub missed: u32,
    /// Edges that came later than asked for. Must be 0.
    pub late: u32,
}

impl GnssStatus {
    /// A pulse per second that was never started.
    pub const IDLE: Self = Self {
        state: TrainState::Stopped,
        pulses: 0,
        sentences: 0,
        missed: 0,
        late: 0,
    };
}

/// Settings and state together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct GnssReport {
    /// The settings, while it runs.
    pub settings: Option<GnssSettings>,
    /// How it fares.
    pub status: GnssStatus,
}

/// A pulse per second was made: the relation of the pretended GNSS time to board
/// time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pps {
    /// Sequence number of this stream.
    pub seq: u32,
    /// The leading edge.
    pub at: Ticks,
    /// The second that begins with it, as Unix time.
    pub utc: i64,
}
