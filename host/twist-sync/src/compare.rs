//! Both gyroscopes side by side at an estimated relation, for plots and checks.

use nalgebra::{Matrix3, Vector3};

use crate::estimate::{Estimate, Options};
use crate::faults::{Action, Fault, FaultKind, Stream};
use crate::interpolant::{Uneven, Vec3};
use crate::track::GyroTrack;

/// The rate of a is not interpolated over longer times without a sample, seconds.
const LONGEST_GAP_S: f64 = 0.05;

/// A sample of b beside the rate of a at the same instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    /// Index of the sample of b.
    pub index: usize,
    /// Time of clock a, seconds.
    pub a_s: f64,
    /// The rate of a carried to the axes of b, rad/s.
    pub a: Vec3,
    /// The sample of b, rad/s.
    pub b: Vec3,
    /// True if the estimate used the sample of b.
    pub used: bool,
}

/// Marks the samples of a stream that were left out.
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

/// All samples of b for which the rate of a is known.
///
/// The rate of a is interpolated between samples without faults, those of stretches among
/// them in which the two were not one body; the samples of b are as recorded.
#[must_use]
pub fn pairs(a: &GyroTrack, b: &GyroTrack, estimate: &Estimate, options: &Options) -> Vec<Pair> {
    let faults = &estimate.report.faults;
    let is_of_a_stretch =
        |fault: &Fault| matches!(fault.kind, FaultKind::NotOneBody | FaultKind::Slipped);
    let of_samples = faults.iter().filter(|fault| !is_of_a_stretch(fault));
    let of_samples: Vec<Fault> = of_samples.cloned().collect();
    let a_out = left_out(&of_samples, Stream::A, a.len());
    let b_out = left_out(faults, Stream::B, b.len());
    let mut t: Vec<f64> = Vec::new();
    let mut w: Vec<Vec3> = Vec::new();
    for k in 0..a.len().min(a.w.len()) {
        if !a_out[k] && t.last().is_none_or(|&last| a.t[k] > last) {
            t.push(a.t[k]);
            w.push(a.w[k]);
        }
    }
    let Some(rates) = Uneven::new(&t, &w) else {
        return Vec::new();
    };
    let (first, last) = rates.domain();
    let matrix = Matrix3::from(estimate.calibration).transpose();
    let clock = &estimate.clock;
    // Relative to the epochs, so that no digits are lost.
    let a_epoch_s = a.epoch_s - options.a_delay_s;
    let b_epoch_s = b.epoch_s - options.b_delay_s;
    let reference = clock.reference - a_epoch_s;
    let shift = b_epoch_s - a_epoch_s - clock.offset;
    (0..b.len().min(b.w.len()))
        .filter_map(|k| {
            let at = reference + (b.t[k] + shift - reference) / (1.0 + clock.skew);
            let next = t.partition_point(|&x| x <= at).min(t.len() - 1);
            let is_near = t[next] - t[next.saturating_sub(1)] <= LONGEST_GAP_S;
            if !(first..=last).contains(&at) || !is_near {
                return None;
            }
            let rate = matrix * Vector3::from(rates.value(at)) + Vector3::from(estimate.bias);
            Some(Pair {
                index: k,
                a_s: a.epoch_s + at,
                a: rate.into(),
                b: b.w[k],
                used: !b_out[k],
            })
        })
        .collect()
}
