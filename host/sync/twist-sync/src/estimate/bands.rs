//! Agreement of slow and fast motion about the offset.
//!
//! Bodies bend, mounts give way and filters delay by frequency. Vibration above half the sampling
//! rate is aliased: its phase runs backwards, and both streams show it. All of that is fast, and
//! a rigid motion shows one offset in all bands. So a fit of slow motion is compared with that of
//! the full band, and where they differ, or the full band cannot be explained, the estimate is
//! made once more in each lower band.
//!
//! With `θ_j` the relation from band `j`, the lowest first, and `V_j` its covariance, the steps
//! `θ_j − θ_{j−1}` of right bands are independent, of covariance `V_{j−1} − V_j`. Hypothesis `k` is
//! that bands up to `k` are right, and the steps above contain errors of unknown size. The
//! relation is averaged over all of them.
//!
//! Limits: what is aliased into the lowest band, and what is wrong in all bands alike.

use nalgebra::Vector2;

use super::fit::{self, Fit};
use super::pair::{Pair, Settings, Signals};
use super::{Estimate, Gate, GateKind, Options, Refusal, Warning};
use crate::clock::{ClockRelation, State};
use crate::mixture::{Supposed, mixed};

/// Ratio of neighbouring bands.
const RATIO: f64 = 1.6;
/// Lowest band, Hz: hands and vehicles turn slower, vibration that is aliased below is rare.
const LOWEST_HZ: f64 = 1.4;
/// Square of the difference in sigmas, offset and skew together, from which the bands are
/// compared in full: 1 % of right pairs exceed it.
const DIFFER: f64 = 9.0;
/// Prior probability that motion above a given band shows another relation.
const BIASED: f64 = 0.02;
/// 1-sigma of its errors, of the offset in seconds and of the skew; all are equally likely.
const ERRORS: [[f64; 4]; 2] = [[30e-6, 300e-6, 3e-3, 30e-3], [1e-6, 10e-6, 100e-6, 1e-3]];
/// Least variance of a step in that of the lower band, which is itself estimated.
const LEAST_STEP: f64 = 0.25;
/// Gates that fail if the streams share vibration which is no motion.
const EXPLAINABLE: [GateKind; 8] = [
    GateKind::Explained,
    GateKind::UniquePeak,
    GateKind::OneBody,
    GateKind::Residual,
    GateKind::OneRelation,
    GateKind::Consistent,
    GateKind::Skew,
    GateKind::Settled,
];

/// Unexplained part of the motion's rms from which the two are unrelated, vibration or not.
const UNRELATED: f64 = 0.5;

/// Bands below that of `low_pass_hz`, the lowest first.
fn below(low_pass_hz: f64) -> Vec<f64> {
    let next = |hz: &f64| Some(hz / RATIO).filter(|hz| *hz > LOWEST_HZ);
    let mut all: Vec<f64> = std::iter::successors(next(&low_pass_hz), next).collect();
    all.reverse();
    all
}

/// Returns true if the fit of slow motion contradicts that of the full band.
pub(crate) fn differ(fit: &Fit, pair: &Pair<'_>, signals: &Signals, settings: &Settings) -> bool {
    let bands = below(settings.low_pass_hz);
    let chosen = [bands.first(), bands.get(bands.len() / 2)];
    chosen.into_iter().flatten().any(|&low_pass_hz| {
        let settings = Settings::new(low_pass_hz, pair);
        let data = signals.data.narrow(low_pass_hz).sampled(settings.step_s);
        let model = signals.model.narrow(low_pass_hz);
        let Some(low) = fit::fit(&model, &data, fit.link, None, &settings.fit) else {
            return false;
        };
        let shift = low.link.at_model - fit.link.model_time(low.link.at_data);
        let by = Vector2::new(shift, low.link.rate - fit.link.rate);
        let square = by.component_mul(&by);
        square.component_div(&low.covariance.diagonal()).sum() > DIFFER
    })
}

/// Returns true if vibration can be the reason of a refusal.
pub(crate) fn is_explainable(refusal: &Refusal) -> bool {
    let mut failed = refusal.report.gates.iter().filter(|gate| !gate.passed);
    let is_explainable = |gate: &Gate| {
        let unrelated = gate.kind == GateKind::Explained && gate.value > 1e2 * UNRELATED;
        EXPLAINABLE.contains(&gate.kind) && !unrelated
    };
    failed.clone().next().is_some() && failed.all(is_explainable)
}

/// Joins the result of the full band with those of lower bands, which `estimated` makes.
pub(crate) fn joined(
    full: Result<Estimate, Refusal>,
    differ: bool,
    options: &Options,
    estimated: impl Fn(&Options) -> Result<Estimate, Refusal>,
) -> Result<Estimate, Refusal> {
    let mut bands: Vec<(f64, Estimate)> = Vec::new();
    for low_pass_hz in below(options.low_pass_hz) {
        let options = Options {
            low_pass_hz,
            ..*options
        };
        match estimated(&options) {
            Ok(low) => {
                // Stretches that slow motion lacks as well are no vibration.
                if let Ok(full) = &full
                    && !differ
                    && bands.is_empty()
                    && square(&low.clock, &full.clock) <= DIFFER
                {
                    break;
                }
                bands.push((low_pass_hz, low));
            }
            // What slow motion does not bear out either is no pair.
            Err(refusal) if full.is_err() && is_explainable(&refusal) => break,
            Err(_) => {}
        }
    }
    let lower = bands.len();
    if lower == 0 && differ {
        let mut report = full.map_or_else(|refusal| refusal.report, |estimate| estimate.report);
        report.gates.push(Gate::bands());
        return Err(Refusal { report });
    }
    let is_refused = full.is_err();
    match full {
        Ok(estimate) => bands.push((options.low_pass_hz, estimate)),
        // One band by itself is borne out by none.
        Err(refusal) if lower < 2 => return Err(refusal),
        Err(_) => {}
    }
    let clocks: Vec<ClockRelation> = bands.iter().map(|band| band.1.clock).collect();
    let (clock, best) = averaged(&clocks);
    let (low_pass_hz, mut estimate) = bands.swap_remove(best);
    estimate.clock = clock;
    if best < lower {
        let warning = Warning::LowBand { low_pass_hz };
        estimate.report.warnings.push(warning);
    }
    let sigma = Gate::sigma(estimate.offset_sigma_s(), options.sigma_limit_s);
    estimate.report.rejudge_sigma(|_| sigma);
    if is_refused && best == 0 {
        estimate.report.gates.push(Gate::bands());
    }
    if estimate.report.is_passed() {
        Ok(estimate)
    } else {
        Err(Refusal {
            report: estimate.report,
        })
    }
}

/// Square of the difference of two relations in sigmas of the first.
fn square(low: &ClockRelation, full: &ClockRelation) -> f64 {
    let at = low.reference;
    let by = [full.offset_at(at).value - low.offset, full.skew - low.skew];
    (0..2).map(|k| by[k] * by[k] / low.covariance[k][k]).sum()
}

/// Average of the relations from all bands, the lowest first, and the highest band that most
/// probably is right.
fn averaged(bands: &[ClockRelation]) -> (ClockRelation, usize) {
    let last = &bands[bands.len() - 1];
    let here: Vec<ClockRelation> = bands
        .iter()
        .map(|band| band.referenced_at(last.reference))
        .collect();
    let step = |pair: &[ClockRelation]| {
        let [low, high] = [&pair[0], &pair[1]];
        let by = [high.offset - low.offset, high.skew - low.skew];
        let biased_ln = |k: usize| {
            let [low, high] = [low.covariance[k][k], high.covariance[k][k]];
            let variance = (low - high).max(LEAST_STEP * low);
            let ln = |variance: f64| -0.5 * (by[k] * by[k] / variance + variance.ln());
            let errors = ERRORS[k].map(|error| ln(variance + error * error));
            let most = errors.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let sum: f64 = errors.iter().map(|ln| (ln - most).exp()).sum();
            most + (sum / errors.len() as f64).ln() - ln(variance)
        };
        biased_ln(0) + biased_ln(1)
    };
    // Of each band that it is the highest that is right.
    let mut likelihood_ln = vec![0.0; here.len()];
    for (k, pair) in here.windows(2).enumerate().rev() {
        likelihood_ln[k] = likelihood_ln[k + 1] + step(pair);
    }
    let supposed = |(k, band): (usize, &ClockRelation)| {
        let (mean, covariance) = State::from_relation(band, last.offset).parts();
        let is_last = k + 1 == here.len();
        let biased = BIASED * (here.len() - 1) as f64;
        Supposed {
            prior: if is_last { 1.0 - biased } else { BIASED },
            likelihood_ln: likelihood_ln[k],
            mean,
            covariance,
        }
    };
    let all: Vec<Supposed<2>> = here.iter().enumerate().map(supposed).collect();
    let weight_ln = |k: &usize| all[*k].prior.ln() + all[*k].likelihood_ln;
    let best = (0..all.len()).max_by(|x, y| weight_ln(x).total_cmp(&weight_ln(y)));
    let (mean, covariance) = mixed(&all);
    let clock = ClockRelation {
        offset: last.offset + mean[0],
        skew: mean[1],
        covariance: covariance.into(),
        ..*last
    };
    (clock, best.unwrap_or(0))
}
