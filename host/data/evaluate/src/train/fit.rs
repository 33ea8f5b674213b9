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
//! the light vary over the picture, `c3` models a camera's tone curve: it is
//! symmetric about each flash and shifts nothing. All these enter linearly and are
//! eliminated (variable projection, with Kaufman's Jacobian); what is left is one
//! train centre per frame, and a row time and an exposure shared by all frames
//! ([`crate::train::joint`]).
//!
//! Uncertainty comes from the residuals themselves, not from an assumed noise:
//! each parameter's error is a known weighted sum of the rows' errors, and the
//! variance of that sum includes the correlation of neighbouring rows
//! ([`variance_of_sum`]).

use nalgebra::{DMatrix, DVector, MatrixXx3, Vector4};

use crate::stats::{correlation_inflation, variance_of_sum};
use crate::train::linear::{Basis, Orthonormal, orthonormal, unit_places};
use crate::train::search::RowGrid;
use crate::train::{Shape, TrainGeometry, row_light};

/// Correlation length of row errors: one and a half blocks of a video encoder.
pub(crate) const ROW_LAG: usize = 24;
/// Correlation length in the detection of flashes: pictures of ordinary scenes are smooth over
/// many rows.
const DETECTION_LAG: usize = 64;
/// Least significance of a train, in standard deviations.
const SEEN: f64 = 8.0;
/// Least share of a term of the light that is independent of the smooth part and of the terms
/// before it; other terms are left out.
const DEPENDENT: f64 = 2e-3;

/// The model of one recording's frames.
#[derive(Debug, Clone)]
pub(crate) struct Model {
    /// Places of the rows.
    pub(crate) rows: RowGrid,
    pub(crate) train: TrainGeometry,
    /// The part of the brightness that is not flashes.
    pub(crate) smooth: Basis,
    places: DVector<f64>,
}

/// Fit of flashes to one frame.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FrameFit {
    /// Centre of the train, µs after the middle row's centre of exposure.
    pub(crate) bias_us: f64,
    /// Residual sum of squares.
    pub(crate) rss: f64,
    /// Share of the sum of squares outside the smooth part that the train explains.
    pub(crate) share: f64,
    /// The same share for differences of rows one flash apart: structure that is smooth but no
    /// polynomial (ordinary scenes, lamps) is not explained by the sharp edges of
    /// flashes.
    pub(crate) edge_share: f64,
    /// Significance of the train, in standard deviations; negative for a dark train.
    pub(crate) significance: f64,
    /// Grey levels that a whole flash adds, mean over the light seen.
    pub(crate) amplitude: f64,
    /// Coefficients of the train's light: constant, place, place², own light.
    pub(crate) coefficients: Vector4<f64>,
    /// Standard uncertainty of `bias_us` at fixed row time and exposure, µs.
    pub(crate) sigma_us: f64,
    /// Factor by which correlation between rows raises a variance.
    pub(crate) inflation: f64,
    /// Mean of the fitted light of the flashes, grey levels.
    pub(crate) mean_light: f64,
}

impl FrameFit {
    /// Returns true if this is a train of flashes that explains at least `share` of the frame.
    pub(crate) fn is_train(&self, share: f64) -> bool {
        let explained = self.share.min(self.edge_share);
        self.significance >= SEEN && explained >= share && self.amplitude > 0.0
    }
}

/// A frame's model and derivatives about a point.
pub(crate) struct Local {
    pub(crate) residuals: DVector<f64>,
    pub(crate) rss: f64,
    /// Derivatives with respect to train centre, row time and exposure.
    pub(crate) by: MatrixXx3<f64>,
    mean_light: f64,
    amplitude: f64,
    coefficients: Vector4<f64>,
    terms: usize,
}

impl Model {
    /// Creates a model; `smooth` must have as many rows as `rows`.
    pub(crate) fn new(rows: RowGrid, train: TrainGeometry, smooth: Basis) -> Self {
        Self {
            rows,
            train,
            smooth,
            places: unit_places(rows.len),
        }
    }

    /// Returns a profile without its smooth part.
    pub(crate) fn detrend(&self, profile: &[f32]) -> DVector<f64> {
        self.smooth.outside(profile)
    }

    /// Linearises about `shape`; `y` has no smooth part.
    pub(crate) fn local(&self, y: &DVector<f64>, shape: &Shape) -> Local {
        let n = self.rows.len;
        let mut by = MatrixXx3::zeros(n);
        let value = DVector::from_fn(n, |i, _| {
            let l = row_light(&self.train, shape, self.rows.position(i));
            by[(i, 0)] = l.by_bias;
            by[(i, 1)] = l.by_row_time;
            by[(i, 2)] = l.by_exposure;
            l.value
        });
        let terms = self.terms(&value);
        let least = DVector::from_fn(4, |k, _| DEPENDENT * terms.column(k).norm());
        let mut own = terms.clone();
        self.smooth.remove_from(&mut own);
        let Orthonormal { q, r, kept } = orthonormal(&own, &least);
        let along = q.tr_mul(y);
        let residuals = y - &q * &along;
        let mut coefficients = Vector4::zeros();
        // Always solvable: a small diagonal was left out.
        if let Some(solved) = r.solve_upper_triangular(&along) {
            for (&term, &c) in kept.iter().zip(&solved) {
                coefficients[term] = c;
            }
        }
        let light = terms * coefficients;
        let seen = value.sum();
        // Derivative of the light by the flashes seen.
        let [c0, c1, c2, c3] = coefficients.into();
        let slope = value.zip_map(&self.places, |t, x| c0 + c1 * x + c2 * x * x + 2.0 * c3 * t);
        for mut column in by.column_iter_mut() {
            column.component_mul_assign(&slope);
        }
        self.smooth.remove_from(&mut by);
        let explained = &q * q.tr_mul(&by);
        by -= explained;
        Local {
            rss: residuals.norm_squared(),
            residuals,
            by,
            mean_light: light.mean(),
            amplitude: if seen > 0.0 { light.sum() / seen } else { 0.0 },
            coefficients,
            terms: kept.len(),
        }
    }

    /// Returns the terms that the amplitude's coefficients multiply, for the flashes that each
    /// row sees.
    fn terms(&self, value: &DVector<f64>) -> DMatrix<f64> {
        DMatrix::from_fn(value.len(), 4, |i, k| {
            let (t, x) = (value[i], self.places[i]);
            match k {
                0 => t,
                1 => t * x,
                2 => t * x * x,
                _ => t * t,
            }
        })
    }

    /// Fits the train's centre in one frame at fixed row time and exposure.
    pub(crate) fn fit_frame(&self, y: &DVector<f64>, start: &Shape) -> FrameFit {
        let (shape, local) = self.descend(y, start);
        let total = y.norm_squared();
        let apart = (self.train.duration_us / (shape.row_time_us * self.rows.step)).round();
        let apart = (apart as usize).clamp(1, (self.rows.len / 8).max(1));
        let explained = |before: f64, after: f64| {
            if before > 0.0 {
                1.0 - after / before
            } else {
                0.0
            }
        };
        let freedom = self.freedom(local.terms + 1);
        let noise = local.rss / freedom;
        let inflation = correlation_inflation(local.residuals.as_slice(), DETECTION_LAG);
        let significance =
            (total - local.rss).max(0.0).sqrt() / (noise * inflation).sqrt().max(1e-9);
        let by_bias = local.by.column(0);
        let curvature = by_bias.norm_squared();
        let scale = (self.rows.len as f64 / freedom).sqrt();
        let errors = by_bias.component_mul(&local.residuals) * (scale / curvature.max(1e-12));
        FrameFit {
            bias_us: shape.bias_us,
            rss: local.rss,
            share: explained(total, local.rss),
            edge_share: explained(edge_energy(y, apart), edge_energy(&local.residuals, apart)),
            significance: significance.copysign(local.amplitude),
            amplitude: local.amplitude,
            coefficients: local.coefficients,
            sigma_us: if curvature > 0.0 {
                variance_of_sum(errors.as_slice(), ROW_LAG).sqrt()
            } else {
                f64::INFINITY
            },
            inflation,
            mean_light: local.mean_light,
        }
    }

    /// Moves the train's centre to the minimum (Gauss-Newton).
    fn descend(&self, y: &DVector<f64>, start: &Shape) -> (Shape, Local) {
        let mut shape = *start;
        let mut local = self.local(y, &shape);
        let limit = 0.25 * (self.train.duration_us + shape.exposure_us).min(500.0);
        for _ in 0..12 {
            let by_bias = local.by.column(0);
            let curvature = by_bias.norm_squared();
            if curvature <= 0.0 {
                break;
            }
            let step = (by_bias.dot(&local.residuals) / curvature).clamp(-limit, limit);
            let better = (0..4)
                .map(|shorter| step * 0.3_f64.powi(shorter))
                .find_map(|step| {
                    let tried = shape.at(shape.bias_us + step);
                    let at = self.local(y, &tried);
                    (at.rss < local.rss).then_some((step, tried, at))
                });
            let Some((step, tried, at)) = better else {
                break;
            };
            (shape, local) = (tried, at);
            if step.abs() < 1e-5 {
                break;
            }
        }
        (shape, local)
    }

    /// Returns the light of the train at `shape` with given coefficients, grey levels of each
    /// row.
    pub(crate) fn light(&self, shape: &Shape, coefficients: &Vector4<f64>) -> DVector<f64> {
        let seen = |i| row_light(&self.train, shape, self.rows.position(i)).value;
        self.terms(&DVector::from_fn(self.rows.len, |i, _| seen(i))) * coefficients
    }

    /// Returns the number of rows minus that of the fitted parameters.
    pub(crate) fn freedom(&self, parameters: usize) -> f64 {
        let used = self.smooth.columns().ncols() + parameters;
        self.rows.len.saturating_sub(used).max(1) as f64
    }
}

/// Sum of squares of the differences of values `apart` rows apart.
fn edge_energy(values: &DVector<f64>, apart: usize) -> f64 {
    let later = values.iter().skip(apart);
    values.iter().zip(later).map(|(a, b)| (b - a).powi(2)).sum()
}
