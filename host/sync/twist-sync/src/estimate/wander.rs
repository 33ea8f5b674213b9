//! Time errors that change slowly: their uncertainty, and the estimate with them.
//!
//! The timestamps of a phone wander against the content: residuals of the one real twist have
//! 2.5 µs, correlated by 0.68 at 0.1 s and by 0.20 at 1 s. The long-run covariance of the fit
//! reaches over 0.3 s only and mistakes a slow wander for a part of the relation. So the local
//! displacements `d` of the overlap, each from the same information, are taken once more as
//! `d = shift + rate·u + g(u) + noise`, with `g` a stationary process of rms τ and the
//! covariance `τ²·exp(−distance/T)`.
//!
//! The data alone do not determine τ and T. So the estimates for all (τ, T) of a grid, for white
//! noise and for noise of the colour that the fit has found, are averaged, each weighted by its
//! restricted likelihood (Harville 1974) and by the prior: the sigma is right on average where
//! a wander cannot be seen, and exact where it can.
//!
//! Limits: a small or slow wander hardly shows within a twist, and its uncertainty is the
//! prior's: right on average over streams with and without a wander.

use super::fit::{Fit, Part};
use crate::mixture::{Supposed, mixed};
use crate::slow::{Point, Process, line};

/// Parts of equal information.
const PARTS: f64 = 32.0;
/// Rms of a wander, seconds, and the times over which it is correlated.
const SIZES_S: [f64; 6] = [2.5e-6, 5e-6, 10e-6, 20e-6, 40e-6, 80e-6];
const MEMORIES_S: [f64; 3] = [0.25, 0.7, 2.0];
/// Prior probability that there is no wander, with white noise and with coloured noise (a mount
/// that gives way); all wanders are equally likely.
const NONE: [f64; 2] = [0.8, 0.05];

/// Adds slow time errors to the fit's relation and covariance.
pub(crate) fn include_wander(fit: &mut Fit, oversampling: f64) {
    let colour = fit.covariance[(0, 0)] / fit.ideal_covariance[(0, 0)].max(f64::MIN_POSITIVE);
    let coloured = locals(fit, oversampling * colour.max(1.0));
    let white = locals(fit, oversampling);
    let none = given(&coloured, 0.0, 1.0, NONE[1]);
    let Some(none) = none.filter(|_| coloured.len() > 6) else {
        return;
    };
    let is_white = given(&white, 0.0, 1.0, NONE[0]);
    let prior = (1.0 - NONE[0] - NONE[1]) / (SIZES_S.len() * MEMORIES_S.len()) as f64;
    let wanders = MEMORIES_S.iter().flat_map(|&memory| {
        let at = |size| given(&white, size, memory, prior);
        SIZES_S.into_iter().filter_map(at).collect::<Vec<_>>()
    });
    let all: Vec<Supposed<2>> = is_white.into_iter().chain([none]).chain(wanders).collect();
    let (mean, covariance) = mixed(&all);
    let moved = mean - none.mean;
    fit.link.at_model += moved[0];
    fit.link.rate += moved[1];
    let added = covariance - none.covariance;
    // No less than the fit has found.
    if added[(0, 0)] > 0.0 && added[(1, 1)] > 0.0 {
        fit.covariance += added;
    }
}

fn given(points: &[Point], size_s: f64, memory_s: f64, prior: f64) -> Option<Supposed<2>> {
    let process = Process {
        size_s,
        memory_s,
        is_smooth: false,
    };
    line(points, process, prior)
}

/// The overlap in parts of equal information.
fn locals(fit: &Fit, noise: f64) -> Vec<Point> {
    let parts = fit.parts(PARTS).into_iter().filter(|part| part.is_whole);
    let local = |part: Part| Point {
        u: part.moment / part.information,
        y: part.score / part.information,
        variance: noise / part.information,
    };
    parts.map(local).collect()
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;

    /// Parts of a twist of nine seconds, each with 13.7 µs of white noise as in the base scenario,
    /// under a wander.
    fn twist(size_s: f64, memory_s: f64, normal: &mut impl FnMut() -> f64) -> Vec<Point> {
        let step = 9.0 / PARTS;
        let kept = (-step / memory_s).exp();
        let mut wander = size_s * normal();
        let part = |n| {
            wander = kept * wander + size_s * (1.0 - kept * kept).sqrt() * normal();
            Point {
                u: f64::from(n) * step - 4.5,
                y: wander + 13.7e-6 * normal(),
                variance: 13.7e-6 * 13.7e-6,
            }
        };
        (0..PARTS as u32).map(part).collect()
    }

    /// Share of twists, half of them without a wander, that the likelihoods classify correctly
    /// if size and memory are known.
    fn classified(size_s: f64, memory_s: f64) -> f64 {
        let mut random = Pcg64::seed_from_u64(1);
        let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        let trials = 2_000;
        let right = (0..trials).filter(|trial| {
            let wanders = trial % 2 == 0;
            let size = if wanders { size_s } else { 0.0 };
            let locals = twist(size, memory_s, &mut normal);
            let [with, without] =
                [size_s, 0.0].map(|size| given(&locals, size, memory_s, 1.0).unwrap());
            (with.likelihood_ln > without.likelihood_ln) == wanders
        });
        right.count() as f64 / f64::from(trials)
    }

    /// The reason why the sigma under a slow wander is too small: even with all parameters
    /// known, a twist does not show the wander.
    #[test]
    fn a_large_wander_is_recognised_and_a_slow_one_hardly() {
        let slow = classified(5e-6, 2.0);
        let large = classified(20e-6, 0.5);
        println!("5 µs over 2 s: {slow:.3}, 20 µs over 0.5 s: {large:.3}");
        assert!((0.53..0.63).contains(&slow), "{slow}");
        assert!(large > 0.92, "{large}");
    }
}
