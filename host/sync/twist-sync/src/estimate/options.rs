//! Settings of an estimate.

use crate::clock::Wander;

/// Settings of [`estimate_offset`](crate::estimate_offset). The defaults suit a twist by hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// −3 dB frequency of the zero-phase low-pass, Hz.
    pub low_pass_hz: f64,
    /// Delay of the low-pass filter in gyroscope a, in seconds; it is subtracted from the
    /// timestamps.
    pub a_delay_s: f64,
    /// Delay of the low-pass filter in gyroscope b, in seconds; it is subtracted from the
    /// timestamps.
    pub b_delay_s: f64,
    /// Jump of a sawtooth that the timestamps of b are known to have, in seconds, as an earlier
    /// estimate reported it ([`FaultKind::TimestampSawtooth`](crate::FaultKind)); 0 if none is
    /// known. If it does not jump in these recordings, its uncertainty is part of the sigmas.
    pub b_jump_s: f64,
    /// True if stamps that are whole multiples of a decimal step (of 20 µs or more) are exact.
    /// Otherwise they count as cut or rounded to that step, half of which is part of the
    /// offset's sigma.
    pub exact_stamps: bool,
    /// Largest 1-sigma of the offset of an accepted estimate, in seconds.
    pub sigma_limit_s: f64,
    /// Least time that both recordings must have in common, in seconds.
    pub min_overlap_s: f64,
    /// True to find faults and leave them out; false only to see their effect.
    pub handle_faults: bool,
    /// Wander of the clocks, for the prediction from the result.
    pub wander: Wander,
    /// Centre and half-width of the range of the offset (b − a) in seconds, if it is known.
    pub search: Option<(f64, f64)>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            low_pass_hz: 25.0,
            a_delay_s: 0.0,
            b_delay_s: 0.0,
            b_jump_s: 0.0,
            exact_stamps: false,
            sigma_limit_s: 100e-6,
            min_overlap_s: 1.5,
            handle_faults: true,
            wander: Wander::default(),
            search: None,
        }
    }
}
