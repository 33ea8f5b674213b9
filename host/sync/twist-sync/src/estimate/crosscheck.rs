//! Faults that show against the other gyroscope.
//!
//! Once the streams are related, each sample of one can be compared with the
//! smooth rate of the other. The comparison is between unlike things on
//! purpose: the smooth signal dilutes a fault of *its* stream to a quarter, while
//! the raw sample shows its own at full height, so a fault is attributed to the
//! right stream.
//!
//! Slow differences (filters, nonlinearity, flexing) are not faults of samples;
//! the local median of the difference is subtracted before judging.

use nalgebra::{DMatrix, DVector, Matrix2, Matrix3, Vector2, Vector3};

use super::calibration::Calibration;
use super::coarse::Usable;
use super::fit::{Fit, Part};
use crate::robust;
use crate::signal::Signal;

/// A sample is an outlier beyond this many sigmas (length of the whitened vector).
const OUTLIER_SIGMA: f64 = 6.0;
/// Least scatter that is assumed, rad/s: below any real gyroscope's noise, above
/// what the filter leaves of fast motion in a noiseless simulation.
const LEAST_NOISE: f64 = 1e-4;
/// Samples of a block for the local scale.
const SCALE_BLOCK: usize = 48;

/// A sample that does not fit the other stream.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Misfit {
    /// Its index in the recording.
    pub(crate) index: usize,
    /// Distance in standard deviations (length of the whitened vector).
    pub(crate) sigmas: f64,
}

/// Samples of a stream that do not fit to the smooth rate of the other, whose noise in that
/// has the 1-sigma `noise_of_other`, rad/s.
///
/// `other_time` carries this stream's time to the other's, `calibration` the
/// other's rate to this one's axes. The scale is local: where the rig is knocked
/// or vibrates, differences between the filters are no faults.
pub(crate) fn outliers(
    (t, w, usable): Usable<'_>,
    other: &Signal,
    noise_of_other: f64,
    other_time: impl Fn(f64) -> f64,
    calibration: &Calibration,
) -> Vec<Misfit> {
    let mut index = Vec::with_capacity(t.len());
    let mut difference = [(); 3].map(|()| Vec::with_capacity(t.len()));
    for k in (0..t.len()).filter(|&k| usable[k]) {
        if let Some(x) = other.value(other_time(t[k])) {
            let predicted = calibration.matrix * Vector3::from(x) + calibration.bias;
            index.push(k);
            for axis in 0..3 {
                difference[axis].push(w[k][axis] - predicted[axis]);
            }
        }
    }
    if index.len() < 2 * SCALE_BLOCK {
        return Vec::new();
    }
    let contrasts = difference.map(|axis| robust::without_local_median(&axis));
    // The noise of the other, which is smooth, hardly shows in the median of the contrasts.
    let scale_of = |part: &[f64]| {
        let own = robust::mad_sigma_about_zero(part.iter().copied()).unwrap_or(0.0);
        own.hypot(noise_of_other).max(LEAST_NOISE)
    };
    let overall = contrasts.each_ref().map(|contrast| scale_of(contrast));
    let sigmas = |k: usize| {
        let squares = (0..3).map(|axis| (contrasts[axis][k] / overall[axis]).powi(2));
        squares.sum::<f64>().sqrt()
    };
    // The local scale is never less, so that it can only bring them down.
    if (0..index.len()).all(|k| sigmas(k) <= OUTLIER_SIGMA) {
        return Vec::new();
    }
    let mut squares = vec![0.0; index.len()];
    for (contrast, overall) in contrasts.iter().zip(overall) {
        let local: Vec<f64> = contrast.chunks(SCALE_BLOCK).map(scale_of).collect();
        let blocks = contrast
            .chunks(SCALE_BLOCK)
            .zip(squares.chunks_mut(SCALE_BLOCK));
        for (block, (contrast, squares)) in blocks.enumerate() {
            let around = &local[block.saturating_sub(1)..(block + 2).min(local.len())];
            let scale = around.iter().copied().fold(overall, f64::max);
            for (square, c) in squares.iter_mut().zip(contrast) {
                *square += (c / scale).powi(2);
            }
        }
    }
    let each = index.into_iter().zip(squares.into_iter().map(f64::sqrt));
    each.map(|(index, sigmas)| Misfit { index, sigmas })
        .filter(|m| m.sigmas > OUTLIER_SIGMA)
        .collect()
}

/// Evidence from the other stream about a deviation of some stamps.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Evidence {
    /// Odds that the content is earlier than its stamps by the deviation, and not at its stamps.
    odds: f64,
    /// Shift (s) and rate that the deviation causes if it counts as the clocks'.
    pub(crate) effect: Vector2<f64>,
}

impl Evidence {
    /// Returns the posterior probability that the content is earlier by the deviation.
    pub(crate) fn probability(&self, prior: f64) -> f64 {
        let odds = self.odds * prior / (1.0 - prior);
        if odds.is_finite() {
            odds / (1.0 + odds)
        } else {
            1.0
        }
    }

    /// Returns the covariance of (shift, rate) that is due to an undecided deviation.
    pub(crate) fn open(&self, weight: f64) -> Matrix2<f64> {
        self.effect * self.effect.transpose() * weight
    }
}

/// Least 1-sigma of a deviation, as a part of it.
const LEAST_SIGMA: f64 = 0.05;

/// Compares samples with the smooth rate of the other stream, to decide if their content is
/// earlier than their stamps by `later_s`. Arguments are those of [`outliers`]; the effect is
/// given at `reference`.
///
/// With `s` the slope of the other's rate, sample minus prediction is
/// `−s·(η + u·ρ + θ·later)`; shift η and rate ρ are free, and θ is 1 or 0.
pub(crate) fn evidence(
    (t, w, usable): Usable<'_>,
    other: &Signal,
    other_time: impl Fn(f64) -> f64,
    calibration: &Calibration,
    reference: f64,
    later_s: impl Fn(usize) -> f64,
) -> Option<Evidence> {
    let mut seen = Vec::with_capacity(t.len());
    let mut errors = [(); 3].map(|()| Vec::with_capacity(t.len()));
    for k in (0..t.len()).filter(|&k| usable[k]) {
        if let Some((x, slope)) = other.at(other_time(t[k])) {
            let error = calibration.residual(&x.into(), &w[k].into());
            seen.push((k, calibration.matrix * Vector3::from(slope), error));
            (0..3).for_each(|axis| errors[axis].push(error[axis]));
        }
    }
    let weights = errors.map(|axis| {
        let sigma = robust::mad_sigma(axis).unwrap_or(LEAST_NOISE);
        sigma.max(LEAST_NOISE).powi(-2)
    });
    let weights = Vector3::from(weights);
    // Row, information and score of each sample.
    let each = seen.into_iter().map(|(k, slope, error)| {
        let row = Vector3::new(1.0, t[k] - reference, later_s(k));
        let weighed = slope.component_mul(&weights);
        (row, weighed.dot(&slope), -weighed.dot(&error))
    });
    let each: Vec<(Vector3<f64>, f64, f64)> = each.collect();
    let mut normal = Matrix3::zeros();
    let mut right = Vector3::zeros();
    for (row, information, score) in &each {
        normal += row * row.transpose() * *information;
        right += row * *score;
    }
    let inverse = normal.try_inverse()?;
    let found = inverse * right;
    let mut scatter = 0.0;
    for block in each.chunks(SCALE_BLOCK) {
        let left = |(row, information, score): &(Vector3<f64>, f64, f64)| {
            row * (score - information * row.dot(&found))
        };
        let block: Vector3<f64> = block.iter().map(left).sum();
        scatter += inverse.row(2).transpose().dot(&block).powi(2);
    }
    let variance = scatter.max(inverse[(2, 2)]).max(LEAST_SIGMA * LEAST_SIGMA);
    let effect = normal.fixed_view::<2, 2>(0, 0).try_inverse()? * normal.fixed_view::<2, 1>(0, 2);
    let odds = ((found[2] - 0.5) / variance).exp();
    Some(Evidence { odds, effect })
}

/// A stretch of time with a common displacement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Stretch {
    /// Begin, by the data's clock.
    pub(crate) from: f64,
    /// End, by the data's clock.
    pub(crate) to: f64,
    /// Displacement against the fit, seconds.
    pub(crate) shift_s: f64,
    /// Its information about the shift, as a part of all.
    pub(crate) share: f64,
}

/// Least step of the relation that is searched for, seconds.
const LEAST_STEP_S: f64 = 100e-6;
/// Its least significance.
const STEP_Z: f64 = 8.0;
/// The same against the scatter of the blocks.
const STEP_Z_SCATTER: f64 = 6.0;

/// Score and information about the shift in a block of time.
struct Block {
    from: f64,
    to: f64,
    score: f64,
    information: f64,
}

/// Cuts the overlap where the relation of the clocks jumps.
///
/// Forward selection of steps in the local displacements of blocks of `block_s`,
/// fitted together with shift and rate. One stretch means that there is no jump.
pub(crate) fn stretches(fit: &Fit, block_s: f64) -> Vec<Stretch> {
    let mut blocks: Vec<Block> = Vec::new();
    for node in &fit.nodes {
        let (score, information) = node.evidence(&fit.weights);
        match blocks.last_mut() {
            Some(b) if node.t - b.from < block_s => {
                b.to = node.t;
                b.score += score;
                b.information += information;
            }
            _ => blocks.push(Block {
                from: node.t,
                to: node.t,
                score,
                information,
            }),
        }
    }
    let total: f64 = blocks.iter().map(|b| b.information).sum();
    if blocks.len() < 4 || total <= 0.0 {
        return vec![Stretch {
            from: f64::NEG_INFINITY,
            to: f64::INFINITY,
            shift_s: 0.0,
            share: 1.0,
        }];
    }
    // Scatter of a block's score: robust, from differences of neighbours, so
    // that the steps themselves do not enter.
    let standard: Vec<f64> = blocks
        .windows(2)
        .filter(|p| p[0].information.min(p[1].information) > 1e-3 * total / blocks.len() as f64)
        .map(|p| {
            (p[1].score / p[1].information - p[0].score / p[0].information)
                / (1.0 / p[1].information + 1.0 / p[0].information).sqrt()
        })
        .collect();
    let levels = Levels::new(&blocks, total);
    let mut steps = vec![(0, 0.0)];
    if let Some(sigma) = robust::mad_sigma(standard).filter(|sigma| sigma.is_finite()) {
        for _ in 0..MOST_STEPS {
            let Some(more) = levels.with_best_cut(&steps, sigma.max(1e-12)) else {
                break;
            };
            steps = more;
        }
    }
    levels.stretches(steps, total)
}

/// Most steps that are searched for.
const MOST_STEPS: usize = 8;

/// Index of the block at which a new level begins, and its height above the level before,
/// seconds.
type Step = (usize, f64);

/// Levels of the relation, fitted together with a rate, because the fit's rate has absorbed a
/// part of their steps.
struct Levels<'a> {
    blocks: &'a [Block],
    /// Time of each block from the middle.
    u: Vec<f64>,
    /// Sums over each block and all later ones: `Σ information·(1, u, u²)`, `Σ score·(1, u)`.
    tails: Vec<[f64; 5]>,
}

impl<'a> Levels<'a> {
    fn new(blocks: &'a [Block], total: f64) -> Self {
        let middle = blocks.iter().map(|b| b.from * b.information).sum::<f64>() / total;
        let u: Vec<f64> = blocks.iter().map(|b| b.from - middle).collect();
        let mut sums = [0.0; 5];
        let mut tails = vec![sums; blocks.len()];
        for ((tail, b), u) in tails.iter_mut().zip(blocks).zip(&u).rev() {
            let turned = b.information * u;
            let own = [b.information, turned, turned * u, b.score, b.score * u];
            for (sum, own) in sums.iter_mut().zip(own) {
                *sum += own;
            }
            *tail = sums;
        }
        Self { blocks, u, tails }
    }

    /// Least squares of the blocks' displacements on a rate and the steps to the levels
    /// that begin at `cuts`, in this order; and the inverse of the equations.
    fn fitted(&self, cuts: &[usize]) -> Option<(DVector<f64>, DMatrix<f64>)> {
        // After the later of two cuts both levels count.
        let normal = DMatrix::from_fn(1 + cuts.len(), 1 + cuts.len(), |r, c| match (r, c) {
            (0, 0) => self.tails[0][2],
            (0, k) | (k, 0) => self.tails[cuts[k - 1]][1],
            _ => self.tails[cuts[r - 1].max(cuts[c - 1])][0],
        });
        let right = DVector::from_fn(1 + cuts.len(), |k, _| match k {
            0 => self.tails[0][4],
            _ => self.tails[cuts[k - 1]][3],
        });
        let inverse = normal.cholesky()?.inverse();
        Some((&inverse * right, inverse))
    }

    /// Variance of the last step from the scatter of the blocks.
    fn scatter(&self, cuts: &[usize], solution: &DVector<f64>, inverse: &DMatrix<f64>) -> f64 {
        let last = inverse.column(cuts.len());
        let variance = |(block, b): (usize, &Block)| {
            let dot = |of: &dyn Fn(usize) -> f64| {
                let reached = (0..cuts.len()).filter(|&k| block >= cuts[k]);
                of(0) * self.u[block] + reached.map(|k| of(1 + k)).sum::<f64>()
            };
            let left = b.score - dot(&|k| solution[k]) * b.information;
            (dot(&|k| last[k]) * left).powi(2)
        };
        self.blocks.iter().enumerate().map(variance).sum()
    }

    /// Adds the most significant further step; `None` if none is significant.
    fn with_best_cut(&self, steps: &[Step], sigma: f64) -> Option<Vec<Step>> {
        let mut best: Option<(f64, Vec<Step>)> = None;
        let mut cuts: Vec<usize> = steps.iter().map(|s| s.0).collect();
        for cut in (2..self.blocks.len() - 1).filter(|cut| steps.iter().all(|s| s.0 != *cut)) {
            cuts.truncate(steps.len());
            cuts.push(cut);
            let Some((solution, inverse)) = self.fitted(&cuts) else {
                continue;
            };
            let last = cuts.len();
            let size = solution[last];
            let z = size.abs() / (inverse[(last, last)].sqrt() * sigma);
            if size.abs() > LEAST_STEP_S
                && z > STEP_Z
                && best.as_ref().is_none_or(|b| z > b.0)
                && size * size
                    > STEP_Z_SCATTER * STEP_Z_SCATTER * self.scatter(&cuts, &solution, &inverse)
            {
                let sizes = solution.iter().skip(1).copied();
                best = Some((z, cuts.iter().copied().zip(sizes).collect()));
            }
        }
        Some(best?.1)
    }

    fn stretches(&self, mut steps: Vec<Step>, total: f64) -> Vec<Stretch> {
        steps.sort_by_key(|step| step.0);
        let ends = steps.iter().skip(1).map(|step| step.0);
        let ends: Vec<usize> = ends.chain([self.blocks.len()]).collect();
        let mut shift_s = 0.0;
        let stretches = steps.iter().zip(ends).map(|(&(begin, size), end)| {
            // The first level is what the others are compared with.
            shift_s += if begin == 0 { 0.0 } else { size };
            let part = &self.blocks[begin..end];
            Stretch {
                from: part[0].from,
                to: part[part.len() - 1].to,
                shift_s,
                share: part.iter().map(|b| b.information).sum::<f64>() / total,
            }
        });
        stretches.collect()
    }
}

/// Rms of the displacements of `parts` of the overlap with equal information
/// against the fit, seconds.
pub(crate) fn local_scatter(fit: &Fit, parts: f64) -> f64 {
    let all = fit.parts(parts);
    let total: f64 = all.iter().map(|part| part.information).sum();
    let is_enough = |part: &&Part| part.information > 0.3 * total / parts;
    let (mut squares, mut judged) = (0.0, 0.0);
    for part in all.iter().filter(is_enough) {
        squares += part.score * part.score / part.information;
        judged += part.information;
    }
    if judged > 0.0 {
        (squares / judged).sqrt()
    } else {
        0.0
    }
}
