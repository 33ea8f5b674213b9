//! Mixture of hypotheses, each with its Gaussian.

use nalgebra::{SMatrix, SVector};

/// State under one hypothesis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Supposed<const N: usize> {
    /// Its prior probability, or a multiple of it.
    pub prior: f64,
    /// Logarithm of its likelihood, less a constant.
    pub likelihood_ln: f64,
    /// Mean under it.
    pub mean: SVector<f64, N>,
    /// Covariance under it.
    pub covariance: SMatrix<f64, N, N>,
}

/// Mean and covariance of all together, each by its probability.
#[must_use]
pub fn mixed<const N: usize>(all: &[Supposed<N>]) -> (SVector<f64, N>, SMatrix<f64, N, N>) {
    let best = all.iter().map(|supposed| supposed.likelihood_ln);
    let best = best.fold(f64::NEG_INFINITY, f64::max);
    let weight = |supposed: &Supposed<N>| supposed.prior * (supposed.likelihood_ln - best).exp();
    let weights: Vec<f64> = all.iter().map(weight).collect();
    let sum: f64 = weights.iter().sum();
    let weighed = || all.iter().zip(weights.iter().map(|weight| weight / sum));
    let mean: SVector<f64, N> = weighed().map(|(own, weight)| own.mean * weight).sum();
    let covariance = weighed()
        .map(|(own, weight)| {
            let apart = own.mean - mean;
            (own.covariance + apart * apart.transpose()) * weight
        })
        .sum();
    (mean, covariance)
}
