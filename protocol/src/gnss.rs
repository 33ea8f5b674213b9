//! The pulse per second with its sentences, which a lidar takes for a GNSS receiver.

use serde::{Deserialize, Serialize};

use crate::trigger::TrainState;
use crate::units::{TICK_HZ, Ticks};

/// The longest pulse per second, in ticks: half a second.
pub const MAX_PPS_WIDTH: u32 = TICK_HZ / 2;

/// Sentences must have ended this long after the leading edge of their pulse, in ms.
/// Velodyne's HDL-32E requires them to begin within this time after the pulse's end (user
/// manual, "External GPS Time Synchronization").
pub const NMEA_WINDOW_MS: u32 = 500;

/// Longest delay of the start of sentences, in ms; the board leaves out those that would begin
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

/// Settings of the pulse per second and its sentences.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct GnssSettings {
    /// Unix time of tick 0: the pulse at tick `n` · 48,000,000 begins the UTC
    /// second `utc_at_zero + n`. Leap seconds are not known.
    pub utc_at_zero: i64,
    /// Rate of the serial line.
    pub baud: Baud,
    /// The lidar's line is low when idle, as behind an RS-232 driver: what Velodyne's
    /// VLP-16 wants (user manual 63-9243, 7.4.3). It is then wired through an inverting
    /// gate: the board's pin is high when idle, as a UART's is, whatever is said here.
    pub line_inverted: bool,
    /// Sentences of each second.
    pub sentences: Sentences,
    /// From the pulse's leading edge to the first bit of the sentences, in ms;
    /// with the sentences at most [`NMEA_WINDOW_MS`].
    pub delay_ms: u16,
    /// Length of the pulse in ticks, [`crate::MIN_OUTPUT_WIDTH`] to [`MAX_PPS_WIDTH`].
    pub pulse_width: u32,
    /// The pulse goes from high to low.
    pub pulse_inverted: bool,
}

impl GnssSettings {
    /// When the sentences of one second have ended, in µs after its pulse.
    #[must_use]
    pub const fn ends_us(&self) -> u32 {
        let bytes = match self.sentences {
            Sentences::Rmc => RMC_LEN,
            Sentences::RmcZda => RMC_LEN + ZDA_LEN,
        };
        // A start bit, eight bits, a stop bit.
        let bits = bytes * 10;
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
    /// 9,600 Bd: Velodyne's.
    B9600,
    /// 115,200 Bd.
    B115200,
}

impl Baud {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::B9600, Self::B115200];

    /// Bits a second.
    #[must_use]
    pub const fn hz(self) -> u32 {
        match self {
            Self::B9600 => 9_600,
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

/// Status of the pulse per second. Counters count from reset and saturate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GnssStatus {
    /// State of the pulse.
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

/// Settings and state together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct GnssReport {
    /// The settings, while it runs.
    pub settings: Option<GnssSettings>,
    /// Its status.
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
