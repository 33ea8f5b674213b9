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

use nalgebra::Vector3;

use super::fit::{Calibration, Fit, Link, Node};
use super::robust;
use super::signal::Signal;
use super::spline::Vec3;

/// A sample is an outlier beyond this many sigmas (length of the whitened vector).
const OUTLIER_SIGMA: f64 = 6.0;
/// Least scatter that is assumed, rad/s: below any real gyroscope's noise, above
/// what the filter leaves of fast motion in a noiseless simulation.
const LEAST_NOISE: f64 = 1e-4;
/// Samples on each side for the local median.
const AROUND: usize = 4;
/// Samples of a block for the local scale.
const SCALE_BLOCK: usize = 48;

/// A sample that does not fit to the other stream.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Misfit {
    /// Its index in the recording.
    pub index: usize,
    /// How far off it is, in standard deviations (length of the whitened vector).
    pub sigmas: f64,
}

/// Samples of a stream that do not fit to the smooth rate of the other.
///
/// `other_time` carries this stream's time to the other's, `calibration` the
/// other's rate to this one's axes. The scale is local: where the rig is knocked
/// or vibrates, differences between the filters are no faults.
#[must_use]
pub fn outliers(
    t: &[f64],
    w: &[Vec3],
    usable: &[bool],
    other: &Signal,
    other_time: impl Fn(f64) -> f64,
    calibration: &Calibration,
) -> Vec<Misfit> {
    let mut index = Vec::new();
    let mut difference: Vec<Vec3> = Vec::new();
    for k in (0..t.len()).filter(|&k| usable[k]) {
        if let Some((x, _)) = other.at(other_time(t[k])) {
            let predicted = calibration.matrix * Vector3::from(x) + calibration.bias;
            index.push(k);
            difference.push((Vector3::from(w[k]) - predicted).into());
        }
    }
    if index.len() < 2 * SCALE_BLOCK {
        return Vec::new();
    }
    let mut contrast = vec![[0.0; 3]; index.len()];
    let mut window = Vec::with_capacity(2 * AROUND + 1);
    for i in 0..index.len() {
        let from = i.saturating_sub(AROUND);
        let to = (i + AROUND + 1).min(index.len());
        for axis in 0..3 {
            window.clear();
            window.extend(difference[from..to].iter().map(|d| d[axis]));
            contrast[i][axis] = difference[i][axis] - robust::median_in_place(&mut window);
        }
    }
    let scale_of = |part: &[Vec3]| -> Vec3 {
        std::array::from_fn(|axis| {
            let values: Vec<f64> = part.iter().map(|c| c[axis]).collect();
            robust::mad_sigma(&values).max(LEAST_NOISE)
        })
    };
    let overall = scale_of(&contrast);
    let local: Vec<Vec3> = contrast.chunks(SCALE_BLOCK).map(scale_of).collect();
    let scale_at = |i: usize, axis: usize| {
        let block = i / SCALE_BLOCK;
        let around = &local[block.saturating_sub(1)..(block + 2).min(local.len())];
        around.iter().map(|s| s[axis]).fold(overall[axis], f64::max)
    };
    index
        .iter()
        .zip(&contrast)
        .enumerate()
        .map(|(i, (&k, c))| Misfit {
            index: k,
            sigmas: (0..3)
                .map(|axis| (c[axis] / scale_at(i, axis)).powi(2))
                .sum::<f64>()
                .sqrt(),
        })
        .filter(|m| m.sigmas > OUTLIER_SIGMA)
        .collect()
}

/// A stretch of time with a common displacement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stretch {
    /// First and last time (second stream's clock).
    pub from: f64,
    /// End of the stretch.
    pub to: f64,
    /// Displacement against the fit, seconds.
    pub shift_s: f64,
    /// Its information about the shift, as a part of all.
    pub share: f64,
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

/// Variance of the displacement of some blocks, from their own scatter.
fn scatter(blocks: &[Block], shift: f64) -> f64 {
    if blocks.len() < 3 {
        return f64::INFINITY;
    }
    let (mut sum, mut information) = (0.0, 0.0);
    for b in blocks {
        sum += (b.score - shift * b.information).powi(2);
        information += b.information;
    }
    sum / (information * information)
}

/// Cuts the overlap where the relation of the clocks jumps.
///
/// Binary segmentation of the local displacements (0.1 s blocks). One stretch
/// means that there is no jump.
#[must_use]
pub fn stretches(fit: &Fit, block_s: f64) -> Vec<Stretch> {
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
    let sigma = robust::mad_sigma(&standard);
    let mut cuts = vec![0, blocks.len()];
    if sigma.is_finite() {
        let mut open = vec![(0, blocks.len())];
        while let Some((from, to)) = open.pop() {
            let (mut all_score, mut all_information) = (0.0, 0.0);
            for b in &blocks[from..to] {
                all_score += b.score;
                all_information += b.information;
            }
            let (mut score, mut information) = (0.0, 0.0);
            let mut best = (0.0, from);
            for (i, b) in blocks[from..to].iter().enumerate().take(to - from - 1) {
                score += b.score;
                information += b.information;
                let rest = all_information - information;
                if information.min(rest) < 0.01 * total {
                    continue;
                }
                let shifts = (score / information, (all_score - score) / rest);
                let step = shifts.0 - shifts.1;
                let z = step.abs() / (1.0 / information + 1.0 / rest).sqrt() / sigma.max(1e-12);
                if step.abs() > LEAST_STEP_S && z > STEP_Z && z > best.0 {
                    // The same against the scatter of the blocks on both sides.
                    let cut = from + i + 1;
                    let variance =
                        scatter(&blocks[from..cut], shifts.0) + scatter(&blocks[cut..to], shifts.1);
                    if step * step > STEP_Z_SCATTER * STEP_Z_SCATTER * variance {
                        best = (z, cut);
                    }
                }
            }
            if best.0 > 0.0 {
                cuts.push(best.1);
                open.push((from, best.1));
                open.push((best.1, to));
            }
        }
    }
    cuts.sort_unstable();
    cuts.windows(2)
        .map(|c| {
            let part = &blocks[c[0]..c[1]];
            let score: f64 = part.iter().map(|b| b.score).sum();
            let information: f64 = part.iter().map(|b| b.information).sum();
            Stretch {
                from: part[0].from,
                to: part[part.len() - 1].to,
                shift_s: score / information.max(f64::MIN_POSITIVE),
                share: information / total,
            }
        })
        .collect()
}

/// Displacement of parts of the overlap with equal information against the fit:
/// (centre time, displacement in seconds, information).
#[must_use]
pub fn local_shifts(fit: &Fit, parts: usize) -> Vec<(f64, f64, f64)> {
    let information = |n: &Node| (fit.weights * n.slope).dot(&n.slope) * n.weight;
    let total: f64 = fit.nodes.iter().map(information).sum();
    let mut out = Vec::new();
    let (mut sum, mut score, mut time) = (0.0, 0.0, 0.0);
    for node in &fit.nodes {
        let i = information(node);
        sum += i;
        score += (fit.weights * node.slope).dot(&node.residual) * node.weight;
        time += i * node.t;
        if sum >= total / parts as f64 {
            out.push((time / sum, score / sum, sum));
            (sum, score, time) = (0.0, 0.0, 0.0);
        }
    }
    if sum > 0.3 * total / parts as f64 {
        out.push((time / sum, score / sum, sum));
    }
    out
}

/// The relation seen from the other stream.
#[must_use]
pub fn reversed(link: &Link) -> Link {
    Link {
        at_a: link.at_b,
        at_b: link.at_a,
        rate: 1.0 / link.rate,
    }
}
