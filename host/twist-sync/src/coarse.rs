//! The coarse lag: cross-covariance of the two gyroscopes over all lags.
//!
//! At each lag the 3×3 matrix `M = Σ b(t + lag) a(t)ᵀ` is formed by FFT. Its
//! nuclear norm (sum of singular values) is the largest correlation that any
//! rotation between the sensors can give (`max tr(RᵀM)` over orthogonal `R`), so
//! the search needs no knowledge of how the sensors are mounted.
//!
//! The norm itself favours lags at which much of the motion overlaps, the norm
//! divided by the energies in the overlap favours short overlaps. Peaks of both
//! are returned; the fit decides between them.

use realfft::RealFftPlanner;
use realfft::num_complex::Complex;

use super::spline::Vec3;

/// Bin width of the search in seconds.
pub const BIN_S: f64 = 0.01;

/// How many peaks of each of the two scores are handed on.
const PEAKS: usize = 6;

/// A lag worth refining.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// `b`'s relative time minus `a`'s relative time, in seconds.
    pub lag_s: f64,
    /// Correlation in the overlap, 0 to 1.
    pub correlation: f64,
}

/// Mean rate in bins of [`BIN_S`], mean-free, starting at `t[0]`; empty bins are zero.
fn binned(t: &[f64], w: &[Vec3], usable: &[bool]) -> Option<(f64, Vec<Vec3>)> {
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

/// The lags at which the two recordings may belong together, best first.
///
/// Lags with less than `min_overlap_s` in common are not looked at.
#[must_use]
pub fn candidates(
    a: (&[f64], &[Vec3], &[bool]),
    b: (&[f64], &[Vec3], &[bool]),
    min_overlap_s: f64,
) -> Vec<Candidate> {
    let (Some((start_a, a)), Some((start_b, b))) = (binned(a.0, a.1, a.2), binned(b.0, b.1, b.2))
    else {
        return Vec::new();
    };
    let size = (a.len() + b.len()).next_power_of_two();
    let mut planner = RealFftPlanner::<f64>::new();
    let forward = planner.plan_fft_forward(size);
    let inverse = planner.plan_fft_inverse(size);
    let spectrum = |x: &[Vec3], axis: usize| -> Option<Vec<Complex<f64>>> {
        let mut input = vec![0.0; size];
        for (slot, v) in input.iter_mut().zip(x) {
            *slot = v[axis];
        }
        let mut output = forward.make_output_vec();
        forward.process(&mut input, &mut output).ok()?;
        Some(output)
    };
    let mut spectra = Vec::new();
    for x in [&a, &b] {
        for axis in 0..3 {
            match spectrum(x, axis) {
                Some(s) => spectra.push(s),
                None => return Vec::new(),
            }
        }
    }
    let mut correlation = Vec::with_capacity(9);
    for row in 0..3 {
        for column in 0..3 {
            let mut product: Vec<Complex<f64>> = spectra[3 + row]
                .iter()
                .zip(&spectra[column])
                .map(|(y, x)| y * x.conj())
                .collect();
            // The ends of a real signal's spectrum are real; rounding must not
            // leave an imaginary part there.
            if let Some(first) = product.first_mut() {
                first.im = 0.0;
            }
            if let Some(last) = product.last_mut() {
                last.im = 0.0;
            }
            let mut output = inverse.make_output_vec();
            if inverse.process(&mut product, &mut output).is_err() {
                return Vec::new();
            }
            correlation.push(output);
        }
    }

    let energy = |x: &[Vec3]| {
        let mut sums = Vec::with_capacity(x.len() + 1);
        sums.push(0.0);
        let mut total = 0.0;
        for v in x {
            total += v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
            sums.push(total);
        }
        sums
    };
    let (energy_a, energy_b) = (energy(&a), energy(&b));
    let least = 0.05 * energy_a[a.len()].min(energy_b[b.len()]);
    let min_bins = ((min_overlap_s / BIN_S) as i64).max(1);

    // Lag l pairs a[i] with b[i + l].
    let lags = -(a.len() as i64 - min_bins)..=(b.len() as i64 - min_bins);
    if lags.is_empty() {
        return Vec::new();
    }
    let first_lag = *lags.start();
    let mut norms = Vec::new();
    let mut normalised = Vec::new();
    for lag in lags {
        let at = lag.rem_euclid(size as i64) as usize;
        let mut m = [[0.0; 3]; 3];
        for row in 0..3 {
            for column in 0..3 {
                m[row][column] = correlation[row * 3 + column][at] / size as f64;
            }
        }
        let norm = nuclear_norm(&m);
        let from = (-lag).max(0) as usize;
        let to = (a.len() as i64).min(b.len() as i64 - lag).max(0) as usize;
        let ea = energy_a[to] - energy_a[from];
        let eb = energy_b[(to as i64 + lag) as usize] - energy_b[(from as i64 + lag) as usize];
        norms.push(norm);
        normalised.push(if ea.min(eb) > least && ea * eb > 0.0 {
            (norm / (ea * eb).sqrt()).min(1.0)
        } else {
            0.0
        });
    }
    let mut found: Vec<Candidate> = Vec::new();
    for score in [&norms, &normalised] {
        for (i, fine) in peaks(score) {
            let lag_s = (first_lag as f64 + i as f64 + fine) * BIN_S + start_b - start_a;
            if found.iter().all(|c| (c.lag_s - lag_s).abs() > 3.0 * BIN_S) {
                found.push(Candidate {
                    lag_s,
                    correlation: normalised[i],
                });
            }
        }
    }
    found
}

/// The highest local maxima with their sub-bin position (parabola).
fn peaks(score: &[f64]) -> Vec<(usize, f64)> {
    let mut maxima: Vec<usize> = (0..score.len())
        .filter(|&i| {
            let left = if i > 0 {
                score[i - 1]
            } else {
                f64::NEG_INFINITY
            };
            let right = score.get(i + 1).copied().unwrap_or(f64::NEG_INFINITY);
            score[i] > 0.0 && score[i] >= left && score[i] > right
        })
        .collect();
    maxima.sort_by(|&x, &y| score[y].total_cmp(&score[x]));
    maxima.truncate(PEAKS);
    maxima
        .into_iter()
        .map(|i| {
            let fine = if i > 0 && i + 1 < score.len() {
                let curvature = score[i - 1] - 2.0 * score[i] + score[i + 1];
                if curvature < 0.0 {
                    (0.5 * (score[i - 1] - score[i + 1]) / curvature).clamp(-0.5, 0.5)
                } else {
                    0.0
                }
            } else {
                0.0
            };
            (i, fine)
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
        assert!((found[0].lag_s - 0.73).abs() < 0.005, "{found:?}");
    }
}
