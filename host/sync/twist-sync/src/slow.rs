//! A straight line through values that err slowly.
//!
//! `y = shift + rate·u + g(u) + noise`, where the noise of each value is independent and of known
//! variance, and `g` is a stationary first-order process with rms `size` and the covariance
//! `size²·exp(−distance/memory)`. A Kalman filter removes `g` from the values and from both
//! columns of the line, and least squares of the innovations give shift and rate with the
//! covariance that the process leaves them.
//!
//! Size and memory are unknown. The lines for all pairs of a grid are averaged, each weighted by
//! its restricted likelihood (Harville, Biometrika 61, 1974) and its prior.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

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

/// A first-order process.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Process {
    /// Rms, seconds.
    pub(crate) size_s: f64,
    /// Time over which its correlation falls to 1/e, seconds.
    pub(crate) memory_s: f64,
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
    let stationary = process.size_s * process.size_s / unit;
    let (mut variance, mut ln_volume) = (stationary, 0.0);
    // The filter's expectation of shift, rate and value; products of the innovations.
    let mut expected = Vector3::zeros();
    let mut products = Matrix3::zeros();
    let mut before = points.first()?.u;
    for point in points {
        let kept = (-(point.u - before) / process.memory_s).exp();
        before = point.u;
        expected *= kept;
        variance = stationary + kept * kept * (variance - stationary);
        let row = Vector3::new(1.0, point.u, point.y / unit.sqrt());
        let innovation = row - expected;
        let spread = variance + point.variance / unit;
        products += innovation * innovation.transpose() / spread;
        ln_volume += 0.5 * spread.ln();
        expected += innovation * (variance / spread);
        variance *= 1.0 - variance / spread;
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
