//! Mixtures of hypotheses, each with a Gaussian of its own.

use nalgebra::{SMatrix, SVector};

/// State under one hypothesis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Supposed<const N: usize> {
    /// Prior probability of the hypothesis, up to a factor common to all.
    pub prior: f64,
    /// Logarithm of its likelihood, up to a constant common to all.
    pub likelihood_ln: f64,
    /// Mean of the state if the hypothesis is true.
    pub mean: SVector<f64, N>,
    /// Covariance of the state if the hypothesis is true.
    pub covariance: SMatrix<f64, N, N>,
}

/// Returns mean and covariance of the mixture, in which each hypothesis has its posterior
/// probability as weight.
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
