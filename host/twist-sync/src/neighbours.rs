//! Each sample against the prediction from its neighbours: Lagrange interpolation
//! at the true times, three samples on each side.

use crate::interpolant::Vec3;
use crate::robust;

/// Neighbours on each side.
const SIDE: usize = 3;
/// Predictions in a block whose scatter is judged together.
const SCALE_BLOCK: usize = 64;

/// The samples of one stream.
#[derive(Clone, Copy)]
pub(crate) struct Samples<'a> {
    pub(crate) t: &'a [f64],
    pub(crate) w: &'a [Vec3],
    /// Typical distance in seconds.
    pub(crate) step_s: f64,
}

/// A sample against the prediction from its neighbours.
#[derive(Clone, Copy)]
pub(crate) struct Against {
    pub(crate) index: usize,
    /// Sample minus prediction, scaled to the noise of one sample.
    error: Vec3,
    /// Rate of change, scaled likewise.
    slope: Vec3,
}

impl Against {
    /// Contribution to a displacement: score and information.
    pub(crate) fn score(&self, variance: &Vec3) -> (f64, f64) {
        let (mut score, mut information) = (0.0, 0.0);
        for axis in 0..3 {
            let variance = variance[axis];
            score -= self.error[axis] * self.slope[axis] / variance;
            information += self.slope[axis] * self.slope[axis] / variance;
        }
        (score, information)
    }
}

impl Samples<'_> {
    /// Predicts each usable sample that has its neighbours.
    pub(crate) fn predictions(self, usable: &[bool]) -> Vec<Against> {
        let kept = kept(usable);
        let slopes = self.slow_slopes(&kept);
        (0..kept.len())
            .filter_map(|at| self.predicted(&kept, at, None, slopes[at]))
            .collect()
    }

    /// Predicts the first sample of each pair without the help of the second.
    pub(crate) fn predictions_without(
        self,
        usable: &[bool],
        pairs: &[(usize, usize)],
    ) -> Vec<Against> {
        let kept = kept(usable);
        let slopes = self.slow_slopes(&kept);
        pairs
            .iter()
            .filter_map(|&(first, second)| {
                let at = kept.binary_search(&first).ok()?;
                self.predicted(&kept, at, Some(second), slopes[at])
            })
            .collect()
    }

    fn predicted(
        self,
        kept: &[usize],
        at: usize,
        partner: Option<usize>,
        slope: Vec3,
    ) -> Option<Against> {
        let near = neighbours(kept, at, partner)?;
        let (t, w, k) = (self.t, self.w, kept[at]);
        // The nearest on each side close, all six not far: across a gap the
        // prediction errs in proportion to the rate of any vibration.
        let close = |i: usize| (t[k] - t[i]).abs() < 2.6 * self.step_s;
        let length = t[near[2 * SIDE - 1]] - t[near[SIDE - 1]];
        if !close(near[0]) || !close(near[SIDE]) || length > 4.0 * SIDE as f64 * self.step_s {
            return None;
        }
        let mut predicted = [0.0; 3];
        let mut gain = 1.0;
        for (i, &n) in near.iter().enumerate() {
            let (mut above, mut below) = (1.0, 1.0);
            for (j, &m) in near.iter().enumerate() {
                if i != j {
                    above *= t[k] - t[m];
                    below *= t[n] - t[m];
                }
            }
            let weight = above / below;
            gain += weight * weight;
            for axis in 0..3 {
                predicted[axis] += weight * w[n][axis];
            }
        }
        let scale = 1.0 / gain.sqrt();
        Some(Against {
            index: k,
            error: std::array::from_fn(|axis| scale * (w[k][axis] - predicted[axis])),
            slope: slope.map(|slope| scale * slope),
        })
    }

    /// Rate of change of the slow part of the motion at each kept sample: the
    /// least-squares line over 15 ms (at least four samples) on either side.
    ///
    /// Slow on purpose: a vibration's own derivative would correlate with the
    /// prediction errors that the vibration makes, in step with every period that
    /// fits it.
    fn slow_slopes(self, kept: &[usize]) -> Vec<Vec3> {
        let (t, w) = (self.t, self.w);
        let reach_s = f64::max(0.015, 4.2 * self.step_s);
        let (mut from, mut to) = (0, 0);
        kept.iter()
            .map(|&k| {
                while t[kept[from]] < t[k] - reach_s {
                    from += 1;
                }
                while to < kept.len() && t[kept[to]] <= t[k] + reach_s {
                    to += 1;
                }
                let near = &kept[from..to];
                let n = near.len() as f64;
                let centre = near.iter().map(|&i| t[i] - t[k]).sum::<f64>() / n;
                let mut spread = 0.0;
                let mut slope = [0.0; 3];
                for &i in near {
                    let x = t[i] - t[k] - centre;
                    spread += x * x;
                    for axis in 0..3 {
                        slope[axis] += x * (w[i][axis] - w[k][axis]);
                    }
                }
                slope.map(|s| if spread > 0.0 { s / spread } else { 0.0 })
            })
            .collect()
    }
}

/// Indices of the usable samples.
pub(crate) fn kept(usable: &[bool]) -> Vec<usize> {
    (0..usable.len()).filter(|&k| usable[k]).collect()
}

/// Marks samples as not to be used.
pub(crate) fn leave_out(usable: &mut [bool], samples: &[usize]) {
    for &k in samples {
        usable[k] = false;
    }
}

/// The kept samples around `kept[at]` without `partner`: before it, then after
/// it, each the nearest first.
fn neighbours(kept: &[usize], at: usize, partner: Option<usize>) -> Option<[usize; 2 * SIDE]> {
    let other = |k: &usize| Some(*k) != partner;
    let before = kept[..at].iter().rev().copied().filter(other).take(SIDE);
    let after = kept[at + 1..].iter().copied().filter(other).take(SIDE);
    let mut near = [0; 2 * SIDE];
    let mut found = 0;
    for k in before.chain(after) {
        near[found] = k;
        found += 1;
    }
    (found == near.len()).then_some(near)
}

/// White noise of one sample, per axis.
pub(crate) fn noise_of(against: &[Against]) -> Vec3 {
    std::array::from_fn(|axis| {
        let errors: Vec<f64> = against.iter().map(|a| a.error[axis]).collect();
        robust::mad_sigma(&errors)
            .filter(|sigma| sigma.is_finite())
            .unwrap_or(0.0)
    })
}

/// Variance of the prediction errors around each sample: the noise, or more
/// where the rig vibrates (from blocks of [`SCALE_BLOCK`] predictions, robust).
pub(crate) fn local_variances(against: &[Against], noise: &Vec3) -> Vec<Vec3> {
    let mut out = Vec::with_capacity(against.len());
    for block in against.chunks(SCALE_BLOCK) {
        let local = noise_of(block);
        let variance: Vec3 =
            std::array::from_fn(|axis| local[axis].max(noise[axis]).powi(2).max(1e-12));
        out.extend(std::iter::repeat_n(variance, block.len()));
    }
    out
}
