//! The faults of one run, drawn from its seed.

use serde::Serialize;

use rig::random::{Random, Seed, Stream, log_uniform};
use stm32f4_sim::time::{SimDuration, SimTime};

/// A fault. Those with an end last for the length of their [`Event`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize)]
pub enum Fault {
    /// The USB cable is pulled and put back.
    UsbUnplugged,
    /// The host's computer takes nothing from the bus.
    HostStalled,
    /// Bits flip on the way from the board.
    CorruptedFromBoard,
    /// Bits flip on the way to the board.
    CorruptedToBoard,
    /// SDA is held low.
    I2cHeld,
    /// The IMU has no power.
    ImuPowerCut,
    /// The wire of the IMU's clock is cut.
    ImuClockCut,
    /// 100 kHz on the strobe input.
    StrobeFlooded,
    /// The host program is killed: judged by the files as they are at that moment.
    HostKilled,
    /// The depth camera stops.
    DepthCameraStopped,
    /// The board's reset button is pressed.
    ResetPressed,
    /// A task of the board hangs until the watchdog resets it.
    WatchdogReset,
    /// The supply of board and IMU fails and comes back.
    SupplyReset,
    /// The host's time of day is set, by hours.
    HostClockStepped,
    /// The phone leaves the network.
    PhoneGone,
    /// The phone is on the network and nothing goes through.
    WifiStalled,
}

impl Fault {
    /// All of them.
    pub const ALL: [Self; 16] = [
        Self::DepthCameraStopped,
        Self::UsbUnplugged,
        Self::HostStalled,
        Self::CorruptedFromBoard,
        Self::I2cHeld,
        Self::ImuPowerCut,
        Self::ImuClockCut,
        Self::StrobeFlooded,
        Self::HostKilled,
        Self::WatchdogReset,
        Self::SupplyReset,
        Self::HostClockStepped,
        Self::PhoneGone,
        Self::WifiStalled,
        Self::ResetPressed,
        Self::CorruptedToBoard,
    ];

    /// Returns true if it makes the board begin a new run.
    #[must_use]
    pub(crate) const fn is_reset(self) -> bool {
        matches!(
            self,
            Self::ResetPressed | Self::WatchdogReset | Self::SupplyReset
        )
    }

    /// Returns true if it takes the phone away. The session may end earlier.
    #[must_use]
    pub(crate) const fn is_of_phone(self) -> bool {
        matches!(self, Self::PhoneGone | Self::WifiStalled)
    }

    /// Returns true if it costs the recording nothing.
    #[must_use]
    pub(crate) const fn is_harmless(self) -> bool {
        matches!(
            self,
            Self::HostKilled | Self::DepthCameraStopped | Self::HostClockStepped
        ) || self.is_of_phone()
    }

    /// Returns true if it costs samples of the IMU.
    #[must_use]
    pub(crate) const fn hits_imu(self) -> bool {
        matches!(self, Self::I2cHeld | Self::ImuPowerCut | Self::ImuClockCut)
    }

    /// Shortest and longest duration in ms; `None` if it has no end.
    const fn lasts(self) -> Option<(u64, u64)> {
        match self {
            Self::UsbUnplugged => Some((50, 8_000)),
            Self::HostStalled => Some((200, 20_000)),
            Self::CorruptedFromBoard | Self::CorruptedToBoard => Some((500, 5_000)),
            Self::I2cHeld | Self::ImuPowerCut => Some((5, 4_000)),
            Self::ImuClockCut | Self::StrobeFlooded => Some((100, 4_000)),
            Self::DepthCameraStopped => Some((500, 5_000)),
            Self::PhoneGone | Self::WifiStalled => Some((500, 20_000)),
            Self::HostKilled
            | Self::ResetPressed
            | Self::WatchdogReset
            | Self::SupplyReset
            | Self::HostClockStepped => None,
        }
    }
}

/// A fault with its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Event {
    /// Kind of the fault.
    pub fault: Fault,
    /// Time after the recording began, in µs.
    pub at_us: u64,
    /// Duration, in µs; 0 if it has no end.
    pub for_us: u64,
}

impl Event {
    /// Begin, of a recording that began at `zero`.
    #[must_use]
    pub fn begins(&self, zero: SimTime) -> SimTime {
        zero + SimDuration::from_micros(self.at_us)
    }

    /// End; the begin if it has none.
    #[must_use]
    pub fn ends(&self, zero: SimTime) -> SimTime {
        zero + SimDuration::from_micros(self.at_us + self.for_us)
    }
}

/// A run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Plan {
    /// Its seed.
    pub seed: u64,
    /// Faults in the order of their begin.
    pub events: Vec<Event>,
    /// Length of the recording if nothing ends it, in µs.
    pub length_us: u64,
    /// Damaged bytes in a million, where bytes are damaged.
    pub corruption_ppm: u32,
    /// Change of the host's time of day, s.
    pub clock_step_s: i64,
}

/// Rest of a recording after the last fault, in ms: 1 s for the watch
/// to notice, 8 s for a link to come back, an IMU to be set up again, and a
/// status.
const QUIET_MS: u64 = 9_000;

impl Plan {
    /// Draws one to four faults. At most one of them resets the board, and
    /// nothing comes after it but what had begun.
    #[must_use]
    pub fn draw(seed: Seed) -> Self {
        let mut random = seed.stream(Stream::Test);
        // Every fault leads in turn, so that few seeds try all of them.
        let first = Fault::ALL[(seed.0 % Fault::ALL.len() as u64) as usize];
        let mut faults = vec![first];
        for _ in 0..random.bits() % 4 {
            let fault = *random.one_of(&Fault::ALL);
            let again = faults
                .iter()
                .any(|f| *f == fault || f.is_reset() && fault.is_reset());
            if !again {
                faults.push(fault);
            }
        }
        let mut events: Vec<Event> = faults
            .into_iter()
            .map(|fault| Self::place(fault, &mut random))
            .collect();
        events.sort_by_key(|event| event.at_us);
        let end = |event: &Event| {
            if event.fault.is_of_phone() {
                event.at_us
            } else {
                event.at_us + event.for_us
            }
        };
        let last = events.iter().map(end).max();
        let hours = 1 + (random.bits() % 12) as i64;
        let clock_step_s = if random.bits().is_multiple_of(2) {
            hours * 3_600
        } else {
            hours * -3_600
        };
        Self {
            seed: seed.0,
            events,
            length_us: last.unwrap_or(0) + QUIET_MS * 1000,
            corruption_ppm: 100 + (random.bits() % 2_000) as u32,
            clock_step_s,
        }
    }

    fn place(fault: Fault, random: &mut Random) -> Event {
        let for_us = fault.lasts().map_or(0, |(shortest, longest)| {
            // As many short ones as long ones.
            let ms = log_uniform(random, (shortest as f64, longest as f64));
            (ms * 1000.0) as u64
        });
        Event {
            fault,
            at_us: 2_000_000 + random.bits() % 10_000_000,
            for_us,
        }
    }

    /// Returns true if one of the faults is `fault`.
    #[must_use]
    pub fn has(&self, fault: Fault) -> bool {
        self.events.iter().any(|event| event.fault == fault)
    }

    /// Returns true if a fault is present at a time, in a recording that began at `zero`.
    pub(crate) fn is_active(&self, fault: Fault, zero: SimTime, now: SimTime) -> bool {
        let is_now = |event: &Event| event.begins(zero) <= now && now < event.ends(zero);
        let mut events = self.events.iter();
        events.any(|event| event.fault == fault && is_now(event))
    }

    /// Returns true if the board is reset.
    #[must_use]
    pub(crate) fn resets(&self) -> bool {
        self.events.iter().any(|event| event.fault.is_reset())
    }
}

impl core::fmt::Display for Plan {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "seed {}:", self.seed)?;
        for event in &self.events {
            write!(f, " {:?} at {:.6} s", event.fault, event.at_us as f64 / 1e6)?;
            if event.for_us > 0 {
                write!(f, " for {:.6} s", event.for_us as f64 / 1e6)?;
            }
            write!(f, ",")?;
        }
        write!(f, " {:.3} s in all", self.length_us as f64 / 1e6)
    }
}
