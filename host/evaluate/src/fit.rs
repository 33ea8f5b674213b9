//! The fine fit: the whole train at once, to a small part of a row.
//!
//! A frame's profile is modelled as
//!
//! ```text
//! smooth part  +  T(r) · (c0 + c1 x + c2 x² + c3 T(r))
//! ```
//!
//! where `T` is the light of the train ([`row_light`]) for a train centre, a row
//! time and an exposure, and `x` the row's place in `-1..=1`. The smooth part is
//! the reference frame and polynomials, or polynomials alone. `c1` and `c2` let
//! the light vary over the picture, `c3` takes a camera's tone curve up: it is
//! symmetric about each flash and moves nothing. All these enter linearly and are
//! eliminated (variable projection, with Kaufman's Jacobian); what is left is one
//! train centre per frame, and a row time and an exposure shared by all frames.
//!
//! Uncertainty comes from the residuals themselves, not from an assumed noise:
//! each parameter's error is a known weighted sum of the rows' errors, and the
//! variance of that sum is taken with the correlation of neighbouring rows
//! ([`variance_of_sum`]). Averaging over frames sums the rows' errors *before*
//! squaring, so that what all frames have in common (the texture of the scene, a
//! compressed picture repeated from frame to frame) does not average out.

use rayon::prelude::*;

use super::linear::{Basis, add_scaled, dot, unit_places};
use super::search::RowGrid;
use super::stats::{correlation_inflation, variance_of_sum};
use super::train::{Shape, TrainGeometry, row_light};

/// Correlation length of row errors that is allowed for: one and a half blocks of
/// a video encoder.
const ROW_LAG: usize = 24;
/// Correlation length in the test whether there are flashes at all: pictures of
/// ordinary scenes are smooth over many rows.
const DETECTION_LAG: usize = 64;

/// What is known beforehand of a shared parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prior {
    /// Expected value.
    pub value: f64,
    /// Standard uncertainty of it.
    pub sigma: f64,
}

/// What is known beforehand of the camera.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Priors {
    /// Row time, µs.
    pub row_time_us: Option<Prior>,
    /// Exposure, µs.
    pub exposure_us: Option<Prior>,
}

/// The model of one recording's frames.
#[derive(Debug, Clone)]
pub struct Model {
    /// Where the rows are.
    pub rows: RowGrid,
    /// The train.
    pub train: TrainGeometry,
    /// The part of the brightness that is not flashes.
    pub smooth: Basis,
    places: Vec<f64>,
}

/// How well flashes explain one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameFit {
    /// Centre of the train, µs after the middle row's centre of exposure.
    pub bias_us: f64,
    /// Sum of squares that is left.
    pub rss: f64,
    /// Share of the sum of squares outside the smooth part that the train explains.
    pub share: f64,
    /// The same for differences of rows a flash apart: what is smooth but no
    /// polynomial (ordinary scenes, lamps) is not explained by the sharp edges of
    /// flashes.
    pub edge_share: f64,
    /// Significance of the train, in standard deviations; negative for a dark train.
    pub significance: f64,
    /// Grey levels that a whole flash adds, mean over the light seen.
    pub amplitude: f64,
    /// Coefficients of the train's light: constant, place, place², own light.
    pub coefficients: [f64; 4],
    /// Standard uncertainty of `bias_us` with row time and exposure held, µs.
    pub sigma_us: f64,
    /// By how much correlation between rows raises a variance.
    pub inflation: f64,
    /// Mean of `light`.
    pub mean_light: f64,
    /// The fitted light of the flashes, grey levels a row.
    pub light: Vec<f64>,
    /// What is left, grey levels a row.
    pub residuals: Vec<f64>,
}

/// Several frames fitted together.
#[derive(Debug, Clone, PartialEq)]
pub struct JointFit {
    /// Centre of the train in each frame, µs.
    pub bias_us: Vec<f64>,
    /// Mean of them, µs.
    pub mean_us: f64,
    /// Standard uncertainty of the mean, with those of row time and exposure, µs.
    pub mean_sigma_us: f64,
    /// Row time, µs.
    pub row_time_us: f64,
    /// Its standard uncertainty, µs.
    pub row_time_sigma_us: f64,
    /// Exposure, µs.
    pub exposure_us: f64,
    /// Its standard uncertainty, µs.
    pub exposure_sigma_us: f64,
    /// Sum of squares that is left, over all frames.
    pub rss: f64,
}

/// A frame's model and derivatives about a point.
struct Local {
    residuals: Vec<f64>,
    rss: f64,
    light: Vec<f64>,
    amplitude: f64,
    coefficients: [f64; 4],
    /// Jacobian columns by train centre, row time and exposure.
    by: [Vec<f64>; 3],
    terms: usize,
}

impl Model {
    /// A model; `smooth` must have as many rows as `rows`.
    pub fn new(rows: RowGrid, train: TrainGeometry, smooth: Basis) -> Self {
        Self {
            rows,
            train,
            smooth,
            places: unit_places(rows.len),
        }
    }

    /// A profile without its smooth part.
    pub fn detrend(&self, profile: &[f32]) -> Vec<f64> {
        let mut y: Vec<f64> = profile.iter().map(|&v| f64::from(v)).collect();
        self.smooth.remove_from(&mut y);
        y
    }

    /// Linearises about `shape`; `y` has no smooth part.
    fn local(&self, y: &[f64], shape: &Shape) -> Local {
        let n = self.rows.len;
        let mut value = Vec::with_capacity(n);
        let mut by: [Vec<f64>; 3] = std::array::from_fn(|_| Vec::with_capacity(n));
        for i in 0..n {
            let l = row_light(&self.train, shape, self.rows.position(i));
            value.push(l.value);
            let [b, r, e] = &mut by;
            b.push(l.by_bias);
            r.push(l.by_row_time);
            e.push(l.by_exposure);
        }
        // Terms that are linear in the amplitude coefficients.
        let gained = |f: &dyn Fn(f64, f64) -> f64| -> Vec<f64> {
            value
                .iter()
                .zip(&self.places)
                .map(|(t, x)| f(*t, *x))
                .collect()
        };
        let raw = [
            value.clone(),
            gained(&|t, x| t * x),
            gained(&|t, x| t * x * x),
            gained(&|t, _| t * t),
        ];
        // Gram-Schmidt with its triangle, so that coefficients come back.
        let mut q: Vec<Vec<f64>> = Vec::with_capacity(4);
        let mut triangle: Vec<Vec<f64>> = Vec::with_capacity(4);
        let mut used = Vec::with_capacity(4);
        for (index, raw) in raw.iter().enumerate() {
            let before = dot(raw, raw).sqrt();
            let mut column = raw.clone();
            self.smooth.remove_from(&mut column);
            let mut r: Vec<f64> = vec![0.0; q.len()];
            for _ in 0..2 {
                for (q, r) in q.iter().zip(&mut r) {
                    let c = dot(q, &column);
                    add_scaled(&mut column, -c, q);
                    *r += c;
                }
            }
            let norm = dot(&column, &column).sqrt();
            if norm > 2e-3 * before && norm > 0.0 {
                column.iter_mut().for_each(|v| *v /= norm);
                r.push(norm);
                q.push(column);
                triangle.push(r);
                used.push(index);
            }
        }
        let mut residuals = y.to_vec();
        let mut z: Vec<f64> = Vec::with_capacity(q.len());
        for q in &q {
            let c = dot(q, &residuals);
            add_scaled(&mut residuals, -c, q);
            z.push(c);
        }
        // Back substitution: column j of the triangle holds what raw term j has of
        // each q.
        let mut coefficients = [0.0; 4];
        let mut solved = vec![0.0; q.len()];
        for j in (0..q.len()).rev() {
            let mut rest = z.get(j).copied().unwrap_or(0.0);
            for (k, c) in solved.iter().enumerate().skip(j + 1) {
                let r = triangle.get(k).and_then(|t| t.get(j));
                rest -= r.copied().unwrap_or(0.0) * c;
            }
            let diagonal = triangle.get(j).and_then(|t| t.get(j)).copied();
            let c = rest / diagonal.unwrap_or(1.0);
            if let (Some(s), Some(&index)) = (solved.get_mut(j), used.get(j)) {
                *s = c;
                if let Some(slot) = coefficients.get_mut(index) {
                    *slot = c;
                }
            }
        }
        let [c0, c1, c2, c3] = coefficients;
        let gain = |t: f64, x: f64| c0 + c1 * x + c2 * x * x + c3 * t;
        let light: Vec<f64> = value
            .iter()
            .zip(&self.places)
            .map(|(&t, &x)| t * gain(t, x))
            .collect();
        let seen: f64 = value.iter().sum();
        let amplitude = if seen > 0.0 {
            light.iter().sum::<f64>() / seen
        } else {
            0.0
        };
        for column in &mut by {
            for ((d, &t), &x) in column.iter_mut().zip(&value).zip(&self.places) {
                *d *= gain(t, x) + c3 * t;
            }
            self.smooth.remove_from(column);
            for q in &q {
                let c = dot(q, column);
                add_scaled(column, -c, q);
            }
        }
        Local {
            rss: dot(&residuals, &residuals),
            residuals,
            light,
            amplitude,
            coefficients,
            by,
            terms: q.len(),
        }
    }

    /// Fits the train's centre in one frame, with row time and exposure held.
    pub fn fit_frame(&self, y: &[f64], start: &Shape) -> FrameFit {
        let mut shape = *start;
        let mut local = self.local(y, &shape);
        let limit = 0.25 * (self.train.duration_us + shape.exposure_us).min(500.0);
        for _ in 0..12 {
            let [by_bias, ..] = &local.by;
            let curvature = dot(by_bias, by_bias);
            if curvature <= 0.0 {
                break;
            }
            let mut step = (dot(by_bias, &local.residuals) / curvature).clamp(-limit, limit);
            let mut better = None;
            for _ in 0..4 {
                let tried = Shape {
                    bias_us: shape.bias_us + step,
                    ..shape
                };
                let at = self.local(y, &tried);
                if at.rss < local.rss {
                    better = Some((tried, at));
                    break;
                }
                step *= 0.3;
            }
            let Some((tried, at)) = better else { break };
            shape = tried;
            local = at;
            if step.abs() < 1e-5 {
                break;
            }
        }
        let total = dot(y, y);
        let apart = (self.train.duration_us / (shape.row_time_us * self.rows.step)).round();
        let apart = (apart as usize).clamp(1, (self.rows.len / 8).max(1));
        let edges = edge_energy(y, apart);
        let freedom = self.freedom(local.terms + 1);
        let noise = local.rss / freedom;
        let inflation = correlation_inflation(&local.residuals, DETECTION_LAG);
        let significance =
            (total - local.rss).max(0.0).sqrt() / (noise * inflation).sqrt().max(1e-9);
        let [by_bias, ..] = &local.by;
        let curvature = dot(by_bias, by_bias);
        let scale = (self.rows.len as f64 / freedom).sqrt();
        let terms: Vec<f64> = by_bias
            .iter()
            .zip(&local.residuals)
            .map(|(j, e)| scale * j * e / curvature.max(1e-12))
            .collect();
        FrameFit {
            bias_us: shape.bias_us,
            rss: local.rss,
            share: if total > 0.0 {
                1.0 - local.rss / total
            } else {
                0.0
            },
            edge_share: if edges > 0.0 {
                1.0 - edge_energy(&local.residuals, apart) / edges
            } else {
                0.0
            },
            significance: significance.copysign(local.amplitude),
            amplitude: local.amplitude,
            coefficients: local.coefficients,
            sigma_us: if curvature > 0.0 {
                variance_of_sum(&terms, ROW_LAG).sqrt()
            } else {
                f64::INFINITY
            },
            inflation,
            mean_light: super::stats::mean(&local.light),
            light: local.light,
            residuals: local.residuals,
        }
    }

    /// Light of the train at `shape` with given coefficients, grey levels a row.
    pub fn light(&self, shape: &Shape, coefficients: &[f64; 4]) -> Vec<f64> {
        let [c0, c1, c2, c3] = coefficients;
        self.places
            .iter()
            .enumerate()
            .map(|(i, x)| {
                let t = row_light(&self.train, shape, self.rows.position(i)).value;
                t * (c0 + c1 * x + c2 * x * x + c3 * t)
            })
            .collect()
    }

    /// Sum of squares left with the train exactly at `shape`.
    pub fn rss_at(&self, y: &[f64], shape: &Shape) -> f64 {
        self.local(y, shape).rss
    }

    fn freedom(&self, parameters: usize) -> f64 {
        let used = self.smooth.columns().len() + parameters;
        self.rows.len.saturating_sub(used).max(1) as f64
    }

    /// Fits several frames together, starting from `bias_us` and `start`'s row
    /// time and exposure.
    pub fn fit_joint(
        &self,
        frames: &[Vec<f64>],
        bias_us: &[f64],
        start: &Shape,
        priors: &Priors,
    ) -> JointFit {
        let mut state = State {
            bias_us: bias_us.to_vec(),
            shared: [start.row_time_us, start.exposure_us],
        };
        let mut locals = self.locals(frames, &state);
        let mut cost = total_cost(&locals, &state, priors);
        let mut damping = 1e-3;
        for _ in 0..60 {
            let Some(step) = self.step(&locals, &state, priors, damping) else {
                damping *= 10.0;
                if damping > 1e8 {
                    break;
                }
                continue;
            };
            let tried = state.moved(&step);
            let tried_locals = self.locals(frames, &tried);
            let tried_cost = total_cost(&tried_locals, &tried, priors);
            if tried_cost < cost {
                let gain = (cost - tried_cost) / cost.max(1e-300);
                state = tried;
                locals = tried_locals;
                cost = tried_cost;
                damping = (damping * 0.2).max(1e-9);
                if step.largest() < 1e-5 || gain < 1e-12 {
                    break;
                }
            } else {
                damping *= 8.0;
                if damping > 1e8 {
                    break;
                }
            }
        }
        self.judge(&locals, &state, priors)
    }

    fn locals(&self, frames: &[Vec<f64>], state: &State) -> Vec<Local> {
        frames
            .par_iter()
            .zip(&state.bias_us)
            .map(|(y, &bias)| self.local(y, &state.shape(bias)))
            .collect()
    }

    /// One damped Gauss-Newton step; the frames' own parameters are eliminated.
    fn step(&self, locals: &[Local], state: &State, priors: &Priors, damping: f64) -> Option<Step> {
        let normal: Vec<FrameNormal> = locals.iter().map(FrameNormal::of).collect();
        let (mut matrix, mut right) = reduced(&normal, damping);
        for ((row, prior), (value, right)) in matrix
            .iter_mut()
            .enumerate()
            .zip([priors.row_time_us, priors.exposure_us])
            .zip(state.shared.iter().zip(&mut right))
        {
            let (index, row) = row;
            if let (Some(diagonal), Some(prior)) = (row.get_mut(index), prior) {
                let weight = noise_scale(locals) / (prior.sigma * prior.sigma);
                *diagonal += weight;
                *right += weight * (prior.value - value);
            }
        }
        let shared = solve(matrix, right)?;
        let [row_time, exposure] = state.shared;
        let [d_row, d_exposure] = shared;
        let shared = [
            d_row.clamp(-0.01 * row_time, 0.01 * row_time),
            d_exposure.clamp(-0.2 * exposure, 0.2 * exposure),
        ];
        let bias = normal
            .iter()
            .map(|n| {
                let coupled: f64 = n.cross.iter().zip(&shared).map(|(c, s)| c * s).sum();
                let own = n.own * (1.0 + damping);
                if own > 0.0 {
                    ((n.own_right - coupled) / own).clamp(-60.0, 60.0)
                } else {
                    0.0
                }
            })
            .collect();
        Some(Step { bias, shared })
    }

    /// Uncertainties about the solution.
    fn judge(&self, locals: &[Local], state: &State, priors: &Priors) -> JointFit {
        let count = locals.len().max(1) as f64;
        let normal: Vec<FrameNormal> = locals.iter().map(FrameNormal::of).collect();
        let (mut matrix, _) = reduced(&normal, 0.0);
        let noise = noise_scale(locals);
        let mut prior_weight = [0.0; 2];
        for (weight, prior) in prior_weight
            .iter_mut()
            .zip([priors.row_time_us, priors.exposure_us])
        {
            if let Some(prior) = prior {
                *weight = noise / (prior.sigma * prior.sigma);
            }
        }
        for (i, weight) in prior_weight.iter().enumerate() {
            if let Some(d) = matrix.get_mut(i).and_then(|r| r.get_mut(i)) {
                *d += weight;
            }
        }
        // Rows of the inverse: how the shared parameters answer to the rows' errors.
        let inverse = [solve(matrix, [1.0, 0.0]), solve(matrix, [0.0, 1.0])];
        let scale = (self.rows.len as f64 / self.freedom(5)).sqrt();
        let n = self.rows.len;

        // Weighted sums of row errors: the mean of the frames' centres, and the two
        // shared parameters.
        let mut mean_terms = vec![0.0; n];
        let mut shared_terms = [vec![0.0; n], vec![0.0; n]];
        let mut mean_by_shared = [0.0; 2];
        for f in &normal {
            if f.own > 0.0 {
                for (sum, cross) in mean_by_shared.iter_mut().zip(f.cross) {
                    *sum -= cross / f.own / count;
                }
            }
        }
        for (local, f) in locals.iter().zip(&normal) {
            let [by_bias, by_row, by_exposure] = &local.by;
            for i in 0..n {
                let (Some(&b), Some(&r), Some(&e), Some(&residual)) = (
                    by_bias.get(i),
                    by_row.get(i),
                    by_exposure.get(i),
                    local.residuals.get(i),
                ) else {
                    continue;
                };
                let error = residual * scale;
                let own = if f.own > 0.0 { b / f.own } else { 0.0 };
                let [cross_row, cross_exposure] = f.cross;
                let reduced = [r - cross_row * own, e - cross_exposure * own];
                let mut mean_weight = own / count;
                for (k, line) in inverse.iter().enumerate() {
                    let Some(line) = line else { continue };
                    let weight: f64 = line.iter().zip(reduced).map(|(l, r)| l * r).sum();
                    mean_weight += mean_by_shared.get(k).copied().unwrap_or(0.0) * weight;
                    if let Some(term) = shared_terms.get_mut(k).and_then(|t| t.get_mut(i)) {
                        *term += weight * error;
                    }
                }
                if let Some(term) = mean_terms.get_mut(i) {
                    *term += mean_weight * error;
                }
            }
        }
        // A prior's own uncertainty.
        let prior_variance = |weights: [f64; 2]| -> f64 {
            // Answer of the quantity to a change of each prior's value.
            (0..2)
                .filter_map(|p| {
                    let weight = *prior_weight.get(p)?;
                    let prior = [priors.row_time_us, priors.exposure_us].get(p).copied()??;
                    let answer: f64 = inverse
                        .iter()
                        .zip(weights)
                        .filter_map(|(line, w)| Some(w * line.as_ref()?.get(p)? * weight))
                        .sum();
                    Some((answer * prior.sigma).powi(2))
                })
                .sum()
        };
        let sigma = |terms: &[f64], weights: [f64; 2]| {
            (variance_of_sum(terms, ROW_LAG) + prior_variance(weights)).sqrt()
        };
        let [row_terms, exposure_terms] = &shared_terms;
        let [row_time_us, exposure_us] = state.shared;
        let determined = inverse.iter().all(Option::is_some);
        let known = |sigma: f64| if determined { sigma } else { f64::INFINITY };
        JointFit {
            mean_us: super::stats::mean(&state.bias_us),
            mean_sigma_us: sigma(&mean_terms, mean_by_shared),
            bias_us: state.bias_us.clone(),
            row_time_us,
            row_time_sigma_us: known(sigma(row_terms, [1.0, 0.0])),
            exposure_us,
            exposure_sigma_us: known(sigma(exposure_terms, [0.0, 1.0])),
            rss: locals.iter().map(|l| l.rss).sum(),
        }
    }
}

struct State {
    bias_us: Vec<f64>,
    /// Row time and exposure.
    shared: [f64; 2],
}

impl State {
    fn shape(&self, bias_us: f64) -> Shape {
        let [row_time_us, exposure_us] = self.shared;
        Shape {
            bias_us,
            row_time_us,
            exposure_us,
        }
    }

    fn moved(&self, step: &Step) -> Self {
        let mut shared = self.shared;
        for (value, step) in shared.iter_mut().zip(step.shared) {
            *value += step;
        }
        Self {
            bias_us: self
                .bias_us
                .iter()
                .zip(&step.bias)
                .map(|(b, s)| b + s)
                .collect(),
            shared,
        }
    }
}

struct Step {
    bias: Vec<f64>,
    shared: [f64; 2],
}

impl Step {
    /// Largest move in µs at the picture's edge, where a row time counts a
    /// thousandfold.
    fn largest(&self) -> f64 {
        let [row, exposure] = self.shared;
        let bias = self.bias.iter().fold(0.0f64, |m, b| m.max(b.abs()));
        bias.max(row.abs() * 1e3).max(exposure.abs())
    }
}

/// Normal equations of one frame.
struct FrameNormal {
    own: f64,
    own_right: f64,
    cross: [f64; 2],
    shared: [[f64; 2]; 2],
    shared_right: [f64; 2],
}

impl FrameNormal {
    fn of(local: &Local) -> Self {
        let [b, r, e] = &local.by;
        let re = dot(r, e);
        Self {
            own: dot(b, b),
            own_right: dot(b, &local.residuals),
            cross: [dot(b, r), dot(b, e)],
            shared: [[dot(r, r), re], [re, dot(e, e)]],
            shared_right: [dot(r, &local.residuals), dot(e, &local.residuals)],
        }
    }
}

/// The shared parameters' equations with every frame's own parameter eliminated.
fn reduced(normal: &[FrameNormal], damping: f64) -> ([[f64; 2]; 2], [f64; 2]) {
    let mut matrix = [[0.0; 2]; 2];
    let mut right = [0.0; 2];
    for n in normal {
        let own = n.own * (1.0 + damping);
        for (i, (row, (line, cross_i))) in matrix
            .iter_mut()
            .zip(n.shared.iter().zip(n.cross))
            .enumerate()
        {
            for (j, (m, (value, cross_j))) in
                row.iter_mut().zip(line.iter().zip(n.cross)).enumerate()
            {
                *m += value * if i == j { 1.0 + damping } else { 1.0 };
                if own > 0.0 {
                    *m -= cross_i * cross_j / own;
                }
            }
        }
        for ((right, value), cross) in right.iter_mut().zip(n.shared_right).zip(n.cross) {
            *right += value;
            if own > 0.0 {
                *right -= cross * n.own_right / own;
            }
        }
    }
    (matrix, right)
}

fn solve([[a, b], [c, d]]: [[f64; 2]; 2], [e, f]: [f64; 2]) -> Option<[f64; 2]> {
    // Scaled, because a row time weighs a thousand times more than an exposure.
    let (s, t) = (a.sqrt(), d.sqrt());
    if !(s > 0.0 && t > 0.0) {
        return None;
    }
    let (b, c) = (b / (s * t), c / (s * t));
    let determinant = 1.0 - b * c;
    if determinant.is_nan() || determinant <= 1e-10 {
        return None;
    }
    let (e, f) = (e / s, f / t);
    Some([(e - b * f) / determinant / s, (f - c * e) / determinant / t])
}

/// Sum of squares of differences of values `apart` places apart.
fn edge_energy(values: &[f64], apart: usize) -> f64 {
    values
        .iter()
        .zip(values.iter().skip(apart))
        .map(|(a, b)| (b - a).powi(2))
        .sum()
}

fn noise_scale(locals: &[Local]) -> f64 {
    let rows: usize = locals.iter().map(|l| l.residuals.len()).sum();
    let rss: f64 = locals.iter().map(|l| l.rss).sum();
    (rss / rows.max(1) as f64).max(1e-12)
}

fn total_cost(locals: &[Local], state: &State, priors: &Priors) -> f64 {
    let rss: f64 = locals.iter().map(|l| l.rss).sum();
    let sane = state.shared.iter().all(|v| v.is_finite() && *v > 0.0);
    if !sane || !rss.is_finite() {
        return f64::INFINITY;
    }
    let noise = noise_scale(locals);
    let known: f64 = [priors.row_time_us, priors.exposure_us]
        .iter()
        .zip(state.shared)
        .filter_map(|(p, v)| p.map(|p| ((v - p.value) / p.sigma).powi(2)))
        .sum();
    rss + noise * known
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROWS: RowGrid = RowGrid {
        first: -539.5,
        step: 1.0,
        len: 1080,
    };

    fn noise(i: usize, frame: usize) -> f64 {
        // Repeatable, close to white: fractional parts of a quadratic.
        (((i * i + 7919 * frame * i + frame) as f64) * 0.618_033_988_749_894).fract() - 0.5
    }

    fn frame(shape: &Shape, amplitude: f64, level: f64, number: usize) -> Vec<f32> {
        (0..ROWS.len)
            .map(|i| {
                let p = ROWS.position(i);
                let x = p / 540.0;
                let light = row_light(&TrainGeometry::NFOV, shape, p).value;
                (40.0 - 8.0 * x * x
                    + amplitude * (1.0 - 0.1 * x) * light
                    + level * noise(i, number)) as f32
            })
            .collect()
    }

    fn model() -> Model {
        Model::new(ROWS, TrainGeometry::NFOV, Basis::polynomials(ROWS.len, 5))
    }

    #[test]
    fn a_frame_without_noise_is_fitted_exactly() {
        for (exposure_us, bias_us) in [(125.0, 3.21), (60.0, -512.3), (900.0, 77.7), (4000.0, 0.4)]
        {
            let truth = Shape {
                bias_us,
                row_time_us: 10.2,
                exposure_us,
            };
            let model = model();
            let y = model.detrend(&frame(&truth, 20.0, 0.0, 0));
            let start = Shape {
                bias_us: bias_us + 11.0,
                row_time_us: 10.23,
                exposure_us: exposure_us * 1.1,
            };
            let fit = model.fit_joint(&[y], &[start.bias_us], &start, &Priors::default());
            assert!(
                (fit.mean_us - bias_us).abs() < 1e-3,
                "{exposure_us}: {fit:?}"
            );
            assert!((fit.row_time_us - 10.2).abs() < 1e-5, "{fit:?}");
            assert!((fit.exposure_us - exposure_us).abs() < 0.1, "{fit:?}");
        }
    }

    #[test]
    fn stated_uncertainty_is_that_of_the_errors() {
        let model = model();
        let mut normal = Vec::new();
        let mut row_time = Vec::new();
        for run in 0..60 {
            let truth = Shape {
                bias_us: -40.0 + 1.37 * run as f64,
                row_time_us: 10.2,
                exposure_us: 300.0,
            };
            let frames: Vec<Vec<f64>> = (0..4)
                .map(|k| model.detrend(&frame(&truth, 10.0, 2.0, 10 * run + k)))
                .collect();
            let fit = model.fit_joint(&frames, &[truth.bias_us; 4], &truth, &Priors::default());
            normal.push((fit.mean_us - truth.bias_us) / fit.mean_sigma_us);
            row_time.push((fit.row_time_us - 10.2) / fit.row_time_sigma_us);
        }
        for z in [normal, row_time] {
            let square = z.iter().map(|z| z * z).sum::<f64>() / z.len() as f64;
            assert!((0.4..1.5).contains(&square), "mean z² {square}");
        }
    }

    #[test]
    fn a_prior_holds_what_the_frame_does_not_say() {
        // One flash in view alone does not give a row time.
        let rows = RowGrid {
            first: -60.0,
            step: 1.0,
            len: 120,
        };
        let model = Model::new(rows, TrainGeometry::NFOV, Basis::polynomials(120, 2));
        let truth = Shape {
            bias_us: 5.0,
            row_time_us: 10.2,
            exposure_us: 125.0,
        };
        let profile: Vec<f32> = (0..120)
            .map(|i| {
                let l = row_light(&TrainGeometry::NFOV, &truth, rows.position(i)).value;
                (30.0 * l + 0.2 * noise(i, 3)) as f32
            })
            .collect();
        let y = model.detrend(&profile);
        let priors = Priors {
            row_time_us: Some(Prior {
                value: 10.2,
                sigma: 0.01,
            }),
            exposure_us: Some(Prior {
                value: 125.0,
                sigma: 1.0,
            }),
        };
        let fit = model.fit_joint(&[y], &[0.0], &truth, &priors);
        assert!((fit.mean_us - 5.0).abs() < 0.5, "{fit:?}");
        assert!((fit.row_time_us - 10.2).abs() < 0.03, "{fit:?}");
        assert!(fit.row_time_sigma_us > 0.0005, "{fit:?}");
    }

    #[test]
    fn a_wrong_row_time_that_is_held_biases_and_a_fitted_one_does_not() {
        let model = model();
        // Off centre, so that the row time acts as a shift.
        let truth = Shape {
            bias_us: 500.0,
            row_time_us: 10.2,
            exposure_us: 125.0,
        };
        let y = model.detrend(&frame(&truth, 20.0, 0.0, 0));
        let wrong = Shape {
            row_time_us: 10.2 * (1.0 + 5e-3),
            ..truth
        };
        let held = model.fit_frame(&y, &wrong);
        let fitted = model.fit_joint(&[y], &[500.0], &wrong, &Priors::default());
        assert!((held.bias_us - 500.0).abs() > 0.3, "{}", held.bias_us);
        assert!((fitted.mean_us - 500.0).abs() < 1e-2, "{fitted:?}");
    }
}
