//! A straight line through values that err slowly.
//!
//! `y = shift + rate·u + g(u) + noise`, where the noise of each value is independent and of known
//! variance, and `g` is a stationary process with rms `size`: of first order, with the covariance
//! `size²·exp(−d/memory)` over the distance `d`, or smooth, with `size²·(1 + x)·exp(−x)` and
//! `x = √3·d/memory` (Matérn 3/2; Rasmussen and Williams, Gaussian Processes for Machine Learning,
//! 4.2.1 and B.2). A Kalman filter removes `g` from the values and from both
//! columns of the line, and least squares of the innovations give shift and rate with the
//! covariance that the process leaves them.
//!
//! Size and memory are unknown. The lines for a grid of memories are averaged, each weighted by
//! its restricted likelihood (Harville, Biometrika 61, 1974) and its prior. The sizes are a grid as
//! well, or, for each memory, dense about the likeliest one: where a process stands out of the
//! noise, its size is known far better than by a factor, but another one for each memory.

use nalgebra::{Matrix2, Matrix2x3, Matrix3, RowVector3, Vector2};

use crate::mixture::Supposed;

/// A value at a time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Point {
    /// Time from the reference, seconds.
    pub(crate) u: f64,
    /// The value, seconds.
    pub(crate) y: f64,
    /// Variance of its own noise, s².
    pub(crate) variance: f64,
}

/// A stationary process.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Process {
    /// Rms, seconds.
    pub(crate) size_s: f64,
    /// Time over which its correlation falls to 1/e, or to one half if it is smooth, seconds.
    pub(crate) memory_s: f64,
    /// True if it has a derivative.
    pub(crate) is_smooth: bool,
}

impl Process {
    /// Covariance of value and derivative.
    fn stationary(self) -> Matrix2<f64> {
        let value = self.size_s * self.size_s;
        let derivative = if self.is_smooth {
            3.0 * value / (self.memory_s * self.memory_s)
        } else {
            0.0
        };
        Matrix2::from_diagonal(&Vector2::new(value, derivative))
    }

    /// Value and derivative, expected `later_s` after they were one.
    fn transition(self, later_s: f64) -> Matrix2<f64> {
        if self.is_smooth {
            let rate = 3.0_f64.sqrt() / self.memory_s;
            let x = rate * later_s;
            Matrix2::new(1.0 + x, later_s, -rate * x, 1.0 - x) * (-x).exp()
        } else {
            Matrix2::new((-later_s / self.memory_s).exp(), 0.0, 0.0, 0.0)
        }
    }
}

/// Returns (shift, rate) at `u = 0` with their covariance, and the restricted likelihood, if the
/// values err by `process`. `None` with fewer than three values.
pub(crate) fn line(points: &[Point], process: Process, prior: f64) -> Option<Supposed<2>> {
    let n = points.len() as f64;
    if n < 3.0 {
        return None;
    }
    // In units of the mean variance, so that no figure is tiny.
    let unit = points.iter().map(|p| p.variance).sum::<f64>() / n;
    let stationary = process.stationary() / unit;
    let (mut variance, mut ln_volume) = (stationary, 0.0);
    // The filter's expectation of shift, rate and value, with derivatives; products of the
    // innovations.
    let mut expected = Matrix2x3::zeros();
    let mut products = Matrix3::zeros();
    let mut before = points.first()?.u;
    for point in points {
        let transition = process.transition(point.u - before);
        before = point.u;
        expected = transition * expected;
        variance = stationary + transition * (variance - stationary) * transition.transpose();
        let row = RowVector3::new(1.0, point.u, point.y / unit.sqrt());
        let innovation = row - expected.row(0);
        let spread = variance[(0, 0)] + point.variance / unit;
        products += innovation.transpose() * innovation / spread;
        ln_volume += 0.5 * spread.ln();
        let gain = variance.column(0) / spread;
        expected += gain * innovation;
        variance -= gain * variance.row(0);
    }
    let normal: Matrix2<f64> = products.fixed_view::<2, 2>(0, 0).into_owned();
    let right = Vector2::new(products[(0, 2)], products[(1, 2)]);
    let inverse = normal.try_inverse()?;
    let mean = inverse * right;
    let square = products[(2, 2)] - right.dot(&mean);
    Some(Supposed {
        prior,
        likelihood_ln: -ln_volume
            - 0.5 * (normal.determinant().ln() + square + (n - 2.0) * unit.ln()),
        mean: mean * unit.sqrt(),
        covariance: inverse * unit,
    })
}

/// Evaluations in the search of a size: a range of a factor of 1000 is narrowed to 4 %.
const SEARCHED: usize = 12;

/// Returns the [`line`] for sizes within a range, dense about the likeliest one, which golden
/// sections of the logarithm find. The prior of each is the part of the logarithm's range that it
/// stands for.
pub(crate) fn of_sizes(
    points: &[Point],
    memory_s: f64,
    is_smooth: bool,
    (low_s, high_s): (f64, f64),
) -> Option<Vec<Supposed<2>>> {
    let golden = 0.5 * (5.0_f64.sqrt() - 1.0);
    let (first, last) = (low_s.ln(), high_s.ln());
    let mut all: Vec<(f64, Supposed<2>)> = Vec::with_capacity(SEARCHED);
    let mut of_size = |size_ln: f64| {
        let size_s = size_ln.exp();
        let process = Process {
            size_s,
            memory_s,
            is_smooth,
        };
        let found = line(points, process, 0.0)?;
        all.push((size_ln, found));
        Some(found.likelihood_ln)
    };
    let (mut low, mut high) = (first, last);
    let inner = |low: f64, high: f64| (high - golden * (high - low), low + golden * (high - low));
    let (mut left, mut right) = inner(low, high);
    let (mut smaller, mut larger) = (of_size(left)?, of_size(right)?);
    for _ in 2..SEARCHED {
        if smaller > larger {
            (high, right, larger) = (right, left, smaller);
            left = inner(low, high).0;
            smaller = of_size(left)?;
        } else {
            (low, left, smaller) = (left, right, larger);
            right = inner(low, high).1;
            larger = of_size(right)?;
        }
    }
    all.sort_by(|x, y| x.0.total_cmp(&y.0));
    let sizes: Vec<f64> = all.iter().map(|one| one.0).collect();
    let between = |k: usize| match k {
        0 => first,
        k if k == sizes.len() => last,
        k => 0.5 * (sizes[k - 1] + sizes[k]),
    };
    let weighed = all.into_iter().enumerate().map(|(k, (_, found))| Supposed {
        prior: (between(k + 1) - between(k)) / (last - first),
        ..found
    });
    Some(weighed.collect())
}
