//! Agreement of a low band with the full one.
//!
//! Bodies bend, mounts give way and vibration above half the sampling rate is aliased: its phase
//! runs backwards, and both streams show it. All of that is fast, and a rigid motion shows the
//! same offset in every band. So the slopes and residuals of the fit are low-passed once more,
//! and the shift that the low band wants against the full one is solved with a sigma from its
//! own residual.
//!
//! Limits: vibration that is aliased into the low band, and what is wrong in all bands alike.

use super::axes::{self, Row};
use super::fit::{Fit, Node};
use super::pair::Settings;
use crate::clock::WithSigma;
use crate::signal::{kernel_length_s, kernel_sigma_s};

/// Low band of a wider one, Hz: hand motion and driving are slower, propellers and engines faster.
pub(crate) const LOW_HZ: f64 = 8.0;
/// Difference of the two bands beyond which they disagree, in sigmas.
const APART: f64 = 4.0;
/// 1-sigma of the bands' difference that filters of phones and boards cause, seconds.
const FILTERS_S: f64 = 10e-6;

/// Returns the band that is compared with that of `low_pass_hz`.
pub(crate) fn below(low_pass_hz: f64) -> f64 {
    LOW_HZ.min(0.5 * low_pass_hz)
}

/// Returns the shift of the low band against the fit in seconds if the two disagree.
pub(crate) fn apart(fit: &Fit, settings: &Settings) -> Option<WithSigma> {
    let low_hz = below(settings.low_pass_hz);
    let low = Fit {
        nodes: low_passed(&fit.nodes, settings, low_hz),
        ..fit.clone()
    };
    let options = super::fit::FitOptions {
        oversampling: (kernel_length_s(low_hz) / settings.step_s).max(1.0),
        ..settings.fit
    };
    let row = |node: &Node| {
        let turned = node.slope * (node.t - fit.link.at_data);
        Row::<2>::from_columns(&[node.slope, turned])
    };
    let rows: Vec<Row<2>> = low.nodes.iter().map(row).collect();
    let nothing = Default::default();
    let (found, covariance) = axes::regressed(&low, rows, &options, (nothing, nothing))?;
    let sigma = covariance[(0, 0)].sqrt();
    let disagree = found[0].abs() > APART * sigma.hypot(FILTERS_S);
    disagree.then_some(WithSigma {
        value: found[0],
        sigma,
    })
}

/// The nodes with rates, slopes and residuals low-passed to `low_hz`, within stretches without a
/// gap.
fn low_passed(nodes: &[Node], settings: &Settings, low_hz: f64) -> Vec<Node> {
    let own_s = kernel_sigma_s(settings.low_pass_hz);
    let sigma = (kernel_sigma_s(low_hz).powi(2) - own_s * own_s)
        .max(0.0)
        .sqrt()
        / settings.step_s;
    let reach = (3.0 * sigma).ceil() as usize;
    let kernel: Vec<f64> = (0..=reach)
        .map(|lag| (-0.5 * (lag as f64 / sigma).powi(2)).exp())
        .collect();
    let follows = |node: &Node, next: &Node| next.t - node.t < 1.5 * settings.step_s;
    let mut out = Vec::with_capacity(nodes.len());
    for part in nodes.chunk_by(follows) {
        for (k, node) in part.iter().enumerate() {
            // Only where the kernel is whole: a part of it would shift the time.
            if k < reach || k + reach >= part.len() {
                continue;
            }
            let mut sum = (node.x * 0.0, node.slope * 0.0, node.residual * 0.0, 0.0);
            for near in k - reach..=k + reach {
                let weight = kernel[near.abs_diff(k)];
                let near = &part[near];
                sum.0 += near.x * weight;
                sum.1 += near.slope * weight;
                sum.2 += near.residual * weight;
                sum.3 += weight;
            }
            out.push(Node {
                x: sum.0 / sum.3,
                slope: sum.1 / sum.3,
                residual: sum.2 / sum.3,
                ..*node
            });
        }
    }
    out
}
