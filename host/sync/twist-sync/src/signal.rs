//! Conversion of samples at uneven times to a continuous, low-passed angular rate.
//!
//! 1. The usable samples are cut into pieces wherever the distance between
//!    neighbours is too long to be bridged.
//! 2. Each piece is interpolated ([`Uneven`]) at its true, uneven times.
//! 3. The interpolant is sampled on a uniform grid no coarser than the data
//!    ([`Resampled`]) and filtered with a Gaussian, which is zero-phase: it cannot move
//!    the answer. Nodes whose kernel would reach beyond the piece are dropped, so that
//!    no edge effect exists.
//! 4. The filtered nodes are interpolated again ([`Uniform`]), which gives the smooth
//!    rate and its derivative at any time.
//!
//! The filter costs no information about the offset: only noise inside the band
//! of the motion's derivative matters for it. The filter removes the noise of the derivative
//! outside of that band.

pub mod interpolant;
pub(crate) mod neighbours;

use std::cell::OnceCell;

use self::interpolant::{Uneven, Uniform, Vec3};

/// Reach of the Gaussian kernel, in standard deviations. The
/// truncation error is 7·10⁻⁶ of the kernel's weight, the same on both sides.
const KERNEL_REACH: f64 = 4.5;

/// Least number of nodes in a standard deviation of the kernel.
const NODES: f64 = 2.5;

/// Least number of nodes of a piece; shorter ones are left out.
const LEAST_NODES: usize = 10;

/// Low-pass for which the grid is fine enough at least, Hz: outliers are searched for with a
/// wider low-pass than the fit's.
const GRID_LOW_PASS_HZ: f64 = 25.0;

/// Largest distance of neighbours that is bridged: the larger of this number of steps and this
/// time in seconds.
const BRIDGED_STEPS: f64 = 3.6;
const BRIDGED_S: f64 = 0.01;

/// Standard deviation in seconds of the Gaussian kernel that has fallen by 3 dB at a frequency.
pub(crate) fn kernel_sigma_s(low_pass_hz: f64) -> f64 {
    std::f64::consts::LN_2.sqrt() / (std::f64::consts::TAU * low_pass_hz)
}

/// Length in seconds of white noise whose variance that kernel leaves.
pub(crate) fn kernel_length_s(low_pass_hz: f64) -> f64 {
    2.0 * std::f64::consts::PI.sqrt() * kernel_sigma_s(low_pass_hz)
}

/// The usable samples on an even grid, piece by piece, before any filter.
#[derive(Debug, Clone)]
pub(crate) struct Resampled {
    /// Begin, and the rates from there on.
    pieces: Vec<(f64, Vec<Vec3>)>,
    grid: f64,
}

impl Resampled {
    /// Resamples the samples with `usable[k]`, in increasing time, for filters as narrow as
    /// one of `low_pass_hz`.
    ///
    /// `sample_step_s` is the typical distance between neighbours.
    pub(crate) fn new(
        t: &[f64],
        w: &[Vec3],
        usable: &[bool],
        sample_step_s: f64,
        low_pass_hz: f64,
    ) -> Self {
        let sigma = kernel_sigma_s(low_pass_hz);
        // Steps so small that no gyroscope has them are a wrong unit of time.
        let coarsest = sigma.min(kernel_sigma_s(GRID_LOW_PASS_HZ)) / NODES;
        let grid = sample_step_s.clamp(coarsest / 20.0, coarsest);
        let max_gap_s = (BRIDGED_STEPS * sample_step_s).max(BRIDGED_S);
        let kept = neighbours::kept(usable);
        let pieces = kept
            .chunk_by(|&k, &next| t[next] - t[k] <= max_gap_s)
            .filter_map(|piece| {
                let all = *piece.first()?..*piece.last()? + 1;
                let (times, rates): (Vec<f64>, Vec<Vec3>);
                // Where nothing is left out, nothing is copied.
                let raw = if all.len() == piece.len() {
                    Uneven::new(&t[all.clone()], &w[all])?
                } else {
                    (times, rates) = piece.iter().map(|&k| (t[k], w[k])).unzip();
                    Uneven::new(&times, &rates)?
                };
                let (from, to) = raw.domain();
                Some((from, raw.on_grid(grid, ((to - from) / grid) as usize + 1)))
            })
            .collect();
        Self { pieces, grid }
    }

    /// Returns the low-passed, continuous rate.
    ///
    /// The kernel may be narrower than that of `low_pass_hz`: at 1.4 steps of the grid, that of
    /// 45 Hz, its samples still are a Gaussian to 10⁻¹⁷.
    fn smoothed(&self, low_pass_hz: f64) -> Signal {
        let sigma = kernel_sigma_s(low_pass_hz) / self.grid;
        let kernel = gaussian_kernel(sigma, (KERNEL_REACH * sigma).ceil() as usize);
        let keep_every = ((sigma / NODES) as usize).max(1);
        let smooth = |(from, rates): &(f64, Vec<Vec3>)| {
            let start = from + (kernel.len() / 2) as f64 * self.grid;
            let step = self.grid * keep_every as f64;
            let nodes = filtered(rates, &kernel, keep_every);
            if nodes.len() < LEAST_NODES {
                return None;
            }
            Uniform::new(start, step, nodes)
        };
        let pieces = self.pieces.iter().filter_map(smooth).collect();
        Signal { pieces }
    }
}

/// A stream with its low-passed, continuous rate.
pub(crate) struct Smooth {
    pub(crate) signal: Signal,
    resampled: Resampled,
    wide: OnceCell<Signal>,
}

impl Smooth {
    pub(crate) fn new(resampled: Resampled, low_pass_hz: f64) -> Self {
        Self {
            signal: resampled.smoothed(low_pass_hz),
            resampled,
            wide: OnceCell::new(),
        }
    }

    /// Returns the rate with a narrower low-pass.
    pub(crate) fn narrow(&self, low_pass_hz: f64) -> Signal {
        self.resampled.smoothed(low_pass_hz)
    }

    /// Returns the rate with another low-pass, which must be the same at each call.
    pub(crate) fn wide(&self, low_pass_hz: f64) -> &Signal {
        self.wide
            .get_or_init(|| self.resampled.smoothed(low_pass_hz))
    }
}

/// A continuous angular rate, defined on one or more pieces of time.
#[derive(Debug, Clone)]
pub(crate) struct Signal {
    pieces: Vec<Uniform>,
}

impl Signal {
    fn piece_at(&self, t: f64) -> Option<&Uniform> {
        let after = self.pieces.partition_point(|p| p.domain().0 <= t);
        let piece = &self.pieces[after.checked_sub(1)?];
        (t <= piece.domain().1).then_some(piece)
    }

    /// Returns the smooth value at `t`, or `None` outside of the pieces.
    pub(crate) fn value(&self, t: f64) -> Option<Vec3> {
        Some(self.piece_at(t)?.value(t))
    }

    /// Returns the smooth value and its rate of change at `t`, or `None` outside of the pieces.
    pub(crate) fn at(&self, t: f64) -> Option<(Vec3, Vec3)> {
        Some(self.piece_at(t)?.value_and_rate(t))
    }

    /// Samples the signal every `step` seconds on all its pieces.
    pub(crate) fn sampled(&self, step: f64) -> Vec<(f64, Vec3)> {
        let mut out = Vec::new();
        for piece in &self.pieces {
            let (from, to) = piece.domain();
            let first = (from / step).ceil() as i64;
            let last = (to / step).floor() as i64;
            out.extend((first..=last).filter_map(|k| {
                let t = k as f64 * step;
                (t >= from && t <= to).then(|| (t, piece.value(t)))
            }));
        }
        out
    }
}

/// Normalised Gaussian of `2 · reach + 1` taps; `sigma` in taps.
fn gaussian_kernel(sigma: f64, reach: usize) -> Vec<f64> {
    let mut kernel: Vec<f64> = (0..=2 * reach)
        .map(|k| {
            let x = (k as f64 - reach as f64) / sigma;
            (-0.5 * x * x).exp()
        })
        .collect();
    let sum: f64 = kernel.iter().sum();
    for tap in &mut kernel {
        *tap /= sum;
    }
    kernel
}

/// Every `keep_every`th of the values under the whole kernel, which is symmetric.
fn filtered(rates: &[Vec3], kernel: &[f64], keep_every: usize) -> Vec<Vec3> {
    let reach = kernel.len() / 2;
    let weighed = |near: &[Vec3]| {
        let mut sum = near[reach].map(|v| kernel[reach] * v);
        let both = near[..reach].iter().zip(near[reach + 1..].iter().rev());
        for (tap, (before, after)) in kernel.iter().zip(both) {
            for axis in 0..3 {
                sum[axis] += tap * (before[axis] + after[axis]);
            }
        }
        sum
    };
    let windows = rates.windows(kernel.len());
    windows.step_by(keep_every).map(weighed).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn filter_has_no_delay_and_its_stated_width() {
        // 25 Hz sine: must come out in phase at 1/sqrt(2) of its height.
        let t: Vec<f64> = (0..2000)
            .map(|k| 0.002 * k as f64 + 1e-4 * (k as f64).sin())
            .collect();
        let f = std::f64::consts::TAU * 25.0;
        let w: Vec<Vec3> = t.iter().map(|&x| [(f * x).sin(), 0.0, 0.0]).collect();
        let s = Resampled::new(&t, &w, &vec![true; t.len()], 0.002, 25.0).smoothed(25.0);
        let mut worst: f64 = 0.0;
        for k in 0..1000 {
            let x = 1.0 + 0.001 * k as f64;
            let (v, _) = s.at(x).unwrap();
            worst = worst.max((v[0] - (f * x).sin() * 0.5_f64.sqrt()).abs());
        }
        assert!(worst < 2e-4, "{worst}");
    }

    #[test]
    fn gaps_split_the_signal() {
        let t: Vec<f64> = (0..1000).map(|k| 0.002 * k as f64).collect();
        let w = vec![[1.0, 2.0, 3.0]; 1000];
        let mut usable = vec![true; 1000];
        usable[500..520].fill(false);
        let s = Resampled::new(&t, &w, &usable, 0.002, 25.0).smoothed(25.0);
        assert!(s.at(1.02).is_none());
        assert!(s.at(0.99).is_none(), "the kernel reaches into the gap");
        assert!(s.at(0.9).is_some() && s.at(1.2).is_some());
        assert!(s.at(-1.0).is_none() && s.at(5.0).is_none());
        let covered_s: f64 = s.pieces.iter().map(|p| p.domain().1 - p.domain().0).sum();
        assert!(covered_s > 1.8 && covered_s < 1.96);
    }
}
