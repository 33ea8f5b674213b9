//! Comparison of each sample with its prediction from its neighbours: Lagrange interpolation
//! at the true times, three samples on each side.

use std::cmp::Ordering;

use super::interpolant::Vec3;
use crate::robust;

/// Neighbours on each side.
const SIDE: usize = 3;
/// A sample with its neighbours.
const NEAR: usize = 1 + 2 * SIDE;
/// Degrees of freedom of the prediction errors.
const FREEDOM: f64 = 4.0;
/// Predictions that count as one, since neighbours share samples: the sum of the squares of their
/// correlations, which at equal distances are `C(12, 6 + k) / C(12, 6)`.
const ALIKE: f64 = 3.17;
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
    /// Returns score and information about a displacement of the sample.
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
    /// Predicts each usable sample that has enough neighbours.
    pub(crate) fn predictions(self, usable: &[bool]) -> Vec<Against> {
        let kept = kept(usable);
        let mut out = Vec::with_capacity(kept.len());
        let slopes = self.slow_slopes(&kept).enumerate();
        out.extend(slopes.filter_map(|(at, slope)| self.predicted(&kept, at, None, slope)));
        out
    }

    /// Predicts the first sample of each pair without the second, and the second without the
    /// first.
    pub(crate) fn predictions_without(
        self,
        usable: &[bool],
        pairs: &[(usize, usize)],
    ) -> [Vec<Against>; 2] {
        let kept = kept(usable);
        let slopes: Vec<Vec3> = self.slow_slopes(&kept).collect();
        let predicted = |k: usize, partner: usize| {
            let at = kept.binary_search(&k).ok()?;
            self.predicted(&kept, at, Some(partner), slopes[at])
        };
        [
            pairs.iter().filter_map(|&(a, b)| predicted(a, b)).collect(),
            pairs.iter().filter_map(|&(a, b)| predicted(b, a)).collect(),
        ]
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
        // The nearest on each side must be close, and all six not far: across a gap the
        // prediction errs in proportion to the rate of any vibration.
        let close = |i: usize| (t[k] - t[i]).abs() < 2.6 * self.step_s;
        let length = t[near[2 * SIDE]] - t[near[SIDE]];
        if !close(near[1]) || !close(near[1 + SIDE]) || length > 4.0 * SIDE as f64 * self.step_s {
            return None;
        }
        // Sample minus prediction is the divided difference of all seven, up to a factor.
        let times = near.map(|n| t[n]);
        let mut products = [1.0; NEAR];
        for i in 0..NEAR {
            for j in 0..i {
                let apart = times[i] - times[j];
                products[i] *= apart;
                products[j] *= -apart;
            }
        }
        let weights = products.map(f64::recip);
        let gain: f64 = weights.iter().map(|weight| weight * weight).sum();
        let scale = weights[0].signum() / gain.sqrt();
        let mut error = [0.0; 3];
        for (weight, &n) in weights.iter().zip(&near) {
            for axis in 0..3 {
                error[axis] += scale * weight * w[n][axis];
            }
        }
        Some(Against {
            index: k,
            error,
            slope: slope.map(|slope| scale * weights[0] * slope),
        })
    }

    /// Rate of change of the slow part of the motion at each kept sample: the
    /// least-squares line over 15 ms (at least four samples) on either side.
    ///
    /// Slow on purpose: a vibration's own derivative would correlate with the
    /// prediction errors that the vibration makes, in step with every period that
    /// fits it.
    fn slow_slopes(self, kept: &[usize]) -> impl Iterator<Item = Vec3> {
        let (t, w) = (self.t, self.w);
        let reach_s = f64::max(0.015, 4.2 * self.step_s);
        let mut near = Near::default();
        let mut about = 0.0;
        let (mut from, mut to) = (0, 0);
        kept.iter().map(move |&k| {
            near.move_origin(t[k] - about);
            about = t[k];
            while t[kept[from]] < about - reach_s {
                near.count(-1.0, t[kept[from]] - about, &w[kept[from]]);
                from += 1;
            }
            if from == to {
                near = Near::default();
            }
            while to < kept.len() && t[kept[to]] <= about + reach_s {
                near.count(1.0, t[kept[to]] - about, &w[kept[to]]);
                to += 1;
            }
            near.slope()
        })
    }
}

/// Sums over the samples near a time, from which `x` is counted.
#[derive(Default)]
struct Near {
    n: f64,
    x: f64,
    xx: f64,
    w: Vec3,
    xw: Vec3,
}

impl Near {
    /// Adds a sample (`sign` 1) or removes it (−1).
    fn count(&mut self, sign: f64, x: f64, w: &Vec3) {
        self.n += sign;
        self.x += sign * x;
        self.xx += sign * x * x;
        for axis in 0..3 {
            self.w[axis] += sign * w[axis];
            self.xw[axis] += sign * x * w[axis];
        }
    }

    /// Moves the origin of `x` to a time that is later.
    fn move_origin(&mut self, later: f64) {
        self.xx += later * (self.n * later - 2.0 * self.x);
        self.x -= self.n * later;
        for axis in 0..3 {
            self.xw[axis] -= later * self.w[axis];
        }
    }

    /// Returns the slope of the least-squares line; 0 for a single sample.
    fn slope(&self) -> Vec3 {
        let centre = self.x / self.n;
        let spread = self.xx - centre * self.x;
        let scale = if spread > 0.0 { 1.0 / spread } else { 0.0 };
        std::array::from_fn(|axis| (self.xw[axis] - centre * self.w[axis]) * scale)
    }
}

/// Indices of the usable samples.
pub(crate) fn kept(usable: &[bool]) -> Vec<usize> {
    let mut kept = Vec::with_capacity(usable.len());
    kept.extend((0..usable.len()).filter(|&k| usable[k]));
    kept
}

/// Marks samples as not usable.
pub(crate) fn leave_out(usable: &mut [bool], samples: &[usize]) {
    for &k in samples {
        usable[k] = false;
    }
}

/// Returns `kept[at]` and the kept samples around it without `partner`, which is next to it:
/// those before it, then those after it, each the nearest first.
fn neighbours(kept: &[usize], at: usize, partner: Option<usize>) -> Option<[usize; NEAR]> {
    let before = at.saturating_sub(usize::from(kept[..at].last().copied() == partner));
    let after = at + 1 + usize::from(kept.get(at + 1).copied() == partner);
    if before < SIDE || after + SIDE > kept.len() {
        return None;
    }
    let mut near = [kept[at]; NEAR];
    for i in 0..SIDE {
        near[1 + i] = kept[before - 1 - i];
        near[1 + SIDE + i] = kept[after + i];
    }
    Some(near)
}

/// White noise of one sample, per axis.
pub(crate) fn noise_of(against: &[Against]) -> Vec3 {
    std::array::from_fn(|axis| {
        robust::mad_sigma_about_zero(against.iter().map(|a| a.error[axis]))
            .filter(|sigma| sigma.is_finite())
            .unwrap_or(0.0)
    })
}

/// Returns the logarithm by which the errors of the second predictions are likelier than those of
/// the first, over the samples that both predict. The density is Student's t, since taps and
/// faults err more than noise, with the mean of both variances around each sample.
pub(crate) fn better_ln(first: &[Against], second: &[Against]) -> f64 {
    let [mut ours, mut theirs] = [first, second].map(|against| {
        let noise = noise_of(against);
        let variances: Vec<Vec3> = local_variances(against, &noise).collect();
        against.iter().zip(variances).peekable()
    });
    let mut better = 0.0;
    while let (Some((one, _)), Some((other, _))) = (ours.peek(), theirs.peek()) {
        match one.index.cmp(&other.index) {
            Ordering::Less => drop(ours.next()),
            Ordering::Greater => drop(theirs.next()),
            Ordering::Equal => {
                let pair = ours.next().zip(theirs.next());
                better += pair.map_or(0.0, |((one, first), (other, second))| {
                    let axis = |axis: usize| {
                        let freedom = FREEDOM * 0.5 * (first[axis] + second[axis]);
                        let square = |against: &Against| against.error[axis].powi(2) / freedom;
                        0.5 * (FREEDOM + 1.0) * (square(one).ln_1p() - square(other).ln_1p())
                    };
                    axis(0) + axis(1) + axis(2)
                });
            }
        }
    }
    better / ALIKE
}

/// Variance of the prediction errors around each sample: the noise, or more
/// where the rig vibrates (from blocks of [`SCALE_BLOCK`] predictions, robust).
pub(crate) fn local_variances(against: &[Against], noise: &Vec3) -> impl Iterator<Item = Vec3> {
    against.chunks(SCALE_BLOCK).flat_map(|block| {
        let local = noise_of(block);
        let variance = |axis: usize| local[axis].max(noise[axis]).powi(2).max(1e-12);
        std::iter::repeat_n(std::array::from_fn(variance), block.len())
    })
}
