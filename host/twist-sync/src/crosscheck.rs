//! Faults that show against the other gyroscope.
//!
//! Once the streams are related, each sample of one can be compared with the
//! smooth rate of the other. The comparison is between unlike things on
//! purpose: the smooth signal dilutes a fault of *its* stream to a quarter, while
//! the raw sample shows its own at full height, so a fault is attributed to the
//! right stream.
//!
//! Slow differences (filters, nonlinearity, flexing) are not faults of samples;
//! the local median of the difference is taken away before judging.

use nalgebra::{DMatrix, DVector, Vector3};

use crate::calibration::Calibration;
use crate::coarse::Usable;
use crate::fit::{Fit, Node};
use crate::robust;
use crate::signal::Signal;

/// A sample is an outlier beyond this many sigmas (length of the whitened vector).
const OUTLIER_SIGMA: f64 = 6.0;
/// The same once more than half a percent of the samples are outliers.
const SUSPICIOUS_SIGMA: f64 = 3.8;
/// Least scatter that is assumed, rad/s: below any real gyroscope's noise, above
/// what the filter leaves of fast motion in a noiseless simulation.
const LEAST_NOISE: f64 = 1e-4;
/// Samples of a block for the local scale.
const SCALE_BLOCK: usize = 48;

/// A sample that does not fit to the other stream.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Misfit {
    /// Its index in the recording.
    pub(crate) index: usize,
    /// How far off it is, in standard deviations (length of the whitened vector).
    pub(crate) sigmas: f64,
}

/// Samples of a stream that do not fit to the smooth rate of the other.
///
/// `other_time` carries this stream's time to the other's, `calibration` the
/// other's rate to this one's axes. The scale is local: where the rig is knocked
/// or vibrates, differences between the filters are no faults.
pub(crate) fn outliers(
    (t, w, usable): Usable<'_>,
    other: &Signal,
    other_time: impl Fn(f64) -> f64,
    calibration: &Calibration,
) -> Vec<Misfit> {
    let mut index = Vec::new();
    let mut difference: [Vec<f64>; 3] = Default::default();
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
    let mut squares = vec![0.0; index.len()];
    for axis in &difference {
        let contrast = robust::without_local_median(axis);
        let scale_of = |part: &[f64]| {
            robust::mad_sigma(part).map_or(LEAST_NOISE, |sigma| sigma.max(LEAST_NOISE))
        };
        let overall = scale_of(&contrast);
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
    let misfits = index.into_iter().zip(&squares);
    let misfits: Vec<Misfit> = misfits
        .map(|(index, square)| Misfit {
            index,
            sigmas: square.sqrt(),
        })
        .collect();
    let clear = misfits.iter().filter(|m| m.sigmas > OUTLIER_SIGMA).count();
    // Where there are many, there are more that hide in slow motion.
    let threshold = if clear * 200 > misfits.len() {
        SUSPICIOUS_SIGMA
    } else {
        OUTLIER_SIGMA
    };
    misfits
        .into_iter()
        .filter(|m| m.sigmas > threshold)
        .collect()
}

/// A stretch of time with a common displacement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Stretch {
    /// First and last time (the data's clock).
    pub(crate) from: f64,
    /// End of the stretch.
    pub(crate) to: f64,
    /// Displacement against the fit, seconds.
    pub(crate) shift_s: f64,
    /// Its information about the shift, as a part of all.
    pub(crate) share: f64,
}

/// Least step of the relation that is looked for, seconds.
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
        let ws = fit.weights * node.slope * node.weight;
        let (score, information) = (ws.dot(&node.residual), ws.dot(&node.slope));
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
    let middle = blocks.iter().map(|b| b.from * b.information).sum::<f64>() / total;
    let mut steps = Steps::none(middle);
    if let Some(sigma) = robust::mad_sigma(&standard).filter(|sigma| sigma.is_finite()) {
        for _ in 0..MOST_STEPS {
            let Some(next) = steps.with_best_cut(&blocks, sigma.max(1e-12)) else {
                break;
            };
            steps = next;
        }
    }
    steps.stretches(&blocks, total)
}

/// Most steps that are looked for.
const MOST_STEPS: usize = 8;

/// Steps of the relation, fitted together with a shift and a rate, which the fit
/// has bent to lessen them.
struct Steps {
    middle: f64,
    /// Blocks at which a new level begins.
    cuts: Vec<usize>,
    /// Level of each stretch against the first, seconds.
    levels: Vec<f64>,
}

impl Steps {
    const fn none(middle: f64) -> Self {
        Self {
            middle,
            cuts: Vec::new(),
            levels: Vec::new(),
        }
    }

    /// Least-squares of the blocks' displacements on shift, rate and the steps
    /// at `cuts`: (size, ideal variance, variance from scatter) of the last step,
    /// and all sizes.
    fn fitted(&self, blocks: &[Block], cuts: &[usize]) -> Option<(f64, f64, f64, Vec<f64>)> {
        let n = 2 + cuts.len();
        // Without a matrix of its own for each block: there are many.
        let row = |i: usize, b: &Block, x: &mut [f64]| {
            x[0] = 1.0;
            x[1] = b.from - self.middle;
            for (x, cut) in x[2..n].iter_mut().zip(cuts) {
                *x = f64::from(u8::from(i >= *cut));
            }
        };
        let mut x = [0.0; 2 + MOST_STEPS];
        let mut normal = DMatrix::<f64>::zeros(n, n);
        let mut right = DVector::<f64>::zeros(n);
        for (i, b) in blocks.iter().enumerate() {
            row(i, b, &mut x);
            for c in 0..n {
                for r in 0..n {
                    normal[(r, c)] += x[r] * x[c] * b.information;
                }
                right[c] += x[c] * b.score;
            }
        }
        let inverse = normal.cholesky()?.inverse();
        let solution = &inverse * right;
        let last = n - 1;
        let mut scatter = 0.0;
        for (i, b) in blocks.iter().enumerate() {
            row(i, b, &mut x);
            let dot = |of: &dyn Fn(usize) -> f64| (0..n).map(|k| of(k) * x[k]).sum::<f64>();
            let influence = dot(&|k| inverse[(last, k)]);
            let left = b.score - dot(&|k| solution[k]) * b.information;
            scatter += (influence * left).powi(2);
        }
        let sizes = solution.iter().skip(2).copied().collect();
        Some((solution[last], inverse[(last, last)], scatter, sizes))
    }

    fn with_best_cut(&self, blocks: &[Block], sigma: f64) -> Option<Self> {
        let mut best: Option<(f64, Vec<usize>, Vec<f64>)> = None;
        for cut in 2..blocks.len() - 1 {
            if self.cuts.contains(&cut) {
                continue;
            }
            let mut cuts = self.cuts.clone();
            cuts.push(cut);
            let Some((size, ideal, scatter, sizes)) = self.fitted(blocks, &cuts) else {
                continue;
            };
            let z = size.abs() / (ideal.sqrt() * sigma);
            if size.abs() > LEAST_STEP_S
                && z > STEP_Z
                && size * size > STEP_Z_SCATTER * STEP_Z_SCATTER * scatter
                && best.as_ref().is_none_or(|b| z > b.0)
            {
                best = Some((z, cuts, sizes));
            }
        }
        best.map(|(_, cuts, sizes)| {
            let mut order: Vec<usize> = (0..cuts.len()).collect();
            order.sort_by_key(|&i| cuts[i]);
            let mut level = 0.0;
            Self {
                middle: self.middle,
                levels: order
                    .iter()
                    .map(|&i| {
                        level += sizes[i];
                        level
                    })
                    .collect(),
                cuts: {
                    let mut sorted = cuts;
                    sorted.sort_unstable();
                    sorted
                },
            }
        })
    }

    fn stretches(&self, blocks: &[Block], total: f64) -> Vec<Stretch> {
        let mut bounds = vec![0];
        bounds.extend(&self.cuts);
        bounds.push(blocks.len());
        bounds
            .windows(2)
            .enumerate()
            .map(|(i, bound)| {
                let part = &blocks[bound[0]..bound[1]];
                Stretch {
                    from: part[0].from,
                    to: part[part.len() - 1].to,
                    shift_s: i.checked_sub(1).map_or(0.0, |k| self.levels[k]),
                    share: part.iter().map(|b| b.information).sum::<f64>() / total,
                }
            })
            .collect()
    }
}

/// Rms of the displacements of `parts` of the overlap with equal information
/// against the fit, seconds.
pub(crate) fn local_scatter(fit: &Fit, parts: usize) -> f64 {
    let information = |n: &Node| (fit.weights * n.slope).dot(&n.slope) * n.weight;
    let total: f64 = fit.nodes.iter().map(information).sum();
    let share = total / parts as f64;
    let (mut squares, mut judged) = (0.0, 0.0);
    let (mut sum, mut score) = (0.0, 0.0);
    let mut judge = |sum: f64, score: f64| {
        squares += score * score / sum;
        judged += sum;
    };
    for node in &fit.nodes {
        sum += information(node);
        score += (fit.weights * node.slope).dot(&node.residual) * node.weight;
        if sum >= share {
            judge(sum, score);
            (sum, score) = (0.0, 0.0);
        }
    }
    if sum > 0.3 * share {
        judge(sum, score);
    }
    if judged > 0.0 {
        (squares / judged).sqrt()
    } else {
        0.0
    }
}
