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
//! The data alone do not decide on τ and T: the estimates for all (τ, T) of a grid
//! are averaged, each weighted by its restricted likelihood (Harville 1974) and by the
//! prior. That is honest where a swing cannot be seen, and exact where it can.
//!
//! Limits: a swing about as long as the twist bends the rate and hardly shows otherwise.
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
    let locals = locals(fit, oversampling);
    let prior_none = NONE[classes.min(NONE.len() - 1)];
    let no_shape = DMatrix::zeros(locals.len(), locals.len());
    let none = given(&locals, 0.0, &no_shape, prior_none);
    let Some(none) = none.filter(|_| locals.len() > 6) else {
        return;
    };
    // The larger, the rarer: in proportion to 1/√size.
    let lengths = lengths_s(&locals);
    let rarity = |size: f64| 1.0 / size.sqrt();
    let sum = SIZES_S.iter().copied().map(rarity).sum::<f64>() * lengths.len() as f64;
    let prior = |size: f64| (1.0 - prior_none) * rarity(size) / sum;
    let swings = lengths.iter().flat_map(|&length| {
        let shape = shape(&locals, length);
        let at = |size| given(&locals, size, &shape, prior(size));
        SIZES_S.into_iter().filter_map(at).collect::<Vec<_>>()
    });
    let all: Vec<Supposed<2>> = std::iter::once(none).chain(swings).collect();
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
fn locals(fit: &Fit, oversampling: f64) -> Vec<Local> {
    // Coloured noise counts as the fit found it.
    let colour = fit.covariance[(0, 0)] / fit.ideal_covariance[(0, 0)].max(f64::MIN_POSITIVE);
    let noise = oversampling * colour.max(1.0);
    let parts = fit.parts(PARTS).into_iter().filter(|part| part.is_whole);
    let local = |part: Part| Local {
        u: part.moment / part.information,
        shift_s: part.score / part.information,
        variance: noise / part.information,
    };
    parts.map(local).collect()
}

/// Correlation of the displacements of the parts by a swing of this length.
fn shape(locals: &[Local], length_s: f64) -> DMatrix<f64> {
    DMatrix::from_fn(locals.len(), locals.len(), |r, c| {
        if c > r {
            return 0.0; // the decomposition reads the other half
        }
        let square = ((locals[r].u - locals[c].u) / length_s).powi(2);
        (1.0 - 2.0 * square + square * square / 3.0) * (-0.5 * square).exp()
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
        likelihood_ln: -ln_volume - 0.5 * (normal.determinant().ln() + square),
        mean: mean * unit.sqrt(),
        covariance: inverse * unit,
    })
}
