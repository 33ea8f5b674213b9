//! The choice among the coarse lags: a quick fit at each.

use nalgebra::Matrix3;

use crate::Options;
use crate::coarse;
use crate::estimate::Report;
use crate::fit::{self, Fit, FitOptions, Link};
use crate::gates::Gate;
use crate::pair::{Pair, Settings, Signals};

/// Quick fits whose lags are closer than this are one, seconds.
const SAME_LAG_S: f64 = 0.02;

/// A lag that was tried.
struct Tried {
    /// `n · ln(unexplained)`: the smaller, the stronger.
    evidence: f64,
    /// Residual power over the motion's.
    unexplained: f64,
    fit: Fit,
}

impl Tried {
    fn lag_s(&self) -> f64 {
        self.fit.link.data_time(self.fit.link.at_model) - self.fit.link.at_model
    }
}

/// The lag that explains the motion best; `None` if a gate is not passed.
pub(crate) fn chosen(
    pair: &Pair,
    signals: &Signals,
    options: &Options,
    settings: &Settings,
    report: &mut Report,
) -> Option<Link> {
    let tried = tried(&candidates(pair, options), signals, settings);
    let best = tried.first();
    let overlap_s = best.map_or(0.0, |best| best.fit.nodes.len() as f64 * coarse::BIN_S);
    report.judge(Gate::overlap(overlap_s, options.min_overlap_s))?;
    let best = best?;
    report.judge(Gate::explained(best.unexplained.sqrt()))?;
    // How much worse the best rival explains the motion. Rivals whose evidence
    // is far weaker (short overlaps, where anything fits) do not count.
    let rival = tried[1..]
        .iter()
        .filter(|other| other.evidence < 0.5 * best.evidence)
        .map(|other| other.unexplained / best.unexplained)
        .fold(f64::INFINITY, f64::min);
    report.judge(Gate::unique_peak(rival))?;
    Some(best.fit.link)
}

/// Lags in seconds, the data's time minus the model's.
fn candidates(pair: &Pair, options: &Options) -> Vec<f64> {
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

/// A quick fit at each candidate, the strongest first.
fn tried(candidates: &[f64], signals: &Signals, settings: &Settings) -> Vec<Tried> {
    let data = signals.data.sampled(coarse::BIN_S);
    let quick = FitOptions {
        iterations: 8,
        oversampling: 1.0,
        ..settings.fit
    };
    let even = Some(Matrix3::identity());
    let mut tried: Vec<Tried> = Vec::new();
    for &lag_s in candidates {
        let start = Link {
            at_model: 0.0,
            at_data: lag_s,
            rate: 1.0,
        };
        let Some(fit) = fit::fit(&signals.model, &data, start, even, &quick) else {
            continue;
        };
        let motion = fit.motion_variance();
        if motion.is_nan() || motion <= 0.0 {
            continue;
        }
        let unexplained = (fit.residual_variance() / motion).max(1e-14);
        let now = Tried {
            evidence: fit.nodes.len() as f64 * unexplained.ln(),
            unexplained,
            fit,
        };
        if tried
            .iter()
            .all(|other| (other.lag_s() - now.lag_s()).abs() >= SAME_LAG_S)
        {
            tried.push(now);
        }
    }
    tried.sort_by(|x, y| x.evidence.total_cmp(&y.evidence));
    tried
}
