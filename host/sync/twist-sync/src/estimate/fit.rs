//! The continuous-time fit of one gyroscope to the other.
//!
//! One stream is the model, the other the data: `y(t) = C·x(τ(t)) + b + noise`,
//! where `x` is the smooth rate of the model, `y` that of the data, `C` a free 3×3
//! matrix (rotation, scale and cross-axis errors of both sensors), `b` the
//! difference of their biases and `τ(t)` the data's time carried to the model's
//! clock ([`Link`]).
//! Gauss–Newton over 14 parameters: shift `η`, rate `ρ`, `C`, `b`. With
//! `s = C·x′(τ)` and `u = t − t₀` the derivatives of the prediction are
//! `s` (η), `u·s` (ρ), `xₚ` (Cᵢₚ) and 1 (bᵢ).
//!
//! The residual's 3×3 covariance weights the axes. Two weak priors keep the
//! problem solvable where the motion does not: of the rate (crystals: 300 ppm) and of
//! `C` (near the best rotation, so that axes without motion are not fitted to
//! noise). Neither has an effect where there is motion.
//!
//! The shift's sigma comes from the residual itself: it is the long-run covariance
//! (Newey–West with a Parzen kernel) of the nodes' influences on (η, ρ), so that coloured
//! noise and unmodelled parts count as they appear in the data. The evaluation of strobes
//! has an estimator of this family for one variable with Bartlett weights; the Parzen
//! kernel, which is smooth at its end, suits the correlation of a low-passed signal, and
//! published results are by it.

use nalgebra::{Matrix2, Matrix3, Matrix4, SMatrix, SVector, Vector2, Vector3, Vector4};

use super::calibration::{Calibration, Rates, prior_strength, regress_about, rotation};
use crate::robust::median;
use crate::signal::Signal;
use crate::signal::interpolant::Vec3;

/// Longest time, in seconds, over which the model is extrapolated by its slope: the error
/// `½·x″·t²` is below 10⁻⁶ rad/s at 4 rad/s and 10 Hz, and mean-free in the shift's score.
const CARRIES_S: f64 = 10e-6;

/// 1-sigma of the prior of the rate: two crystals.
pub(crate) const RATE_SIGMA: f64 = 300e-6;

const PARAMETERS: usize = 14;
const SHIFT: usize = 12;
const RATE: usize = 13;

/// Time of the data's clock carried to the model's: `at_model + (t − at_data)·rate`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Link {
    /// Time of the model's clock that belongs to `at_data`.
    pub(crate) at_model: f64,
    /// The reference, in the data's time.
    pub(crate) at_data: f64,
    /// Seconds of the model's clock in one of the data's.
    pub(crate) rate: f64,
}

impl Link {
    /// Converts a time of the data to the model's.
    pub(crate) fn model_time(&self, t: f64) -> f64 {
        self.at_model + (t - self.at_data) * self.rate
    }

    /// Converts a time of the model to the data's.
    pub(crate) fn data_time(&self, t: f64) -> f64 {
        self.at_data + (t - self.at_model) / self.rate
    }

    /// Returns the data's time minus the model's, at the reference.
    pub(crate) fn lag_s(&self) -> f64 {
        self.at_data - self.at_model
    }

    /// Returns the same relation with another reference.
    pub(crate) fn moved_to(&self, at_data: f64) -> Self {
        Self {
            at_model: self.model_time(at_data),
            at_data,
            rate: self.rate,
        }
    }
}

/// Settings of a fit.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FitOptions {
    /// Largest number of iterations.
    pub(crate) iterations: usize,
    /// Steps of the shift below which the iteration has settled, seconds; of the rate
    /// likewise.
    pub(crate) settled_s: f64,
    /// Nodes that one independent noise value spans.
    pub(crate) oversampling: f64,
    /// In-band noise variance of one axis, (rad/s)²: strength of the prior of `C`.
    pub(crate) noise_variance: f64,
    /// Bandwidth of the long-run covariance, seconds; 0 for a trial whose sigma is not used.
    pub(crate) memory_s: f64,
}

/// One node of the data after the fit.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Node {
    /// The data's time.
    pub(crate) t: f64,
    /// The data's rate.
    pub(crate) y: Vector3<f64>,
    /// The model's smooth rate at that time.
    pub(crate) x: Vector3<f64>,
    /// Residual `y − C·x − b`.
    pub(crate) residual: Vector3<f64>,
    /// Derivative of the prediction with respect to the shift, rad/s².
    pub(crate) slope: Vector3<f64>,
    /// Weight of the node: 1, or less where the residual is large because the rig is knocked
    /// or vibrates.
    pub(crate) weight: f64,
}

impl Node {
    pub(crate) const fn rates(&self) -> Rates {
        (self.x, self.y)
    }

    /// Returns score and information about the shift.
    pub(crate) fn evidence(&self, weights: &Matrix3<f64>) -> (f64, f64) {
        let weighed = weights * self.slope * self.weight;
        (weighed.dot(&self.residual), weighed.dot(&self.slope))
    }
}

/// The result of a fit.
#[derive(Debug, Clone)]
pub(crate) struct Fit {
    /// The relation of the clocks.
    pub(crate) link: Link,
    /// The relation of the sensors.
    pub(crate) calibration: Calibration,
    /// All nodes on which both signals exist.
    pub(crate) nodes: Vec<Node>,
    /// Weights: inverse covariance of the residual.
    pub(crate) weights: Matrix3<f64>,
    /// Covariance of (η, ρ) from the residual's long-run covariance.
    pub(crate) covariance: Matrix2<f64>,
    /// Covariance of (η, ρ) if the noise were as the fit assumes it.
    pub(crate) ideal_covariance: Matrix2<f64>,
    /// True if the iteration settled.
    pub(crate) settled: bool,
}

impl Fit {
    /// Returns the mean square of the residual over nodes and axes, (rad/s)².
    pub(crate) fn residual_variance(&self) -> f64 {
        mean_square(self.nodes.iter().map(|n| n.residual))
    }

    /// Returns the mean square of the data about their mean, (rad/s)².
    pub(crate) fn motion_variance(&self) -> f64 {
        variance(self.nodes.iter().map(|n| n.y))
    }

    /// Divides the overlap into `count` parts of equal information, and a remainder at its end.
    pub(crate) fn parts(&self, count: f64) -> Vec<Part> {
        let evidence = |n: &Node| n.evidence(&self.weights);
        let share = self.nodes.iter().map(|n| evidence(n).1).sum::<f64>() / count;
        let mut parts = Vec::new();
        let mut part = Part::default();
        for node in &self.nodes {
            let (score, information) = evidence(node);
            part.score += score;
            part.information += information;
            part.moment += information * (node.t - self.link.at_data);
            part.is_whole = part.information >= share;
            if part.is_whole {
                parts.push(std::mem::take(&mut part));
            }
        }
        parts.push(part);
        parts.retain(|part| part.information > 0.0);
        parts
    }
}

/// Evidence of some nodes about the shift.
#[derive(Default)]
pub(crate) struct Part {
    pub(crate) score: f64,
    pub(crate) information: f64,
    /// Information times the time from the reference.
    pub(crate) moment: f64,
    /// False for the remainder at the end.
    pub(crate) is_whole: bool,
}

/// Mean square about the mean, over values and axes.
pub(crate) fn variance(values: impl Iterator<Item = Vector3<f64>> + Clone) -> f64 {
    let mean = mean(values.clone());
    mean_square(values.map(|v| v - mean))
}

/// Mean of the vectors; zero without any.
pub(crate) fn mean(values: impl Iterator<Item = Vector3<f64>> + Clone) -> Vector3<f64> {
    let n = values.clone().count().max(1) as f64;
    values.sum::<Vector3<f64>>() / n
}

fn mean_square(values: impl Iterator<Item = Vector3<f64>>) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for v in values {
        sum += v.norm_squared();
        count += 3;
    }
    sum / f64::from(count.max(1))
}

/// A node of the data on which the model exists.
#[derive(Debug, Clone, Copy)]
struct Seen {
    t: f64,
    y: Vector3<f64>,
    /// The model's rate and its derivative.
    x: Vector3<f64>,
    dx: Vector3<f64>,
}

impl Seen {
    /// Returns the node with the model's time later by `by_s`, which must be short.
    fn node(&self, by_s: f64, calibration: &Calibration) -> Node {
        let x = self.x + self.dx * by_s;
        Node {
            t: self.t,
            y: self.y,
            x,
            residual: calibration.residual(&x, &self.y),
            slope: calibration.matrix * self.dx,
            weight: 1.0,
        }
    }
}

/// Nodes of the data on which the model exists; `None` if they are too few for a fit.
fn seen(model: &Signal, data: &[(f64, Vec3)], link: &Link) -> Option<Vec<Seen>> {
    let mut seen = Vec::with_capacity(data.len());
    seen.extend(data.iter().filter_map(|&(t, y)| {
        let (x, dx) = model.at(link.model_time(t))?;
        let (y, x, dx) = (y.into(), x.into(), dx.into());
        Some(Seen { t, y, x, dx })
    }));
    (seen.len() >= 4 * PARAMETERS).then_some(seen)
}

/// The model from the data's side, at a relation of the clocks.
struct View<'a> {
    model: &'a Signal,
    data: &'a [(f64, Vec3)],
    link: Link,
    seen: Vec<Seen>,
}

impl View<'_> {
    /// Writes the nodes at another relation with the same reference. The model is evaluated
    /// again only if it is too far for an extrapolation by its slope.
    fn update_nodes(
        &mut self,
        link: &Link,
        calibration: &Calibration,
        nodes: &mut Vec<Node>,
    ) -> Option<()> {
        let first = self.seen.first()?.t - link.at_data;
        let last = self.seen.last()?.t - link.at_data;
        let by_s = |link: &Link, u: f64, from: &Link| {
            link.at_model - from.at_model + u * (link.rate - from.rate)
        };
        let farthest = [first, last].map(|u| by_s(link, u, &self.link).abs());
        if farthest[0].max(farthest[1]) > CARRIES_S {
            self.seen = seen(self.model, self.data, link)?;
            self.link = *link;
        }
        nodes.clear();
        let node = |s: &Seen| s.node(by_s(link, s.t - link.at_data, &self.link), calibration);
        nodes.extend(self.seen.iter().map(node));
        Some(())
    }
}

/// Nodes of the data on which the model exists; `None` if they are too few for a fit.
pub(crate) fn nodes(
    model: &Signal,
    data: &[(f64, Vec3)],
    link: &Link,
    calibration: &Calibration,
) -> Option<Vec<Node>> {
    let seen = seen(model, data, link)?;
    Some(seen.iter().map(|s| s.node(0.0, calibration)).collect())
}

/// Fits the relation. `None` if the two signals share too little time, or the
/// equations cannot be solved.
pub(crate) fn fit(
    model: &Signal,
    data: &[(f64, Vec3)],
    start: Link,
    weights: Option<Matrix3<f64>>,
    options: &FitOptions,
) -> Option<Fit> {
    let seen = seen(model, data, &start)?;
    // The reference is in the middle of the data, or rate and shift would be correlated.
    let middle = seen.iter().map(|s| s.t).sum::<f64>() / seen.len() as f64;
    let start = start.moved_to(middle);
    let mut link = start;
    let rates = seen.iter().map(|s| (s.x, s.y));
    let prior = rotation(rates.clone());
    let mut calibration = regress_about(prior, rates, options.noise_variance);
    let mut view = View {
        model,
        data,
        link,
        seen,
    };
    let mut nodes = Vec::with_capacity(view.seen.len());
    let mut weights_now = weights.unwrap_or_else(Matrix3::identity);
    let mut quiet = LocalWeights::default();
    let mut settled = false;
    let mut solved = None;
    let mut last_s = f64::INFINITY;
    for iteration in 0..options.iterations {
        view.update_nodes(&link, &calibration, &mut nodes)?;
        if weights.is_none() && (1..WEIGHTS_FROZEN).contains(&iteration) {
            (weights_now, quiet) = residual_weights(&mut nodes, options.oversampling);
        } else {
            quiet.apply(&mut nodes);
        }
        let (normal, right) = equations(&nodes, &link, &calibration, &prior, &weights_now, options);
        let step = solved.insert(normal.cholesky()?).solve(&right);
        link.at_model += step[SHIFT].clamp(-0.05, 0.05);
        link.rate += step[RATE].clamp(-2e-3, 2e-3);
        if (link.at_model - start.at_model).abs() > 0.5 || (link.rate - 1.0).abs() > 0.01 {
            return None;
        }
        calibration.step(&step.as_slice()[..SHIFT]);
        let frozen = weights.is_some() || iteration >= WEIGHTS_FROZEN;
        last_s = step[SHIFT].abs();
        if frozen && step[SHIFT].abs().max(step[RATE].abs()) < options.settled_s {
            settled = true;
            break;
        }
    }
    view.update_nodes(&link, &calibration, &mut nodes)?;
    quiet.apply(&mut nodes);
    // Of the equations before the last step, which was tiny if the fit has settled.
    let inverse = solved?.inverse();
    let ideal_covariance =
        inverse.fixed_view::<2, 2>(SHIFT, SHIFT).into_owned() * options.oversampling;
    // Streams with large errors of their stamps settle slowly.
    settled |= last_s < SETTLED_SIGMAS * ideal_covariance[(0, 0)].sqrt();
    let covariance = if options.memory_s > 0.0 {
        let of_node = |n: &Node| (n.t, influence(n, &link, &inverse, &weights_now));
        let influences: Vec<(f64, Vector2<f64>)> = nodes.iter().map(of_node).collect();
        let long_run = long_run_covariance(&influences, options.memory_s);
        at_least(long_run, &ideal_covariance)
    } else {
        ideal_covariance
    };
    Some(Fit {
        link,
        calibration,
        nodes,
        weights: weights_now,
        covariance,
        ideal_covariance,
        settled,
    })
}

/// Returns the covariance, but no less than that of white noise: the long-run covariance
/// scatters when little time is in common.
pub(crate) fn at_least(covariance: Matrix2<f64>, ideal: &Matrix2<f64>) -> Matrix2<f64> {
    let size = |k: usize| covariance[(k, k)].max(ideal[(k, k)]);
    let correlation = covariance[(0, 1)] / (covariance[(0, 0)] * covariance[(1, 1)]).sqrt();
    let correlation = if correlation.is_finite() {
        correlation.clamp(-1.0, 1.0)
    } else {
        ideal[(0, 1)] / (ideal[(0, 0)] * ideal[(1, 1)]).sqrt()
    };
    let mixed = correlation * (size(0) * size(1)).sqrt();
    Matrix2::new(size(0), mixed, mixed, size(1))
}

/// Largest last step of a fit that counts as settled, in sigmas.
const SETTLED_SIGMAS: f64 = 0.02;

/// Iteration from which the weights stay, so that the fit settles.
const WEIGHTS_FROZEN: usize = 4;

/// Weights over time: below 1 in stretches whose residual is well above the usual.
#[derive(Debug, Clone, Default)]
pub(crate) struct LocalWeights {
    /// (end of the stretch, weight), in time order.
    stretches: Vec<(f64, f64)>,
}

impl LocalWeights {
    fn apply(&self, nodes: &mut [Node]) {
        let last = self.stretches.last().map_or(1.0, |s| s.1);
        let mut stretches = self.stretches.iter().peekable();
        for node in nodes {
            while stretches.next_if(|s| s.0 < node.t).is_some() {}
            node.weight = stretches.peek().map_or(last, |s| s.1);
        }
    }
}

/// Length of the stretches over which the residual's power is judged, seconds.
const STRETCH_S: f64 = 0.25;
/// Power of the residual, in multiples of the median, above which a stretch
/// counts less.
const LOUD: f64 = 3.0;

/// Returns the inverse covariance of the usual residual, and the weights of the stretches,
/// which are applied to the nodes.
///
/// A knock or a vibration causes residuals that are no noise (filters that differ,
/// flexing); with equal weights a quarter of a second of it can outweigh the rest.
pub(crate) fn residual_weights(
    nodes: &mut [Node],
    oversampling: f64,
) -> (Matrix3<f64>, LocalWeights) {
    let mut power: Vec<(f64, f64, usize)> = Vec::new(); // end, Σ r², nodes
    let mut from = f64::NEG_INFINITY;
    for node in &*nodes {
        let square = node.residual.norm_squared();
        match power.last_mut() {
            Some(last) if node.t < from + STRETCH_S => {
                last.0 = node.t;
                last.1 += square;
                last.2 += 1;
            }
            _ => {
                from = node.t;
                power.push((node.t, square, 1));
            }
        }
    }
    let means: Vec<f64> = power.iter().map(|p| p.1 / p.2 as f64).collect();
    let usual = median(&means).unwrap_or(0.0);
    let stretches: Vec<(f64, f64)> = power
        .iter()
        .zip(&means)
        .map(|(p, &mean)| {
            // A short stretch scatters more by itself.
            let independent = (3.0 * p.2 as f64 / oversampling).max(1.0);
            let limit = LOUD * (1.0 + 3.0 * (2.0 / independent).sqrt()) / 2.0;
            let loud = mean > limit * usual && usual > 0.0;
            (p.0, if loud { usual / mean } else { 1.0 })
        })
        .collect();
    let weights = LocalWeights { stretches };
    weights.apply(nodes);
    (inverse_covariance(nodes), weights)
}

/// Inverse of the residual's covariance, bounded so that no axis dominates.
fn inverse_covariance(nodes: &[Node]) -> Matrix3<f64> {
    let mut s = Matrix3::zeros();
    let mut sum = 0.0;
    for node in nodes {
        s += node.residual * node.residual.transpose() * node.weight;
        sum += node.weight;
    }
    s /= f64::max(sum, 1e-9);
    let floor = 0.01 * s.trace() / 3.0 + 1e-20;
    (s + Matrix3::identity() * floor)
        .try_inverse()
        .unwrap_or_else(Matrix3::identity)
}

type Normal = SMatrix<f64, PARAMETERS, PARAMETERS>;
type Parameters = SVector<f64, PARAMETERS>;

fn add(sum: &mut [f64; 4], z: &[f64; 4], factor: f64) {
    for p in 0..4 {
        sum[p] += z[p] * factor;
    }
}

fn equations(
    nodes: &[Node],
    link: &Link,
    calibration: &Calibration,
    prior: &Calibration,
    weights: &Matrix3<f64>,
    options: &FitOptions,
) -> (Normal, Parameters) {
    let mut sums = [[0.0; 4]; 13]; // Σ z (z, Ws, u·Ws, Wr)ᵀ
    let mut ss = [0.0; 3]; // Σ sᵀWs · (1, u, u²)
    let mut sr = [0.0; 2]; // Σ sᵀWr · (1, u)
    for node in nodes {
        let z = [node.x.x, node.x.y, node.x.z, 1.0];
        let u = node.t - link.at_data;
        let ws = weights * node.slope * node.weight;
        let wr = weights * node.residual * node.weight;
        let wz = z.map(|z| z * node.weight);
        for (sum, factor) in sums.iter_mut().zip(wz) {
            add(sum, &z, factor);
        }
        for i in 0..3 {
            add(&mut sums[4 + i], &z, ws[i]);
            add(&mut sums[7 + i], &z, ws[i] * u);
            add(&mut sums[10 + i], &z, wr[i]);
        }
        let information = node.slope.dot(&ws);
        ss[0] += information;
        ss[1] += information * u;
        ss[2] += information * u * u;
        let score = node.slope.dot(&wr);
        sr[0] += score;
        sr[1] += score * u;
    }
    let sums = SMatrix::<f64, 4, 13>::from(sums);
    let zz: Matrix4<f64> = sums.fixed_columns::<4>(0).into_owned();
    let mut normal = Normal::zeros();
    let mut right = Parameters::zeros();
    for i in 0..3 {
        for p in 0..4 {
            let at = i * 4 + p;
            right[at] = sums[(p, 10 + i)];
            for (k, first) in [(SHIFT, 4), (RATE, 7)] {
                normal[(at, k)] = sums[(p, first + i)];
                normal[(k, at)] = sums[(p, first + i)];
            }
        }
        for j in 0..3 {
            let block = zz * weights[(i, j)];
            normal
                .fixed_view_mut::<4, 4>(i * 4, j * 4)
                .copy_from(&block);
        }
    }
    normal
        .fixed_view_mut::<2, 2>(SHIFT, SHIFT)
        .copy_from(&Matrix2::new(ss[0], ss[1], ss[1], ss[2]));
    right[SHIFT] = sr[0];
    right[RATE] = sr[1];

    let motion = zz.fixed_view::<3, 3>(0, 0).trace();
    let ridge = prior_strength(nodes.len(), options.noise_variance, motion) * weights.trace() / 3.0;
    for row in 0..3 {
        for column in 0..3 {
            let at = row * 4 + column;
            normal[(at, at)] += ridge;
            right[at] += ridge * (prior.matrix[(row, column)] - calibration.matrix[(row, column)]);
        }
    }
    let rate_prior = options.oversampling / (RATE_SIGMA * RATE_SIGMA);
    normal[(RATE, RATE)] += rate_prior;
    right[RATE] += rate_prior * (1.0 - link.rate);
    (normal, right)
}

/// Influence of a node on (η, ρ), under the inverse of the equations.
fn influence(node: &Node, link: &Link, inverse: &Normal, weights: &Matrix3<f64>) -> Vector2<f64> {
    let wr = weights * node.residual * node.weight;
    let z = Vector4::new(node.x.x, node.x.y, node.x.z, 1.0);
    let score = node.slope.dot(&wr);
    let mut derivative = Parameters::zeros();
    for i in 0..3 {
        derivative
            .fixed_rows_mut::<4>(i * 4)
            .copy_from(&(z * wr[i]));
    }
    derivative[SHIFT] = score;
    derivative[RATE] = score * (node.t - link.at_data);
    inverse.fixed_rows::<2>(SHIFT) * derivative
}

/// Covariance of (η, ρ) from the influences of the nodes (time, influence), which are
/// correlated over `memory_s`.
pub(crate) fn long_run_covariance(
    influences: &[(f64, Vector2<f64>)],
    memory_s: f64,
) -> Matrix2<f64> {
    let Some((first, last)) = influences.first().zip(influences.last()) else {
        return Matrix2::from_diagonal_element(f64::INFINITY);
    };
    let step = influences
        .windows(2)
        .map(|p| p[1].0 - p[0].0)
        .fold(f64::INFINITY, f64::min);
    let slot = |t: f64| ((t - first.0) / step).round() as usize;
    let slots = slot(last.0) + 1;
    let mut even = vec![Vector2::<f64>::zeros(); slots];
    for (t, influence) in influences {
        even[slot(*t).min(slots - 1)] += influence;
    }
    let memory = ((memory_s / step).ceil() as usize).clamp(1, slots);
    let weight = |lag: usize| parzen(lag as f64 / memory as f64) * if lag == 0 { 0.5 } else { 1.0 };
    let weights: Vec<f64> = (0..memory).map(weight).collect();
    let mut out = Matrix2::zeros();
    for (k, now) in even.iter().enumerate() {
        let later = even[k..].iter().zip(&weights);
        let later: Vector2<f64> = later.map(|(later, weight)| later * *weight).sum();
        out += now * later.transpose();
    }
    out + out.transpose()
}

fn parzen(x: f64) -> f64 {
    if x < 0.5 {
        1.0 - 6.0 * x * x * (1.0 - x)
    } else {
        2.0 * (1.0 - x).powi(3)
    }
}
