//! Both gyroscopes side by side at an estimated relation, for plots and checks.

use nalgebra::{Matrix3, Vector3};

use super::estimate::{Estimate, Options};
use super::faults::{Action, Fault, Stream};
use super::spline::{Spline, Vec3};
use super::track::GyroTrack;

/// A sample of the phone beside the board's rate at the same instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    /// Index of the phone's sample.
    pub index: usize,
    /// Board time, seconds.
    pub board_s: f64,
    /// The phone's sample, rad/s.
    pub phone: Vec3,
    /// The board's rate carried to the phone's axes, rad/s.
    pub mcu: Vec3,
    /// Whether the estimate used the phone's sample.
    pub used: bool,
}

/// Which samples of a stream were left out.
#[must_use]
pub fn left_out(faults: &[Fault], stream: Stream, samples: usize) -> Vec<bool> {
    let mut out = vec![false; samples];
    for fault in faults {
        if fault.stream == stream && fault.action == Action::LeftOut {
            for &k in &fault.samples {
                if let Some(flag) = out.get_mut(k) {
                    *flag = true;
                }
            }
        }
    }
    out
}

/// All samples of the phone for which the board's rate is known.
///
/// The board's rate is interpolated between the samples that were used; the
/// phone's samples are as recorded.
#[must_use]
pub fn pairs(
    mcu: &GyroTrack,
    phone: &GyroTrack,
    estimate: &Estimate,
    options: &Options,
) -> Vec<Pair> {
    let faults = &estimate.report.faults;
    let mcu_out = left_out(faults, Stream::Mcu, mcu.len());
    let phone_out = left_out(faults, Stream::Phone, phone.len());
    let mut t: Vec<f64> = Vec::new();
    let mut w: Vec<Vec3> = Vec::new();
    for k in 0..mcu.len().min(mcu.w.len()) {
        if !mcu_out[k] && t.last().is_none_or(|&last| mcu.t[k] > last) {
            t.push(mcu.t[k]);
            w.push(mcu.w[k]);
        }
    }
    let Some(spline) = Spline::interpolate(&t, &w, 3) else {
        return Vec::new();
    };
    let (first, last) = spline.domain();
    let c = &estimate.calibration;
    let matrix = Matrix3::from_fn(|row, column| c[row][column]);
    let clock = &estimate.clock;
    (0..phone.len().min(phone.w.len()))
        .filter_map(|k| {
            // Relative to the epochs, so that no digits are lost.
            let reference = clock.reference - (mcu.epoch_s - options.mcu_delay_s);
            let shift = (phone.epoch_s - options.phone_delay_s)
                - (mcu.epoch_s - options.mcu_delay_s)
                - clock.offset;
            let at = reference + (phone.t[k] + shift - reference) / (1.0 + clock.skew);
            if !(first..=last).contains(&at) {
                return None;
            }
            let rate = matrix * Vector3::from(spline.value(at)) + Vector3::from(estimate.bias);
            Some(Pair {
                index: k,
                board_s: mcu.epoch_s + at,
                phone: phone.w[k],
                mcu: rate.into(),
                used: !phone_out[k],
            })
        })
        .collect()
}
