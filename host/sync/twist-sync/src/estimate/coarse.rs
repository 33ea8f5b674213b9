//! The coarse lag: cross-covariance of the two gyroscopes over all lags.
//!
//! At each lag the 3×3 matrix `M = Σ y(t + lag) x(t)ᵀ` is formed by FFT. Its
//! nuclear norm (sum of singular values) is the largest correlation that any
//! rotation between the sensors can give (`max tr(RᵀM)` over orthogonal `R`), so
//! the search needs no knowledge of how the sensors are mounted.
//!
//! The norm itself favours lags at which much of the motion overlaps, the norm
//! divided by the energies in the overlap favours short overlaps. Peaks of both
//! are returned; the fit decides between them.

use crate::correlate::{Correlator, Spectrum};
use crate::signal::interpolant::Vec3;

/// Bin width of the search in seconds.
const BIN_S: f64 = 0.02;

/// Peaks of each of the two scores that the fit tries.
const PEAKS: usize = 6;

/// Peaks whose correlation is below this part of the best are not tried: they leave more
/// than half of the motion's power.
const WEAK: f64 = 0.6;

/// One stream: times, rates, and which of them can be used.
pub(crate) type Usable<'a> = (&'a [f64], &'a [Vec3], &'a [bool]);

/// Mean rate in bins of [`BIN_S`], mean-free, starting at `t[0]`; empty bins are zero.
fn binned((t, w, usable): Usable<'_>) -> Option<(f64, Vec<Vec3>)> {
    let used = || (0..t.len()).filter(|&k| usable[k]);
    let start = t[used().next()?];
    let end = t[used().next_back()?];
    let bins = ((end - start) / BIN_S) as usize + 1;
    let mut sum = vec![[0.0; 3]; bins];
    let mut count = vec![0.0; bins];
    for k in used() {
        // Each sample is shared between its two nearest bins (linear weights).
        let x = (t[k] - start) / BIN_S;
        let i = (x as usize).min(bins - 1);
        let part = (x - i as f64).clamp(0.0, 1.0);
        for (bin, weight) in [(i, 1.0 - part), (i + 1, part)] {
            if bin < bins {
                count[bin] += weight;
                for axis in 0..3 {
                    sum[bin][axis] += weight * w[k][axis];
                }
            }
        }
    }
    let mut mean = [0.0; 3];
    let mut filled = 0.0;
    for (s, &c) in sum.iter_mut().zip(&count) {
        if c > 1e-3 {
            filled += 1.0;
            for axis in 0..3 {
                s[axis] /= c;
                mean[axis] += s[axis];
            }
        }
    }
    for (s, &c) in sum.iter_mut().zip(&count) {
        for axis in 0..3 {
            s[axis] = if c > 1e-3 {
                s[axis] - mean[axis] / f64::max(filled, 1.0)
            } else {
                0.0
            };
        }
    }
    Some((start, sum))
}

/// Sum of the singular values of a 3×3 matrix.
fn nuclear_norm(m: &[[f64; 3]; 3]) -> f64 {
    // Eigenvalues of MᵀM in closed form (Smith 1961).
    let mut g = [[0.0; 3]; 3];
    for (r, row) in g.iter_mut().enumerate() {
        for (c, value) in row.iter_mut().enumerate() {
            *value = (0..3).map(|k| m[k][r] * m[k][c]).sum();
        }
    }
    let q = (g[0][0] + g[1][1] + g[2][2]) / 3.0;
    let off = g[0][1] * g[0][1] + g[0][2] * g[0][2] + g[1][2] * g[1][2];
    let p2 = (g[0][0] - q).powi(2) + (g[1][1] - q).powi(2) + (g[2][2] - q).powi(2) + 2.0 * off;
    let p = (p2 / 6.0).sqrt();
    if p <= 1e-300 {
        return 3.0 * q.max(0.0).sqrt();
    }
    let b = |r: usize, c: usize| (g[r][c] - if r == c { q } else { 0.0 }) / p;
    let det = b(0, 0) * (b(1, 1) * b(2, 2) - b(1, 2) * b(2, 1))
        - b(0, 1) * (b(1, 0) * b(2, 2) - b(1, 2) * b(2, 0))
        + b(0, 2) * (b(1, 0) * b(2, 1) - b(1, 1) * b(2, 0));
    let phi = (det / 2.0).clamp(-1.0, 1.0).acos() / 3.0;
    let largest = q + 2.0 * p * phi.cos();
    let smallest = q + 2.0 * p * (phi + std::f64::consts::TAU / 3.0).cos();
    let middle = 3.0 * q - largest - smallest;
    [largest, middle, smallest]
        .iter()
        .map(|x| x.max(0.0).sqrt())
        .sum()
}

/// Returns the lags at which two recordings x and y may belong together, best first: the
/// relative time of y minus that of x, in seconds.
///
/// Lags with less than `min_overlap_s` in common are ignored.
pub(crate) fn candidates(x: Usable<'_>, y: Usable<'_>, min_overlap_s: f64) -> Vec<f64> {
    let (Some((start_x, x)), Some((start_y, y))) = (binned(x), binned(y)) else {
        return Vec::new();
    };
    let min_bins = ((min_overlap_s / BIN_S) as i64).max(1);
    let (scores, first_lag) = scores(&x, &y, min_bins);
    let [_, normalised] = &scores;
    let best = normalised.iter().copied().fold(0.0, f64::max);
    let mut found: Vec<f64> = Vec::new();
    for score in &scores {
        for place in peaks(score) {
            if normalised[place.round() as usize] < WEAK * best {
                continue;
            }
            let lag_s = (first_lag as f64 + place) * BIN_S + start_y - start_x;
            if found
                .iter()
                .all(|other| (other - lag_s).abs() > 1.5 * BIN_S)
            {
                found.push(lag_s);
            }
        }
    }
    found
}

/// Returns the norm, and the norm over the energies in the overlap, at each lag with at
/// least `min_bins` in common, and the first of these lags. Lag l pairs `x[i]`
/// with `y[i + l]`.
fn scores(x: &[Vec3], y: &[Vec3], min_bins: i64) -> ([Vec<f64>; 2], i64) {
    let correlator = Correlator::new(x.len() + y.len());
    let spectra = |values: &[Vec3]| -> [Spectrum; 3] {
        std::array::from_fn(|axis| correlator.spectrum(values.iter().map(|v| v[axis])))
    };
    let (of_x, of_y) = (spectra(x), spectra(y));
    let matrix = of_y.map(|y| of_x.each_ref().map(|x| correlator.correlation(x, &y)));
    let (energy_x, energy_y) = (energies(x), energies(y));
    let least = 0.05 * energy_x[x.len()].min(energy_y[y.len()]);
    let first_lag = min_bins - x.len() as i64;
    let (mut norms, mut normalised) = (Vec::new(), Vec::new());
    for lag in first_lag..=(y.len() as i64 - min_bins) {
        let at = correlator.place(lag);
        let m = matrix.each_ref();
        let norm = nuclear_norm(&m.map(|row| row.each_ref().map(|element| element[at])));
        let from = (-lag).max(0);
        let to = (x.len() as i64).min(y.len() as i64 - lag).max(0);
        let ex = energy_x[to as usize] - energy_x[from as usize];
        let ey = energy_y[(to + lag) as usize] - energy_y[(from + lag) as usize];
        norms.push(norm);
        normalised.push(if ex.min(ey) > least && ex * ey > 0.0 {
            (norm / (ex * ey).sqrt()).min(1.0)
        } else {
            0.0
        });
    }
    ([norms, normalised], first_lag)
}

/// Energy of all bins before each, and of all bins as the last value.
fn energies(values: &[Vec3]) -> Vec<f64> {
    let mut sums = vec![0.0];
    let mut total = 0.0;
    for v in values {
        total += v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
        sums.push(total);
    }
    sums
}

/// Returns the places of the highest local maxima, interpolated between bins by a parabola.
fn peaks(score: &[f64]) -> Vec<f64> {
    let at = |i: usize| score.get(i).copied();
    let before = |i: usize| i.checked_sub(1).and_then(at);
    let mut maxima: Vec<usize> = (0..score.len())
        .filter(|&i| {
            score[i] > 0.0
                && before(i).is_none_or(|left| score[i] >= left)
                && at(i + 1).is_none_or(|right| score[i] > right)
        })
        .collect();
    maxima.sort_by(|&x, &y| score[y].total_cmp(&score[x]));
    maxima.truncate(PEAKS);
    maxima
        .into_iter()
        .map(|i| {
            let Some((left, right)) = before(i).zip(at(i + 1)) else {
                return i as f64;
            };
            let curvature = left - 2.0 * score[i] + right;
            let fine = if curvature < 0.0 {
                (0.5 * (left - right) / curvature).clamp(-0.5, 0.5)
            } else {
                0.0
            };
            i as f64 + fine
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    #[test]
    fn nuclear_norm_agrees_with_the_svd() {
        for seed in 0..50 {
            let f = |k: usize| ((seed * 9 + k) as f64 * 12.9898).sin() * 3.0;
            let m = [[f(0), f(1), f(2)], [f(3), f(4), f(5)], [f(6), f(7), f(8)]];
            let expected: f64 = Matrix3::from_fn(|r, c| m[r][c]).singular_values().sum();
            assert!((nuclear_norm(&m) - expected).abs() < 1e-6 * expected);
        }
        assert_eq!(nuclear_norm(&[[0.0; 3]; 3]), 0.0);
        let identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        assert!((nuclear_norm(&identity) - 3.0).abs() < 1e-12);
    }

    #[test]
    fn finds_the_lag_through_a_rotation() {
        let motion = |t: f64| {
            [
                (7.0 * t).sin() * (-(t - 4.0).powi(2)).exp(),
                (5.0 * t).cos() * (-(t - 5.0).powi(2)).exp(),
                0.2 * (3.1 * t).sin(),
            ]
        };
        let t: Vec<f64> = (0..900).map(|k| 0.01 * k as f64).collect();
        let a: Vec<Vec3> = t.iter().map(|&x| motion(x)).collect();
        // b lags by 0.73 s and sees the axes exchanged.
        let b: Vec<Vec3> = t
            .iter()
            .map(|&x| {
                let v = motion(x - 0.73);
                [v[2], -v[0], v[1]]
            })
            .collect();
        let usable = vec![true; 900];
        let found = candidates((&t, &a, &usable), (&t, &b, &usable), 2.0);
        assert!((found[0] - 0.73).abs() < 0.005, "{found:?}");
    }
}
