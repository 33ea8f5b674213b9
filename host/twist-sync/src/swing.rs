//! Time errors that change slowly: their uncertainty, and the estimate with them.
//!
//! The timestamps of a phone may swing against the content over seconds, by tens of µs.
//! The long-run covariance of the fit reaches over 0.3 s only and takes such a swing for
//! a part of the relation. So the local displacements `d` of the overlap, each from the
//! same information, are taken once more as `d = shift + rate·u + g(u) + noise`, with `g`
//! a stationary process of rms τ and length T. Its covariance is
//! `τ²·(1 − 2x² + x⁴/3)·exp(−x²/2)`, `x = distance/T`: that of the second derivative of a
//! process with Gaussian covariance. Its power is at periods around `π·T` and none at
//! frequency zero: timestamps that are steered overshoot and come back.
//!
//! Stamps may also wander by some µs without coming back: `g` then has the covariance
//! `τ²·exp(−distance/T)`. Residuals of the one real twist have 2.5 µs, correlated by 0.68 at
//! 0.1 s and by 0.20 at 1 s.
//!
//! The data alone do not decide on τ and T: the estimates for all (τ, T) of a grid
//! are averaged, each weighted by its restricted likelihood (Harville 1974) and by the
//! prior. That is honest where a swing cannot be seen, and exact where it can.
//!
//! Limits: a wander of a few µs that is correlated over seconds does not show within a twist: of
//! 5 µs over 2 s the error is twice what is stated, and a prior that covers it would state
//! twice too much of stamps without. A swing about as long as the twist bends the rate and hardly shows otherwise.
//! Its uncertainty is the prior's: right on the average over swings of all periods up
//! to twice the twist, too little for one whose period is always the worst.

use nalgebra::{DMatrix, Matrix2, MatrixXx3, Vector2};

use crate::fit::{Fit, Part};
use crate::mixture::{Supposed, mixed};

/// Parts of equal information.
const PARTS: f64 = 32.0;
/// Sizes of a swing, seconds.
const SIZES_S: [f64; 7] = [8e-6, 16e-6, 32e-6, 64e-6, 128e-6, 256e-6, 512e-6];
/// Its longest, as a part of the overlap: a period of 1.8 overlaps. What is slower
/// bends neither the rate much nor the offset away from its mean over the time around. The
/// next is half as long.
const LONGEST: f64 = 0.57;
/// None is shorter, seconds: a period of 1.6 s.
const SHORTEST_S: f64 = 0.5;
/// Sizes of a wander, seconds, and the times over which it is correlated.
const WANDERS_S: [f64; 5] = [2.5e-6, 5e-6, 10e-6, 20e-6, 40e-6];
const MEMORIES_S: [f64; 3] = [0.25, 0.7, 2.0];
/// Prior probability of a wander where there is no swing, in proportion to its size: what is
/// small hardly shows, and would only widen what is stated of stamps without.
const WANDER: f64 = 0.03;
/// Prior probability that there is none, by how many displaced classes were found: a
/// device whose samples belong to other times in several ways is not trusted slowly.
const NONE: [f64; 3] = [0.99, 0.9, 0.1];

/// A part of the overlap.
struct Local {
    /// Time from the reference, seconds.
    u: f64,
    /// Displacement against the fit, seconds.
    shift_s: f64,
    variance: f64,
}

/// Adds slow time errors to the fit's relation and covariance.
pub(crate) fn include_swings(fit: &mut Fit, oversampling: f64, classes: usize) {
    // Coloured noise counts as the fit found it; where it is a wander, the rest is white.
    let colour = fit.covariance[(0, 0)] / fit.ideal_covariance[(0, 0)].max(f64::MIN_POSITIVE);
    let locals = locals(fit, oversampling * colour.max(1.0));
    let white = self::locals(fit, oversampling);
    let prior_none = NONE[classes.min(NONE.len() - 1)];
    let no_shape = DMatrix::zeros(locals.len(), locals.len());
    let none = given(&locals, 0.0, &no_shape, prior_none * (1.0 - WANDER));
    let Some(none) = none.filter(|_| locals.len() > 6) else {
        return;
    };
    // The larger, the rarer: in proportion to 1/√size.
    let lengths = lengths_s(&locals);
    let rarity = |size: f64| 1.0 / size.sqrt();
    let sum = SIZES_S.iter().copied().map(rarity).sum::<f64>() * lengths.len() as f64;
    let swings = lengths.iter().flat_map(|&length| {
        let shape = shape(&locals, |u| {
            let square = (u / length).powi(2);
            (1.0 - 2.0 * square + square * square / 3.0) * (-0.5 * square).exp()
        });
        let prior = (1.0 - prior_none) / sum;
        let at = |size| given(&locals, size, &shape, prior * rarity(size));
        SIZES_S.into_iter().filter_map(at).collect::<Vec<_>>()
    });
    let wanders = MEMORIES_S.into_iter().flat_map(|memory| {
        let shape = shape(&white, |u| (-u.abs() / memory).exp());
        let sum = WANDERS_S.iter().sum::<f64>() * MEMORIES_S.len() as f64;
        let prior = |size: f64| prior_none * WANDER * size / sum;
        let at = |size| given(&white, size, &shape, prior(size));
        WANDERS_S.into_iter().filter_map(at).collect::<Vec<_>>()
    });
    let all: Vec<Supposed<2>> = std::iter::once(none).chain(swings).chain(wanders).collect();
    let (mean, covariance) = mixed(&all);
    let moved = mean - none.mean;
    fit.link.at_model += moved[0];
    fit.link.rate += moved[1];
    let added = covariance - none.covariance;
    // Rounding may leave less than zero.
    if added[(0, 0)] > 0.0 && added[(1, 1)] > 0.0 {
        fit.covariance += added;
    }
}

/// The lengths of swings that are looked for, seconds.
fn lengths_s(locals: &[Local]) -> Vec<f64> {
    let span_s = locals.last().map_or(0.0, |l| l.u) - locals.first().map_or(0.0, |l| l.u);
    let shorter = |length: &f64| Some(0.5 * length).filter(|&next| next >= SHORTEST_S);
    let longest = (LONGEST * span_s).max(SHORTEST_S);
    std::iter::successors(Some(longest), shorter).collect()
}

/// The overlap in parts of equal information.
fn locals(fit: &Fit, noise: f64) -> Vec<Local> {
    let parts = fit.parts(PARTS).into_iter().filter(|part| part.is_whole);
    let local = |part: Part| Local {
        u: part.moment / part.information,
        shift_s: part.score / part.information,
        variance: noise / part.information,
    };
    parts.map(local).collect()
}

/// Correlation of the displacements of the parts, as it is at a distance in time.
fn shape(locals: &[Local], at: impl Fn(f64) -> f64) -> DMatrix<f64> {
    DMatrix::from_fn(locals.len(), locals.len(), |r, c| match c > r {
        true => 0.0, // the decomposition reads the other half
        false => at(locals[r].u - locals[c].u),
    })
}

/// Generalised least squares of the displacements on shift and rate under a swing.
fn given(locals: &[Local], size_s: f64, shape: &DMatrix<f64>, prior: f64) -> Option<Supposed<2>> {
    let n = locals.len();
    // In units of the mean variance, so that no figure is tiny.
    let unit = locals.iter().map(|l| l.variance).sum::<f64>() / n.max(1) as f64;
    let variance = |r: usize, c: usize| {
        let swing = size_s * size_s * shape[(r, c)];
        (swing + if r == c { locals[r].variance } else { 0.0 }) / unit
    };
    let cholesky = DMatrix::from_fn(n, n, variance).cholesky()?;
    // Shift, rate and displacement, decorrelated.
    let mut columns = MatrixXx3::from_fn(n, |r, c| match c {
        0 => 1.0,
        1 => locals[r].u,
        _ => locals[r].shift_s / unit.sqrt(),
    });
    if !cholesky.l_dirty().solve_lower_triangular_mut(&mut columns) {
        return None;
    }
    let products = columns.tr_mul(&columns);
    let normal: Matrix2<f64> = products.fixed_view::<2, 2>(0, 0).into_owned();
    let right = Vector2::new(products[(0, 2)], products[(1, 2)]);
    let inverse = normal.try_inverse()?;
    let mean = inverse * right;
    let square = products[(2, 2)] - right.dot(&mean);
    let ln_volume: f64 = cholesky.l_dirty().diagonal().iter().map(|d| d.ln()).sum();
    Some(Supposed {
        prior,
        likelihood_ln: -ln_volume
            - 0.5 * (normal.determinant().ln() + square + (n as f64 - 2.0) * unit.ln()),
        mean: mean * unit.sqrt(),
        covariance: inverse * unit,
    })
}
