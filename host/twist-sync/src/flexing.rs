//! A mount that gives way like a spring, taken into the fit.
//!
//! If body b is carried by body a through a spring with a resonance at `ω₀` and a damping
//! ratio `ζ`, its rate `y` obeys `y″ + 2ζω₀·y′ + ω₀²·y = 2ζω₀·x′ + ω₀²·x`, with `x` the rate
//! of a. So, with `κ = 1/ω₀²` and as long as motion is slower than the resonance,
//! `y = x − κ·y″ + 2ζκ^(3/2)·y‴`: fast motion is larger, which shows, and late by
//! `2ζκ^(3/2)·ω²`, which is an error of the offset. Where a is carried by b, `x` and `y`
//! change roles. Without these terms the former is a residual that is correlated in time:
//! the long-run covariance, which sees 0.3 s of it, states too much for the shift (over a
//! twist `x′·x″` cancels) and too little for the rate.
//!
//! A mount is as stiff as it is about each of its axes, so `κ` is a symmetric matrix, here
//! `−K`, and its power 3/2 that of its eigenvalues; each of its three modes has a `ζ` with
//! a prior. All are fitted together with the parameters of [`crate::fit`], in linear steps
//! from its result.
//!
//! A mount that does not show is not fitted: with the information of the base scenario
//! it is stiffer than 90 Hz or so, and delays a twist by less than half a µs.

use nalgebra::{Matrix3, SMatrix, SVector, SymmetricEigen, Vector2, Vector3};

use crate::calibration;
use crate::fit::{self, Fit, Node};
use crate::pair::Settings;

/// `C` and bias by rows, as in [`crate::fit`]; shift; rate; `K`; `ζ` of its modes.
const PARAMETERS: usize = 23;
const SHIFT: usize = 12;
const RATE: usize = 13;
const MOUNT: usize = 14;
const DAMPING: usize = 20;
/// The elements of `K` in their order.
const ELEMENTS: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];

/// The second derivative is the difference over so many seconds on either side, the third
/// that of the second.
const SECOND_S: f64 = 0.012;
const THIRD_S: f64 = 0.02;
/// Significance, as a chi-square of six degrees of freedom, from which a mount is taken
/// for flexing: by chance one twist in two million.
const SHOWS: f64 = 40.0;
/// Part of the residual's power at most that a mount leaves: in real streams the second
/// derivative also explains a little of what has other causes.
const EARNS: f64 = 0.7;
/// Prior of `ζ`, mean and 1-sigma: joints of metal 0.03 to 0.07, rubber 0.05, dampers 0.3
/// (Adams and Askenazi, *Building Better Products with Finite Element Analysis*).
const ZETA: (f64, f64) = (0.1, 0.1);
/// 1-sigma of the prior of the elements of `K`, s²: a resonance at 8 Hz.
const SOFTEST: f64 = 4e-4;
/// Weights and the power of `K` are taken from the round before.
const ROUNDS: usize = 3;

/// A node with the second and third derivative of the body that is carried.
struct Bent {
    node: Node,
    second: Vector3<f64>,
    third: Vector3<f64>,
}

/// Axes of a mount's modes and what the third derivative along each is multiplied by for
/// each unit of its `ζ`.
type Modes = [(Vector3<f64>, f64); 3];

type Parameters = SVector<f64, PARAMETERS>;
type Row = SMatrix<f64, 3, PARAMETERS>;
type Normal = SMatrix<f64, PARAMETERS, PARAMETERS>;

/// Fits the mount too, where it shows: relation, residuals and covariance of the fit.
pub(crate) fn include_mount(fit: &mut Fit, settings: &Settings) {
    if !shows(fit, settings) {
        return;
    }
    let matrix = fit.calibration.matrix;
    let mut bent = bent(&fit.nodes, settings.step_s, |node| matrix * node.x);
    let mut nodes: Vec<Node> = bent.iter().map(|b| b.node).collect();
    let mut weights = fit.weights;
    let mut modes = [(Vector3::zeros(), 0.0); 3];
    for round in 0.. {
        let rows: Vec<Row> = bent.iter().map(|b| row(b, fit, &modes)).collect();
        let Some((solution, inverse)) = solved(&bent, &rows, &nodes, &weights, fit, settings)
        else {
            return;
        };
        for ((node, b), row) in nodes.iter_mut().zip(&bent).zip(&rows) {
            node.residual = b.node.residual - row * solution;
        }
        let power = |node: &Node| node.residual.dot(&(fit.weights * node.residual)) * node.weight;
        let before: f64 = bent.iter().map(|b| power(&b.node)).sum();
        if nodes.iter().map(power).sum::<f64>() > EARNS * before {
            return;
        }
        if round + 1 == ROUNDS {
            finish(fit, settings, (nodes, rows, weights), &solution, &inverse);
            return;
        }
        let stiffness = stiffness(&solution);
        modes = modes_of(stiffness);
        if round == 0 && stiffness.trace() < 0.0 {
            bent = self::bent(&fit.nodes, settings.step_s, |node| node.y);
        }
        (weights, _) = fit::residual_weights(&mut nodes, settings.fit.oversampling);
    }
}

/// Puts a solution into the fit.
fn finish(
    fit: &mut Fit,
    settings: &Settings,
    (nodes, rows, weights): (Vec<Node>, Vec<Row>, Matrix3<f64>),
    solution: &Parameters,
    inverse: &Normal,
) {
    let both = inverse.fixed_rows::<2>(SHIFT);
    let influence = |(node, row): (&Node, &Row)| {
        let score = row.tr_mul(&(weights * node.residual * node.weight));
        (node.t, both * score)
    };
    let influences: Vec<(f64, Vector2<f64>)> = nodes.iter().zip(&rows).map(influence).collect();
    let mut covariance = fit::long_run_covariance(&influences, settings.fit.memory_s);
    let oversampling = settings.fit.oversampling;
    // The prior's uncertainty is in no residual.
    for k in DAMPING..PARAMETERS {
        let open = both.column(k) * (oversampling / ZETA.1);
        covariance += open * open.transpose();
    }
    fit.ideal_covariance = inverse.fixed_view::<2, 2>(SHIFT, SHIFT) * oversampling;
    fit.covariance = fit::at_least(covariance, &fit.ideal_covariance);
    fit.link.at_model += solution[SHIFT];
    fit.link.rate += solution[RATE];
    fit.calibration.step(&solution.as_slice()[..SHIFT]);
    fit.weights = weights;
    fit.nodes = nodes;
}

/// So many seconds in nodes.
fn steps(seconds: f64, step_s: f64) -> usize {
    (seconds / step_s).round().max(1.0) as usize
}

/// Each node that has so many neighbours on either side, with them.
fn surrounded(nodes: &[Node], reach: usize, step_s: f64) -> impl Iterator<Item = &[Node]> {
    let longest = (2.0 * reach as f64 + 0.5) * step_s;
    let whole = move |around: &&[Node]| around[2 * reach].t - around[0].t < longest;
    nodes.windows(2 * reach + 1).filter(whole)
}

/// The nodes whose neighbours are there, with the derivatives of a rate.
fn bent(nodes: &[Node], step_s: f64, rate: impl Fn(&Node) -> Vector3<f64>) -> Vec<Bent> {
    let (near, far) = (steps(SECOND_S, step_s), steps(THIRD_S, step_s));
    let reach = near + far;
    let second = |around: &[Node], at: usize| {
        let [before, now, after] = [at - near, at, at + near].map(|k| rate(&around[k]));
        (before - now * 2.0 + after) / (near as f64 * step_s).powi(2)
    };
    let bent = |around: &[Node]| Bent {
        node: around[reach],
        second: second(around, reach),
        third: (second(around, reach + far) - second(around, reach - far))
            / (2.0 * far as f64 * step_s),
    };
    surrounded(nodes, reach, step_s).map(bent).collect()
}

/// Tests whether the residual goes with the second derivative: the score test of `K`, with the
/// information that there would be if nothing else were fitted, which is more.
///
/// Here the derivative is that of the slope, so far away that it shares no noise with the
/// residual.
fn shows(fit: &Fit, settings: &Settings) -> bool {
    let reach = steps(THIRD_S, settings.step_s);
    let weights = &fit.weights;
    let (mut scores, mut squares) = (Matrix3::zeros(), Matrix3::zeros());
    for around in surrounded(&fit.nodes, reach, settings.step_s) {
        let node = &around[reach];
        let second =
            (around[2 * reach].slope - around[0].slope) / (2.0 * reach as f64 * settings.step_s);
        scores += weights * node.residual * second.transpose() * node.weight;
        squares += second * second.transpose() * node.weight;
    }
    let significance = |&(i, j): &(usize, usize)| {
        let both = scores[(i, j)] + scores[(j, i)];
        let information = weights[(i, i)] * squares[(j, j)]
            + 2.0 * weights[(i, j)] * squares[(i, j)]
            + weights[(j, j)] * squares[(i, i)];
        both * both / information
    };
    ELEMENTS.iter().map(significance).sum::<f64>() > SHOWS * settings.fit.oversampling
}

/// Derivatives of the prediction at a node.
fn row(b: &Bent, fit: &Fit, modes: &Modes) -> Row {
    let mut row = Row::zeros();
    for i in 0..3 {
        for p in 0..3 {
            row[(i, i * 4 + p)] = b.node.x[p];
        }
        row[(i, i * 4 + 3)] = 1.0;
    }
    row.set_column(SHIFT, &b.node.slope);
    row.set_column(RATE, &(b.node.slope * (b.node.t - fit.link.at_data)));
    for (k, &(i, j)) in ELEMENTS.iter().enumerate() {
        row[(i, MOUNT + k)] = b.second[j];
        row[(j, MOUNT + k)] = b.second[i];
    }
    for (k, (axis, late)) in modes.iter().enumerate() {
        row.set_column(DAMPING + k, &(axis * (axis.dot(&b.third) * late)));
    }
    row
}

/// The parameters against the result of the fit, and the inverse of the equations.
fn solved(
    bent: &[Bent],
    rows: &[Row],
    nodes: &[Node],
    weights: &Matrix3<f64>,
    fit: &Fit,
    settings: &Settings,
) -> Option<(Parameters, Normal)> {
    let mut normal = Normal::zeros();
    let mut right = Parameters::zeros();
    let mut motion = 0.0;
    for ((b, row), node) in bent.iter().zip(rows).zip(nodes) {
        let weighed = weights * row * node.weight;
        normal += row.tr_mul(&weighed);
        right += weighed.tr_mul(&b.node.residual);
        motion += b.node.x.norm_squared();
    }
    let options = &settings.fit;
    let ridge = calibration::prior_strength(bent.len(), options.noise_variance, motion);
    let of_c = (0..12)
        .filter(|k| k % 4 < 3)
        .map(|k| (k, 0.0, ridge * weights.trace() / 3.0));
    let known = |sigma: f64| options.oversampling / (sigma * sigma);
    let of_k = (MOUNT..DAMPING).map(|k| (k, 0.0, known(SOFTEST)));
    let of_rate = (RATE, 1.0 - fit.link.rate, known(fit::RATE_SIGMA));
    let of_damping = (DAMPING..PARAMETERS).map(|k| (k, ZETA.0, known(ZETA.1)));
    let priors = of_c.chain(of_k).chain([of_rate]).chain(of_damping);
    for (k, mean, strength) in priors {
        normal[(k, k)] += strength;
        right[k] += strength * mean;
    }
    let cholesky = normal.cholesky()?;
    Some((cholesky.solve(&right), cholesky.inverse()))
}

/// `K`, which is `−κ` where b is carried, and `κ` where a is.
fn stiffness(solution: &Parameters) -> Matrix3<f64> {
    let mut k = Matrix3::zeros();
    for (at, &(i, j)) in ELEMENTS.iter().enumerate() {
        k[(i, j)] = solution[MOUNT + at];
        k[(j, i)] = solution[MOUNT + at];
    }
    k
}

fn modes_of(stiffness: Matrix3<f64>) -> Modes {
    let eigen = SymmetricEigen::new(stiffness);
    std::array::from_fn(|k| {
        let value = eigen.eigenvalues[k];
        let axis = eigen.eigenvectors.column(k).into_owned();
        (axis, -2.0 * value * value.abs().sqrt())
    })
}
