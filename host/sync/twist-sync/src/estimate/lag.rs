//! The choice among the coarse lags: a quick fit at each.

use nalgebra::Matrix3;

use super::coarse;
use super::fit::{self, Fit, FitOptions, Link};
use super::gates::Gate;
use super::options::Options;
use super::pair::{Pair, Settings, Signals};
use super::report::Report;
use super::rigid::{self, Stretch};
use crate::signal::interpolant::Vec3;

/// Distance below which the lags of two quick fits count as one, seconds.
const SAME_LAG_S: f64 = 0.02;
/// Least distance of the nodes of a quick fit, seconds.
const NODE_S: f64 = 0.01;
/// Most nodes of a quick fit: those of a minute.
const MOST_NODES: usize = 6000;

/// A lag that was tried.
struct Tried {
    /// `n · ln(unexplained)`: smaller is stronger.
    evidence: f64,
    /// Residual power over the motion's.
    unexplained: f64,
    fit: Fit,
}

impl Tried {
    fn new(fit: Fit) -> Option<Self> {
        let motion = fit.motion_variance();
        if motion.is_nan() || motion <= 0.0 {
            return None;
        }
        let unexplained = (fit.residual_variance() / motion).max(1e-14);
        Some(Self {
            evidence: fit.nodes.len() as f64 * unexplained.ln(),
            unexplained,
            fit,
        })
    }
}

/// Distance between the lags of two fits, seconds.
fn apart_s(one: &Fit, other: &Fit) -> f64 {
    (one.link.lag_s() - other.link.lag_s()).abs()
}

/// Returns the lag that explains the motion best, and the stretches that it does not explain
/// (in the data's time); `None` if a gate is not passed.
pub(crate) fn chosen(
    pair: &Pair<'_>,
    signals: &Signals,
    options: &Options,
    settings: &Settings,
    report: &mut Report,
) -> Option<(Link, Vec<Stretch>)> {
    // Over minutes every bin is more than the choice needs.
    let (model, mut data) = (&signals.model.signal, signals.data.signal.sampled(NODE_S));
    let every = data.len().div_ceil(MOST_NODES).max(1);
    let node_s = NODE_S * every as f64;
    if every > 1 {
        data = data.into_iter().step_by(every).collect();
    }
    let quick = FitOptions {
        iterations: 8,
        settled_s: 1e-6,
        oversampling: 1.0,
        // The sigma of a trial's shift is not used.
        memory_s: 0.0,
        ..settings.fit
    };
    let at = |data: &[(f64, Vec3)], lag_s: f64| {
        let start = Link {
            at_model: 0.0,
            at_data: lag_s,
            rate: 1.0,
        };
        let even = Some(Matrix3::identity());
        Tried::new(fit::fit(model, data, start, even, &quick)?)
    };
    let tried = distinct(&candidates(pair, options), |lag_s| at(&data, lag_s));
    let nodes = tried.first().map_or_else(
        // Nothing fits at any lag, which says nothing about the time in common.
        || data.len().min(model.sampled(node_s).len()),
        |best| best.fit.nodes.len(),
    );
    let overlap_s = nodes as f64 * node_s;
    report.judge(Gate::overlap(overlap_s, options.min_overlap_s))?;
    let Some(best) = tried.first() else {
        return report.judge(Gate::explained(1.0)).and(None);
    };
    let lags: Vec<f64> = tried.iter().map(|t| t.fit.link.lag_s()).collect();
    let whole = rigid::is_whole(&best.fit, settings.fit.noise_variance);
    // There is no search for a part if the best explains all, or faults are not handled. If it
    // explains most, it is the lag; otherwise the largest part that any lag explains decides.
    let parts_of = if whole || !options.handle_faults {
        &[]
    } else if best.unexplained.sqrt() < Gate::MOSTLY_EXPLAINED {
        &tried[..1]
    } else {
        &tried[..]
    };
    let part = parts_of
        .iter()
        .filter_map(|tried| rigid::part(model, &data, &tried.fit, &lags, quick))
        .min_by(|x, y| x.evidence().total_cmp(&y.evidence()));
    let Some(part) = part else {
        report.judge(Gate::explained(best.unexplained.sqrt()))?;
        report.judge(Gate::unique_peak(rival(best, &tried[1..])))?;
        return Some((best.fit.link, Vec::new()));
    };
    report.judge(Gate::explained(part.unexplained.sqrt()))?;
    // The rivals explain the same nodes.
    let kept = part.kept(&data);
    let others = distinct(&lags, |lag_s| at(&kept, lag_s));
    let (chosen, others): (Vec<Tried>, Vec<Tried>) = others
        .into_iter()
        .partition(|other| apart_s(&other.fit, &part.fit) < SAME_LAG_S);
    let chosen = chosen
        .into_iter()
        .next()
        .or_else(|| Tried::new(part.fit.clone()))?;
    report.judge(Gate::unique_peak(rival(&chosen, &others)))?;
    Some((part.fit.link, part.stretches))
}

/// Factor by which the residual power of the best rival is larger. Rivals whose evidence is far
/// weaker (short overlaps, where anything fits) do not count.
fn rival(best: &Tried, others: &[Tried]) -> f64 {
    others
        .iter()
        .filter(|other| other.evidence < 0.5 * best.evidence)
        .map(|other| other.unexplained / best.unexplained)
        .fold(f64::INFINITY, f64::min)
}

/// Candidate lags in seconds, the data's time minus the model's.
fn candidates(pair: &Pair<'_>, options: &Options) -> Vec<f64> {
    let (model, data) = (&pair.model, &pair.data);
    let mut candidates = coarse::candidates(
        (&model.t, &model.w, &model.usable),
        (&data.t, &data.w, &data.usable),
        options.min_overlap_s,
    );
    if let Some((centre, half_width)) = options.search {
        let offset = if pair.a_is_model { centre } else { -centre };
        let expected = offset + model.epoch_s - data.epoch_s;
        candidates.retain(|lag_s| (lag_s - expected).abs() <= half_width);
    }
    candidates
}

/// Quick fits at the candidates, the strongest first, one for each lag.
fn distinct(candidates: &[f64], fitted: impl Fn(f64) -> Option<Tried>) -> Vec<Tried> {
    let mut tried: Vec<Tried> = Vec::new();
    for &lag_s in candidates {
        if let Some(now) = fitted(lag_s)
            && tried
                .iter()
                .all(|other| apart_s(&other.fit, &now.fit) >= SAME_LAG_S)
        {
            tried.push(now);
        }
    }
    tried.sort_by(|x, y| x.evidence.total_cmp(&y.evidence));
    tried
}
