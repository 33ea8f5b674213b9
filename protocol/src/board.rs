//! The board itself: identity, end of its last run, settings and overall status.

use heapless::String;
use serde::{Deserialize, Serialize};

use crate::framing::LinkCounters;
use crate::gnss::GnssStatus;
use crate::imu::ImuStatus;
use crate::trigger::{OutputStatus, TriggerStatus};
use crate::units::Ticks;

/// The longest text of a last panic, in bytes; longer ones are cut.
pub const MAX_PANIC: usize = 128;

/// The core's clock, in Hz.
pub const CORE_HZ: u32 = 96_000_000;

/// Identity of the board and end of its last run.
///
/// `protocol_version` stays the first field of the first variant for ever.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Hello {
    /// [`crate::PROTOCOL_VERSION`] of the firmware.
    pub protocol_version: u16,
    /// Version of the firmware: major, minor, patch.
    pub firmware_version: (u8, u8, u8),
    /// First 12 hex digits of the git revision, empty if unknown.
    pub git_revision: String<12>,
    /// The work tree had changes when the firmware was built.
    pub git_dirty: bool,
    /// The MCU's unique device ID (RM0090 39.1, RM0383 24.1).
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
    /// Which board it is.
    pub board: BoardModel,
    /// Panics and faults of all runs, also before power was last off.
    pub panics: u32,
    /// Message of the newest of them.
    pub kept_panic: Option<String<MAX_PANIC>>,
}

/// Properties in which specimens of one board differ, kept in the board's flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct BoardSettings {
    /// Delay of TIM1's start after TIM2's, in clocks of TIM1 (96 MHz), at most
    /// [`MAX_START_DELAY`].
    pub output_start_delay: u8,
    /// From an edge at a capture input to its capture, in ticks, at most
    /// [`MAX_INPUT_DELAY`]; taken off where the time of a capture is stated.
    pub input_delay: u8,
    /// The crystal against a clock that was trusted when it was measured, in 10⁻⁹ (fast is
    /// positive). For information only; no time is corrected by it.
    pub crystal_ppb: Option<i32>,
}

/// Most of [`BoardSettings::output_start_delay`].
pub const MAX_START_DELAY: u8 = 32;

/// Most of [`BoardSettings::input_delay`].
pub const MAX_INPUT_DELAY: u8 = 32;

/// Most of [`BoardSettings::crystal_ppb`], either way: 1,000 ppm.
pub const MAX_CRYSTAL_PPB: u32 = 1_000_000;

/// Beginning of a text that is somewhere in the image of each firmware. Behind it come the
/// board's [`BoardModel::key`], version and git revision, each with a semicolon after it.
pub const IMAGE_MARK: &str = "SmartDepthSync image;";

/// A board that the firmware is built for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum BoardModel {
    /// STM32F4DISCOVERY (STM32F407VG).
    #[default]
    Discovery,
    /// WeAct Black Pill (STM32F411CE): no auxiliary outputs, nothing for a lidar.
    BlackPill,
}

impl BoardModel {
    /// Returns the maker's name of it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Discovery => "STM32F4DISCOVERY",
            Self::BlackPill => "WeAct Black Pill (STM32F411CE)",
        }
    }

    /// Returns the text that follows [`IMAGE_MARK`] in a firmware's image for this board.
    #[must_use]
    pub const fn key(self) -> &'static str {
        match self {
            Self::Discovery => "discovery",
            Self::BlackPill => "black-pill",
        }
    }

    /// The board with this key.
    #[must_use]
    pub fn from_key(key: &str) -> Option<Self> {
        [Self::Discovery, Self::BlackPill]
            .into_iter()
            .find(|board| board.key() == key)
    }

    /// Returns true if the board has the auxiliary outputs, 2 to 4, and the pulse per second with
    /// its sentences.
    #[must_use]
    pub const fn has_outputs(self) -> bool {
        match self {
            Self::Discovery => true,
            Self::BlackPill => false,
        }
    }
}

/// From the reset flags of RCC_CSR (RM0090 7.3.21).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
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
    /// None of these flags was set.
    #[default]
    Unknown,
}

impl ResetCause {
    /// Number of causes.
    pub const COUNT: usize = Self::Unknown as usize + 1;
}

/// Once a second.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// Sequence number of the status stream.
    pub seq: u32,
    /// Board time, which is also the uptime.
    pub at: Ticks,
    /// As in [`Hello::epoch`].
    pub epoch: u32,
    /// Messages dropped since reset.
    pub dropped: Dropped,
    /// Frames received from the host.
    pub link: LinkCounters,
    /// Number of times that a host has connected.
    pub connects: u32,
    /// Time not spent asleep over the last second, in 1/1000.
    pub cpu_permille: u16,
    /// Most stack ever used, in bytes (measured by paint: exact to a frame that
    /// leaves a kilobyte of itself unwritten).
    pub stack_used: u32,
    /// Stack there is, in bytes.
    pub stack_size: u32,
    /// The camera's train.
    pub trigger: TriggerStatus,
    /// Longest time from a trigger edge to the end of its handler since reset,
    /// in ticks.
    pub trigger_latency: u32,
    /// Run times of the interrupt handlers.
    pub handlers: Handlers,
    /// Longest times for which interrupts were masked.
    pub masked: Masked,
    /// Temperature of the chip, in 0.1 °C; `None` before it was first measured.
    pub die_decidegrees: Option<i16>,
    /// The chip's supply, in mV; `None` before it was first measured.
    pub supply_mv: Option<u16>,
    /// Events on the USB.
    pub usb: UsbCounters,
    /// Resets since power came on, by [`ResetCause`] in its order. They saturate.
    pub resets: [u8; ResetCause::COUNT],
    /// Losses of edges on the strobe input (over-captures of TIM2 channel 3).
    pub strobe_overcaptures: u32,
    /// Number of times that the strobe input was switched off for a while because its edges came
    /// faster than the board handles them.
    pub strobe_floods: u32,
    /// The IMU.
    pub imu: ImuStatus,
    /// The auxiliary trigger outputs, 2 to 4.
    pub outputs: [OutputStatus; 3],
    /// Longest time from an edge of these outputs or the pulse per second to the
    /// end of its handling since reset, in ticks.
    pub output_latency: u32,
    /// The pulse per second.
    pub gnss: GnssStatus,
}

/// Counts of events on the USB since the board's reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct UsbCounters {
    /// Resets by the host.
    pub resets: u32,
    /// Suspends by the host, or of a bus without traffic.
    pub suspends: u32,
    /// Restarts of the core because it did not send any more.
    pub stuck: u32,
    /// Restarts of the core because a host had reset the bus and set no configuration.
    pub unconfigured: u32,
}

/// Run time of one handler, by the core's cycle counter, at [`CORE_HZ`]. The time of a handler
/// includes that of others that interrupted it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct HandlerTime {
    /// Calls over the last second.
    pub calls: u32,
    /// Cycles of all these calls.
    pub cycles: u32,
    /// Cycles of the longest call since reset.
    pub worst: u32,
}

impl HandlerTime {
    /// Cycles of a call over the last second, in the mean; 0 without one.
    #[must_use]
    pub const fn mean(&self) -> u32 {
        match self.cycles.checked_div(self.calls) {
            Some(mean) => mean,
            None => 0,
        }
    }
}

/// Run times of the interrupt handlers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Handlers {
    /// The camera's trigger and the captures (TIM2, DMA1 stream 5).
    pub trigger: HandlerTime,
    /// The auxiliary outputs and the pulse per second (TIM1, TIM5).
    pub outputs: HandlerTime,
    /// The handler that passes their events to the outbox.
    pub handover: HandlerTime,
    /// USB.
    pub usb: HandlerTime,
}

/// The longest time for which interrupts were masked since reset, in cycles of [`CORE_HZ`].
/// Handlers that ran meanwhile are part of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Masked {
    /// All of them, by a task, while no edge of the trigger was due.
    pub all: u32,
    /// All below the trigger's and the outputs', or below the trigger's alone.
    pub below_trigger: u32,
}

/// Number of messages of each stream that found no place in the outbox.
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
    /// Pulses of the auxiliary outputs, and pulses per second.
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
