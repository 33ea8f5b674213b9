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

use heapless::{String, Vec};
use serde::{Deserialize, Serialize};

use crate::framing::LinkCounters;
use crate::outputs::{
    GnssReport, GnssSettings, GnssStatus, Output, OutputAction, OutputArrived, OutputPulse,
    OutputStatus, Pps,
};
use crate::units::{Period, TICK_HZ, TickDelta, Ticks};

/// The longest text of a last panic, in bytes; longer ones are cut.
pub const MAX_PANIC: usize = 128;

/// Payload bytes of one [`Filler`].
pub const MAX_FILLER: usize = 240;

/// The shortest pulse, in ticks: 10 µs.
///
/// The handler of the rising edge arms the falling one, so a pulse must be
/// longer than that can take in the worst case (`docs/timing.md`). The camera
/// needs more than 8 µs.
pub const MIN_PULSE_WIDTH: u32 = 10 * (TICK_HZ / 1_000_000);

/// The shortest time from a falling edge to the next rising edge, in ticks:
/// 20 µs, for the same reason as [`MIN_PULSE_WIDTH`]; this handler does more.
pub const MIN_PULSE_GAP: u32 = 20 * (TICK_HZ / 1_000_000);

/// How far ahead a first edge must lie, in ticks: 100 µs.
pub const MIN_START_LEAD: u32 = 100 * (TICK_HZ / 1_000_000);

/// How far from now a first edge or an anchor may lie, in ticks: an hour.
pub const MAX_TIME_AWAY: u64 = 3_600 * TICK_HZ as u64;

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
        /// Which failure.
        failure: Failure,
    },
    /// A command to one of the further trigger outputs. Answered with
    /// [`Reply::Trigger`] or, for an align, [`Reply::Align`].
    Output {
        /// Which output.
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

/// Parameters of a train.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TriggerStart {
    /// Distance of the pulses, [`Period::MIN`] to [`Period::MAX`].
    pub period: Period,
    /// Length of a pulse in ticks: [`MIN_PULSE_WIDTH`] up to the period less
    /// [`MIN_PULSE_GAP`].
    pub width: u32,
    /// The first rising edge, [`MIN_START_LEAD`] to [`MAX_TIME_AWAY`] from now;
    /// `None`: as soon as possible.
    pub first_edge: Option<Ticks>,
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
    /// what the pulse leaves free ([`Refusal::SlewOutOfRange`]).
    pub slew: u32,
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

/// Who the board is and how it last ended.
///
/// `protocol_version` stays the first field of the first variant for ever.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Hello {
    /// [`crate::PROTOCOL_VERSION`] of the firmware.
    pub protocol_version: u16,
    /// Version of the firmware: major, minor, patch.
    pub firmware_version: (u8, u8, u8),
    /// First 12 hex digits of the git revision, empty if unknown.
    pub git_revision: String<12>,
    /// The work tree had changes when the firmware was built.
    pub git_dirty: bool,
    /// The MCU's unique device ID (RM0090 39.1).
    pub board_id: [u8; 12],
    /// Rate of all ticks, in Hz.
    pub tick_hz: u32,
    /// Time of this message.
    pub now: Ticks,
    /// Tells one run of the board from the next: a number that differs after
    /// every reset.
    pub epoch: u32,
    /// Why the board last reset.
    pub reset_cause: ResetCause,
    /// Message of the panic or fault that ended the last run, if it did.
    pub last_panic: Option<String<MAX_PANIC>>,
}

/// From the reset flags of RCC_CSR (RM0090 7.3.21).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ResetCause {
    /// Power came on (or went below the power-on threshold).
    PowerOn,
    /// Supply dipped below the brown-out level.
    BrownOut,
    /// The reset pin.
    Pin,
    /// The firmware asked for it; after a panic, see `last_panic`.
    Software,
    /// The independent watchdog.
    Watchdog,
    /// The window watchdog (not used by this firmware).
    WindowWatchdog,
    /// Illegal low-power entry (not used by this firmware).
    LowPower,
    /// No flag was set.
    Unknown,
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

/// What an align will do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlignPlan {
    /// How far the edges move, the short way round (late is positive).
    pub shift: TickDelta,
    /// Over how many frames they move.
    pub frames: u32,
    /// The first pulse that falls on the grid.
    pub arrival_pulse: u64,
    /// The tick of that pulse.
    pub arrival: Ticks,
}

/// Why a command was refused. It has changed nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
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
    /// The rate is not possible with an inverted line.
    GnssBaudTooHigh,
}

/// State of the train.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TriggerStatus {
    /// What the train does.
    pub state: TrainState,
    /// Number of this train; every start counts one up. 0: none yet.
    pub train: u32,
    /// The period that is set.
    pub period: Period,
    /// Length of a pulse, in ticks.
    pub width: u32,
    /// Rising edges that this train has made.
    pub pulses: u64,
    /// The next rising edge and its fraction, in Q64.32 split in two: an
    /// observer can go on with the arithmetic exactly.
    pub next_edge: Ticks,
    /// Fraction of `next_edge`, in 2⁻³² ticks.
    pub next_fraction: u32,
    /// Edges that were armed too late and came at a later time than asked for.
    /// Must be 0.
    pub late: u32,
    /// The read-back of the trigger wire.
    pub readback: Readback,
}

/// What the train does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum TrainState {
    /// No pulses.
    Stopped,
    /// The first edge lies ahead.
    Waiting,
    /// Pulses on the grid.
    Running,
    /// On the way to another phase.
    Slewing,
}

/// Captures of the trigger wire behind its buffer, matched to the pulses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
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

/// One pulse of the trigger.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pulse {
    /// Sequence number of the pulse stream.
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

/// An edge on a capture input.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Capture {
    /// Sequence number of the capture stream.
    pub seq: u32,
    /// Which input.
    pub channel: CaptureChannel,
    /// Which way.
    pub edge: Edge,
    /// The captured time.
    pub at: Ticks,
    /// An edge before this one was lost (over-capture): the pairing of edges
    /// starts anew here.
    pub after_loss: bool,
}

/// The capture inputs that are reported edge by edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum CaptureChannel {
    /// PA2, TIM2 channel 3.
    Strobe,
}

/// Direction of an edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Edge {
    /// Low to high.
    Rising,
    /// High to low.
    Falling,
}

/// One sample of the IMU, as read from the registers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImuSample {
    /// Sequence number of the sample stream.
    pub seq: u32,
    /// The captured edge of data-ready. The sensor's filter delay is *not*
    /// subtracted ([`ImuSetup::gyro_delay_us`]).
    pub at: Ticks,
    /// See [`ImuFlags`].
    pub flags: ImuFlags,
    /// Acceleration x, y, z, in counts of [`ImuSetup::accel_lsb_per_g`].
    pub accel: [i16; 3],
    /// Die temperature, in counts: `raw / 340 + 35` °C (MPU-9150 register map, 4.18).
    pub temperature: i16,
    /// Angular rate x, y, z, in counts of [`ImuSetup::gyro_lsb_per_dps_times_10`].
    pub gyro: [i16; 3],
}

/// Flags of one sample, as bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImuFlags(pub u8);

impl ImuFlags {
    /// The next data-ready came before the registers were read: the values may
    /// belong to the next sample.
    pub const LATE: Self = Self(1);
    /// At least one axis stands at an end of its range.
    pub const SATURATED: Self = Self(2);
    /// The first sample after the sensor was set up or recovered.
    pub const FIRST: Self = Self(4);
    /// At least one data-ready edge before this sample was lost.
    pub const AFTER_LOSS: Self = Self(8);

    /// Whether all of `flag` are set.
    #[must_use]
    pub const fn has(self, flag: Self) -> bool {
        self.0 & flag.0 == flag.0
    }

    /// Both together.
    #[must_use]
    pub const fn with(self, flag: Self) -> Self {
        Self(self.0 | flag.0)
    }
}

/// Settings of the IMU.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImuConfig {
    /// SMPLRT_DIV: the rate is 1 kHz / (1 + divider), with the low-pass on
    /// (MPU-9150 register map, 4.2); 0 to [`ImuConfig::MAX_DIVIDER`].
    pub divider: u8,
    /// DLPF_CFG, the digital low-pass.
    pub low_pass: LowPass,
    /// Full scale of the gyroscope.
    pub gyro_range: GyroRange,
    /// Full scale of the accelerometer.
    pub accel_range: AccelRange,
}

impl ImuConfig {
    /// The largest divider that the board takes: 5 Hz. Slower, and a sensor
    /// that fell silent could not be told from a slow one within a second.
    pub const MAX_DIVIDER: u8 = 199;
}

/// DLPF_CFG: bandwidth of the gyroscope (MPU-9150 register map, 4.3).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum LowPass {
    /// 188 Hz, delay 1.9 ms.
    Hz188,
    /// 98 Hz, delay 2.8 ms.
    Hz98,
    /// 42 Hz, delay 4.8 ms.
    Hz42,
    /// 20 Hz, delay 8.3 ms.
    Hz20,
    /// 10 Hz, delay 13.4 ms.
    Hz10,
    /// 5 Hz, delay 18.6 ms.
    Hz5,
}

/// FS_SEL.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum GyroRange {
    /// ±250 °/s, 131 LSB per °/s.
    Dps250,
    /// ±500 °/s, 65.5 LSB per °/s.
    Dps500,
    /// ±1000 °/s, 32.8 LSB per °/s.
    Dps1000,
    /// ±2000 °/s, 16.4 LSB per °/s.
    Dps2000,
}

/// AFS_SEL.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum AccelRange {
    /// ±2 g, 16,384 LSB per g.
    G2,
    /// ±4 g, 8,192 LSB per g.
    G4,
    /// ±8 g, 4,096 LSB per g.
    G8,
    /// ±16 g, 2,048 LSB per g.
    G16,
}

impl LowPass {
    /// Group delay of the gyroscope's low-pass, in µs (register map, 4.3).
    #[must_use]
    pub const fn gyro_delay_us(self) -> u32 {
        match self {
            Self::Hz188 => 1_900,
            Self::Hz98 => 2_800,
            Self::Hz42 => 4_800,
            Self::Hz20 => 8_300,
            Self::Hz10 => 13_400,
            Self::Hz5 => 18_600,
        }
    }

    /// Group delay of the accelerometer's low-pass, in µs (register map, 4.3).
    #[must_use]
    pub const fn accel_delay_us(self) -> u32 {
        match self {
            Self::Hz188 => 2_000,
            Self::Hz98 => 3_000,
            Self::Hz42 => 4_900,
            Self::Hz20 => 8_500,
            Self::Hz10 => 13_800,
            Self::Hz5 => 19_000,
        }
    }
}

impl GyroRange {
    /// Counts per °/s, times ten (register map, 4.19).
    #[must_use]
    pub const fn lsb_per_dps_times_10(self) -> u16 {
        match self {
            Self::Dps250 => 1_310,
            Self::Dps500 => 655,
            Self::Dps1000 => 328,
            Self::Dps2000 => 164,
        }
    }
}

impl AccelRange {
    /// Counts per g (register map, 4.17).
    #[must_use]
    pub const fn lsb_per_g(self) -> u16 {
        match self {
            Self::G2 => 16_384,
            Self::G4 => 8_192,
            Self::G8 => 4_096,
            Self::G16 => 2_048,
        }
    }
}

/// The IMU as it is set up now.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImuSetup {
    /// The settings.
    pub config: ImuConfig,
    /// Nominal distance of samples, in ticks.
    pub interval: u32,
    /// Counts per °/s, times ten.
    pub gyro_lsb_per_dps_times_10: u16,
    /// Counts per g.
    pub accel_lsb_per_g: u16,
    /// Documented delay of the gyroscope's low-pass, in µs, to be subtracted by
    /// the host.
    pub gyro_delay_us: u32,
    /// The same of the accelerometer, in µs.
    pub accel_delay_us: u32,
    /// How it fares.
    pub status: ImuStatus,
}

/// How the IMU fares. Counters count from reset and saturate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImuStatus {
    /// What it does.
    pub state: ImuState,
    /// What clocks it.
    pub clock: ImuClock,
    /// Samples read.
    pub samples: u32,
    /// Samples marked [`ImuFlags::LATE`].
    pub late: u32,
    /// Data-ready edges lost (over-captures of TIM2 channel 2).
    pub overcaptures: u32,
    /// How often the sensor was set up again after a fault.
    pub recoveries: u32,
    /// The last fault, if there was one.
    pub last_fault: Option<ImuFault>,
}

/// State of the IMU.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ImuState {
    /// Being set up.
    Starting,
    /// Samples come.
    Running,
    /// Not there or not well; tried again several times a second.
    Failed,
}

/// What clocks the IMU.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ImuClock {
    /// 19.2 MHz from PA8: its samples are exact in board time.
    External,
    /// Its own PLL on the x gyroscope: a rate error of up to ±1 %.
    Internal,
    /// Not known yet.
    Unknown,
}

/// A fault of the IMU; `register` is the number in the register map
/// ([`crate::mpu9150::register_name`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ImuFault {
    /// No acknowledge.
    NoAcknowledge {
        /// Being written or read.
        register: u8,
    },
    /// SDA or SCL held low, even after nine clocks.
    BusHeld,
    /// A transfer did not end in time.
    Timeout {
        /// Being written or read.
        register: u8,
    },
    /// Any other error of the bus (arbitration lost, misplaced start or stop).
    Bus {
        /// Being written or read.
        register: u8,
    },
    /// WHO_AM_I is not 0x68.
    WrongIdentity {
        /// What it said.
        found: u8,
    },
    /// A register did not keep what was written.
    Readback {
        /// Which.
        register: u8,
        /// What was written.
        wrote: u8,
        /// What was read.
        read: u8,
    },
    /// The sensor is set up, but no data-ready comes.
    NoDataReady,
}

/// How many messages of each stream found no place in the outbox.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Dropped {
    /// Answers, hellos and arrivals.
    pub answers: u32,
    /// Pulses.
    pub pulses: u32,
    /// Captures.
    pub captures: u32,
    /// IMU samples.
    pub imu: u32,
    /// Status messages.
    pub status: u32,
    /// Pulses of the further outputs, and pulses per second.
    pub outputs: u32,
}

impl Dropped {
    /// Messages of all streams.
    #[must_use]
    pub const fn total(&self) -> u64 {
        // By name, so that a new stream cannot be forgotten.
        let Self {
            answers,
            pulses,
            captures,
            imu,
            status,
            outputs,
        } = *self;
        answers as u64
            + pulses as u64
            + captures as u64
            + imu as u64
            + status as u64
            + outputs as u64
    }
}

/// Once a second.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// Sequence number of the status stream.
    pub seq: u32,
    /// Board time, which is also the uptime.
    pub at: Ticks,
    /// As in [`Hello::epoch`].
    pub epoch: u32,
    /// Messages dropped since reset.
    pub dropped: Dropped,
    /// What came in from the host.
    pub link: LinkCounters,
    /// How often the host has connected.
    pub connects: u32,
    /// Time not spent asleep over the last second, in 1/1000.
    pub cpu_permille: u16,
    /// Most stack ever used, in bytes (measured by paint: exact to a frame that
    /// leaves a kilobyte of itself unwritten).
    pub stack_used: u32,
    /// Stack there is, in bytes.
    pub stack_size: u32,
    /// The train.
    pub trigger: TriggerStatus,
    /// Longest time from a trigger edge to the end of its handler since reset,
    /// in ticks.
    pub trigger_latency: u32,
    /// Time spent in the handler of trigger and captures over the last second,
    /// in ticks.
    pub trigger_busy: u32,
    /// How often edges on the strobe input were lost (over-captures of TIM2
    /// channel 3).
    pub strobe_overcaptures: u32,
    /// How often the strobe input was switched off for a while because its
    /// edges came faster than the board takes them.
    pub strobe_floods: u32,
    /// The IMU.
    pub imu: ImuStatus,
    /// The further trigger outputs, 2 to 4.
    pub outputs: [OutputStatus; 3],
    /// Longest time from an edge of these outputs or the pulse per second to the
    /// end of its handling since reset, in ticks.
    pub output_latency: u32,
    /// The pulse per second.
    pub gnss: GnssStatus,
}

/// Load for tests; the payload counts up from the low byte of `seq`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Filler {
    /// Sequence number of the filler stream.
    pub seq: u32,
    /// [`MAX_FILLER`] bytes, mostly.
    pub payload: Vec<u8, MAX_FILLER>,
}
