//! Requests of a family's registers to the sensor behind them.

use super::log::Values;
use crate::motion::inertial_channel::LowPass;
use stm32f4_sim::time::SimDuration;

/// Clock of the internal samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Source {
    /// Nothing, or nothing that is modelled.
    Stopped,
    /// The free-running oscillator.
    Internal,
    /// The PLL on the gyroscope.
    Pll,
    /// A PLL on the clock of this frequency at CLKIN (PA8).
    Reference(u64),
    /// Rising edges at CLKIN (PB0) in one internal sample.
    Edges(u64),
}

/// Filters and internal rates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SignalPath {
    /// Low-pass of the gyroscope.
    pub(super) gyro: LowPass,
    /// Low-pass of the accelerometer.
    pub(super) accel: LowPass,
    /// Internal samples of the gyroscope a second, nominally.
    pub(super) gyro_hz: u64,
    /// Internal samples of the accelerometer a second, nominally.
    pub(super) accel_hz: u64,
}

/// Settings of the measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Measuring {
    pub(super) awake: bool,
    pub(super) source: Source,
    pub(super) path: SignalPath,
    /// Number of internal samples in one registered sample.
    pub(super) divider: u64,
    pub(super) gyro_counts_per_dps: f64,
    pub(super) accel_counts_per_g: f64,
    /// Axes that are off: x, y, z.
    pub(super) gyro_off: [bool; 3],
    pub(super) accel_off: [bool; 3],
    /// Counts per °C, and °C at zero; nothing while the thermometer is off.
    pub(super) thermometer: Option<(f64, f64)>,
}

/// Behaviour of the interrupt pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct InterruptPin {
    /// Data-ready drives it.
    pub(super) data_ready: bool,
    pub(super) active_high: bool,
    pub(super) open_drain: bool,
    /// Length of its pulse; nothing if it is held until it is cleared.
    pub(super) pulse: Option<SimDuration>,
}

/// Consequences of a write.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Stored {
    /// The sensor resets itself.
    pub(super) reset: bool,
    /// The signal paths are cleared.
    pub(super) clear: bool,
    /// The value asks for something that the model ignores.
    pub(super) ignored: bool,
}

/// The registers of a family.
pub(super) trait RegisterMap: core::fmt::Debug + Send {
    /// Values as after power-on.
    fn reset(&mut self);

    fn measuring(&self) -> Measuring;

    fn interrupt(&self) -> InterruptPin;

    /// A register as a master reads it; `data` are the bytes of the sample that it sees.
    fn peek(&self, register: u8, data: &[u8; 14]) -> u8;

    /// A master writes a register.
    fn store(&mut self, register: u8, value: u8) -> Stored;

    /// Next address after an access.
    fn after(&self, register: u8) -> u8;

    /// The sample's bytes, in the order of their registers.
    fn bytes(&self, values: &Values) -> [u8; 14];

    /// The same before the first sample.
    fn no_data(&self) -> [u8; 14];

    /// Sets or clears data-ready in the status register.
    fn set_ready(&mut self, ready: bool);

    /// True if reading a register clears data-ready.
    fn clears(&self, register: u8) -> bool;

    /// True if a write selects the clock at CLKIN.
    fn selects_clock(&self, register: u8, value: u8) -> bool;
}
