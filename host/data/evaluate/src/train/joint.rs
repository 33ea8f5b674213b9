//! Several frames fitted together: a train centre for each, and a row time and an
//! exposure shared by all.
//!
//! The normal equations are block arrow-shaped: each frame's own centre is eliminated,
//! which leaves two equations for the shared parameters for any number of frames.
//! Averaging over frames sums the rows' errors *before* squaring, so that what all
//! frames have in common (the texture of the scene, a compressed picture repeated from
//! frame to frame) does not average out.

use nalgebra::{DVector, Matrix2, MatrixXx2, MatrixXx3, Vector2};
use rayon::prelude::*;

use crate::stats::{mean, variance_of_sum};
use crate::train::Shape;
use crate::train::fit::{Local, Model, ROW_LAG};

/// Prior of a shared parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Prior {
    /// Expected value.
    pub(crate) value: f64,
    /// Standard uncertainty of the value.
    pub(crate) sigma: f64,
}

/// Priors of the camera.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Priors {
    /// Row time, µs.
    pub(crate) row_time_us: Option<Prior>,
    /// Exposure, µs.
    pub(crate) exposure_us: Option<Prior>,
}

impl Priors {
    /// Returns the weights for residuals of this mean square; zero for unknown parameters.
    fn weights(&self, noise: f64) -> Vector2<f64> {
        let weight = |prior: Option<Prior>| prior.map_or(0.0, |p| noise / (p.sigma * p.sigma));
        Vector2::new(weight(self.row_time_us), weight(self.exposure_us))
    }

    /// Returns the expected minus the current shared parameters; zero for unknown ones.
    fn distance(&self, shared: &Vector2<f64>) -> Vector2<f64> {
        let to = |prior: Option<Prior>, value| prior.map_or(0.0, |p| p.value - value);
        Vector2::new(
            to(self.row_time_us, shared.x),
            to(self.exposure_us, shared.y),
        )
    }
}

/// Several frames fitted together.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct JointFit {
    /// Centre of the train in each frame, µs.
    pub(crate) bias_us: Vec<f64>,
    /// Mean of the centres, µs.
    pub(crate) mean_us: f64,
    /// Standard uncertainty of the mean, including those of row time and exposure, µs.
    pub(crate) mean_sigma_us: f64,
    pub(crate) row_time_us: f64,
    pub(crate) row_time_sigma_us: f64,
    pub(crate) exposure_us: f64,
    pub(crate) exposure_sigma_us: f64,
}

impl JointFit {
    /// Returns the shape of the train at the frames' mean centre.
    pub(crate) fn shape(&self) -> Shape {
        Shape {
            bias_us: self.mean_us,
            row_time_us: self.row_time_us,
            exposure_us: self.exposure_us,
        }
    }
}

impl Model {
    /// Fits several frames together, starting from `bias_us` and `start`'s row
    /// time and exposure (Levenberg-Marquardt).
    pub(crate) fn fit_joint(
        &self,
        frames: &[DVector<f64>],
        bias_us: &[f64],
        start: &Shape,
        priors: &Priors,
    ) -> JointFit {
        let mut state = State {
            bias_us: bias_us.to_vec(),
            shared: Vector2::new(start.row_time_us, start.exposure_us),
        };
        let mut locals = self.locals(frames, &state);
        let mut cost = total_cost(&locals, &state, priors);
        let mut damping = 1e-3;
        for _ in 0..60 {
            let Some(step) = state.step(&locals, priors, damping) else {
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
        self.with_uncertainties(&locals, state, priors)
    }

    fn locals(&self, frames: &[DVector<f64>], state: &State) -> Vec<Local> {
        frames
            .par_iter()
            .zip(&state.bias_us)
            .map(|(y, &bias)| self.local(y, &state.shape(bias)))
            .collect()
    }

    /// Adds the uncertainties of the solution.
    fn with_uncertainties(&self, locals: &[Local], state: State, priors: &Priors) -> JointFit {
        let normal: Vec<FrameNormal> = locals.iter().map(FrameNormal::new).collect();
        let noise = noise_scale(locals);
        let weights = priors.weights(noise);
        let (matrix, _) = reduced(&normal, 0.0);
        let inverse = inverse(&(matrix + Matrix2::from_diagonal(&weights)));
        let determined = inverse.is_some();
        let inverse = inverse.unwrap_or_default();
        let scale = (self.rows.len as f64 / self.freedom(5)).sqrt();

        // Errors of the mean of the frames' centres and of the two shared parameters,
        // as sums over the rows' errors.
        let count = locals.len().max(1) as f64;
        let mean_by_shared: Vector2<f64> = normal
            .iter()
            .map(|f| -f.cross * f.own_variance() / count)
            .sum();
        let mut terms = MatrixXx3::zeros(self.rows.len);
        for (local, f) in locals.iter().zip(&normal) {
            let own = local.by.column(0) * f.own_variance();
            let shared: MatrixXx2<f64> =
                local.by.fixed_columns::<2>(1) - &own * f.cross.transpose();
            let shared = shared * inverse;
            let center = own / count + &shared * mean_by_shared;
            for (k, weights) in [center.column(0), shared.column(0), shared.column(1)]
                .into_iter()
                .enumerate()
            {
                let errors = weights.component_mul(&local.residuals);
                terms.column_mut(k).axpy(scale, &errors, 1.0);
            }
        }
        // `by_shared` is the derivative of a quantity with respect to the shared parameters.
        let sigma = |quantity: usize, by_shared: Vector2<f64>| {
            let rows: Vec<f64> = terms.column(quantity).iter().copied().collect();
            let answer = inverse * by_shared;
            let known = noise * weights.dot(&answer.component_mul(&answer));
            (variance_of_sum(&rows, ROW_LAG) + known).sqrt()
        };
        let known = |sigma: f64| if determined { sigma } else { f64::INFINITY };
        JointFit {
            mean_us: mean(&state.bias_us),
            mean_sigma_us: sigma(0, mean_by_shared),
            row_time_us: state.shared.x,
            row_time_sigma_us: known(sigma(1, Vector2::x())),
            exposure_us: state.shared.y,
            exposure_sigma_us: known(sigma(2, Vector2::y())),
            bias_us: state.bias_us,
        }
    }
}

struct State {
    bias_us: Vec<f64>,
    /// Row time and exposure.
    shared: Vector2<f64>,
}

impl State {
    fn shape(&self, bias_us: f64) -> Shape {
        Shape {
            bias_us,
            row_time_us: self.shared.x,
            exposure_us: self.shared.y,
        }
    }

    /// One damped Gauss-Newton step.
    fn step(&self, locals: &[Local], priors: &Priors, damping: f64) -> Option<Step> {
        let normal: Vec<FrameNormal> = locals.iter().map(FrameNormal::new).collect();
        let (matrix, right) = reduced(&normal, damping);
        let weights = priors.weights(noise_scale(locals));
        let right = right + weights.component_mul(&priors.distance(&self.shared));
        let shared = inverse(&(matrix + Matrix2::from_diagonal(&weights)))? * right;
        let limit = self.shared.component_mul(&Vector2::new(0.01, 0.2));
        let shared = shared.zip_map(&limit, |step, limit| step.clamp(-limit, limit));
        let bias = normal
            .iter()
            .map(|n| {
                let step = n.own_variance() * (n.own_right - n.cross.dot(&shared));
                (step / (1.0 + damping)).clamp(-60.0, 60.0)
            })
            .collect();
        Some(Step { bias, shared })
    }

    fn moved(&self, step: &Step) -> Self {
        let moved = self.bias_us.iter().zip(&step.bias);
        Self {
            bias_us: moved.map(|(b, s)| b + s).collect(),
            shared: self.shared + step.shared,
        }
    }
}

struct Step {
    bias: Vec<f64>,
    shared: Vector2<f64>,
}

impl Step {
    /// Returns the largest motion at the picture's edge in µs, where a change of the row time
    /// counts a thousandfold.
    fn largest(&self) -> f64 {
        let bias = self.bias.iter().fold(0.0f64, |m, b| m.max(b.abs()));
        bias.max(self.shared.x.abs() * 1e3).max(self.shared.y.abs())
    }
}

/// Normal equations of one frame: its own centre, the shared parameters, and both.
struct FrameNormal {
    own: f64,
    own_right: f64,
    cross: Vector2<f64>,
    shared: Matrix2<f64>,
    shared_right: Vector2<f64>,
}

impl FrameNormal {
    fn new(local: &Local) -> Self {
        let matrix = local.by.tr_mul(&local.by);
        let right = local.by.tr_mul(&local.residuals);
        Self {
            own: matrix[(0, 0)],
            own_right: right[0],
            cross: matrix.fixed_view::<2, 1>(1, 0).into_owned(),
            shared: matrix.fixed_view::<2, 2>(1, 1).into_owned(),
            shared_right: right.fixed_rows::<2>(1).into_owned(),
        }
    }

    /// Returns the variance of the frame's own centre; zero for a frame without information
    /// about it.
    fn own_variance(&self) -> f64 {
        if self.own > 0.0 { 1.0 / self.own } else { 0.0 }
    }
}

/// The shared parameters' equations with every frame's own parameter eliminated.
fn reduced(normal: &[FrameNormal], damping: f64) -> (Matrix2<f64>, Vector2<f64>) {
    let mut matrix = Matrix2::zeros();
    let mut right = Vector2::zeros();
    for n in normal {
        let variance = n.own_variance() / (1.0 + damping);
        matrix += n.shared + damping * Matrix2::from_diagonal(&n.shared.diagonal())
            - variance * n.cross * n.cross.transpose();
        right += n.shared_right - variance * n.own_right * n.cross;
    }
    (matrix, right)
}

/// Inverse of the normal equations; `None` if the frames do not determine the parameters.
fn inverse(matrix: &Matrix2<f64>) -> Option<Matrix2<f64>> {
    // Scaled, because the row time has a thousand times the weight of the exposure.
    let scale = Matrix2::from_diagonal(&matrix.diagonal().map(|d| 1.0 / d.sqrt()));
    let scaled = scale * matrix * scale;
    let apart = scaled.determinant() > 1e-10;
    Some(scale * scaled.cholesky().filter(|_| apart)?.inverse() * scale)
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
    let distance = priors.distance(&state.shared);
    let weights = priors.weights(noise_scale(locals));
    rss + weights.dot(&distance.component_mul(&distance))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::linear::Basis;
    use crate::train::search::RowGrid;
    use crate::train::{TrainGeometry, row_light};

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
            let shape = Shape {
                bias_us,
                row_time_us: 10.2,
                exposure_us,
            };
            let model = model();
            let y = model.detrend(&frame(&shape, 20.0, 0.0, 0));
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
    fn a_prior_determines_what_the_frame_does_not() {
        // One flash in view alone does not give a row time.
        let rows = RowGrid {
            first: -60.0,
            step: 1.0,
            len: 120,
        };
        let model = Model::new(rows, TrainGeometry::NFOV, Basis::polynomials(120, 2));
        let shape = Shape {
            bias_us: 5.0,
            row_time_us: 10.2,
            exposure_us: 125.0,
        };
        let profile: Vec<f32> = (0..120)
            .map(|i| {
                let l = row_light(&TrainGeometry::NFOV, &shape, rows.position(i)).value;
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
        let fit = model.fit_joint(&[y], &[0.0], &shape, &priors);
        assert!((fit.mean_us - 5.0).abs() < 0.5, "{fit:?}");
        assert!((fit.row_time_us - 10.2).abs() < 0.03, "{fit:?}");
        assert!(fit.row_time_sigma_us > 0.0005, "{fit:?}");
    }
}
