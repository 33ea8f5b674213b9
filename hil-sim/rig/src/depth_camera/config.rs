//! Properties of a depth camera, as plain data.

use crate::clocks::oscillator::OscillatorConfig;
use crate::picture::rolling_shutter::FlashTrain;
use crate::wiring;
use stm32f4_sim::time::SimDuration;

/// Longest pulse that does not count (Azure Kinect: it needs more than 8 µs).
pub(super) const PULSE_TOO_SHORT: SimDuration = SimDuration::from_micros(8);

/// Largest deviation from its expected time at which a pulse disturbs nothing.
pub(super) const TOLERANCE: SimDuration = SimDuration::from_micros(200);

/// Frames that are bad after a disturbance, the one disturbed included.
pub(super) const BAD_FRAMES: u32 = 3;

/// Depth modes with their flashes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DepthMode {
    /// Narrow field of view, unbinned: up to 30 fps.
    NfovUnbinned,
    /// No flashes of its own, but a shutter: one exposure of this length.
    Shutter {
        /// Time for which it is open.
        exposure: SimDuration,
    },
}

impl DepthMode {
    /// The infrared flashes of one frame.
    #[must_use]
    pub fn flashes(self) -> FlashTrain {
        match self {
            Self::NfovUnbinned => FlashTrain::NFOV,
            Self::Shutter { exposure } => FlashTrain {
                count: 1,
                pitch_ns: 0,
                duration_ns: exposure.as_nanos() as i64,
            },
        }
    }
}

/// Properties of a depth camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthCameraConfig {
    /// Depth mode.
    pub mode: DepthMode,
    /// Longest pulse that does *not* count.
    pub shortest_pulse: SimDuration,
    /// True if it continues by itself when the pulses stop; other cameras wait for each pulse.
    pub free_runs: bool,
    /// The pulse that makes the first frame: 2 or 3 on real cameras.
    pub first_frame: u32,
    /// From a pulse's rising edge to the first flash, in the camera's time.
    pub flash_delay: SimDuration,
    /// Jitter of that, 1-sigma. At most three of it, and no flash before the camera knows
    /// that no pulse comes.
    pub flash_jitter: SimDuration,
    /// The camera's clock. Its offset is what the device timestamp starts from.
    pub clock: OscillatorConfig,
    /// The device timestamp counts from the first pulse, not from the clock's offset.
    pub zeroed_at_first_pulse: bool,
    /// Probability that a frame is lost on its way to the computer.
    pub drop_probability: f64,
    /// Number of frames that are lost at a time.
    pub dropped_at_once: u32,
    /// Probability that a frame's image is spoilt without a known reason.
    pub spoil_probability: f64,
    /// From the begin of a flash to the photodiode's rising edge, and from its end to the
    /// falling one: rise times against the threshold of the input.
    pub photodiode_delay: (SimDuration, SimDuration),
    /// True if the photodiode is wired to the strobe input.
    pub photodiode: bool,
    /// Voltage from which the input of the board's output is high: the gate, or without one
    /// the camera itself, which wants 3.5 (SDK #1844).
    pub input_high: f64,
}

impl DepthCameraConfig {
    /// Frames a second.
    pub const FPS: u32 = 30;
}

impl Default for DepthCameraConfig {
    /// Returns a camera in NFOV unbinned at 30 fps, 300 ppm fast, whose first frame comes on pulse
    /// 2.
    fn default() -> Self {
        Self {
            mode: DepthMode::NfovUnbinned,
            shortest_pulse: PULSE_TOO_SHORT,
            free_runs: true,
            first_frame: 2,
            flash_delay: SimDuration::from_micros(500),
            flash_jitter: SimDuration::ZERO,
            clock: OscillatorConfig {
                offset_ns: 2_500_000_000,
                rate_ppm: 300.0,
                wander: 1e-9,
                ..OscillatorConfig::default()
            },
            zeroed_at_first_pulse: false,
            drop_probability: 0.0,
            dropped_at_once: 1,
            spoil_probability: 0.0,
            photodiode_delay: (SimDuration::ZERO, SimDuration::ZERO),
            photodiode: true,
            input_high: wiring::GATE_HIGH,
        }
    }
}

impl DepthCameraConfig {
    /// From a pulse's rising edge to the centre of exposure, in the camera's time, ns.
    #[must_use]
    pub fn center_delay_ns(&self) -> f64 {
        self.flash_delay.as_nanos() as f64 + self.mode.flashes().center_offset_ns() as f64
    }

    /// Returns the time from a pulse, or its expected time, to the decision of whether it came.
    pub(super) fn earliest_flash(&self) -> SimDuration {
        TOLERANCE + self.shortest_pulse + SimDuration::from_micros(1)
    }
}
