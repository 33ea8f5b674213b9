//! One axis of a gyroscope that comes late against its other two.
//!
//! Some phones read their axes one after the other, or report one from an older sample. The
//! offset would be a mean of the axes' delays, weighted by the motion about each. So each
//! axis of one stream gets a shift of its own: with `S` the slopes of the prediction by axis of
//! that stream, the residual is `S·η + u·s·ρ + noise`. Hypotheses are that all shifts are the
//! same, and, of each axis of either stream, that it is late: then the relation is that of the
//! other two. All are averaged by their probability, so that an undecided axis is part of the
//! sigma.
//!
//! Limits: if two axes are late by the same, the third is reported as early. With motion about
//! one axis alone it is often unknown which stream's axis is late.

use nalgebra::{Matrix3, Matrix4, SMatrix, Vector1, Vector2, Vector4};

use super::fit::{Fit, Node};
use crate::clock::WithSigma;
use crate::mixture::{Supposed, mixed};

/// Probability beforehand that a given axis is late.
const LATE: f64 = 0.01;
/// Range of its lateness over which that probability is spread, seconds.
const RANGE_S: f64 = 1e-3;
/// Largest logarithm of a likelihood: beyond it the axis is certain.
const MOST_LN: f64 = 500.0;
/// 1-sigma of the prior of an axis' shift, seconds.
const LATEST_S: f64 = 1e-3;
/// Length of the blocks over which the residual's scores are summed, seconds.
const BLOCK_S: f64 = 0.25;

/// An axis against the other two of its gyroscope.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LateAxis {
    /// True of the data's axis, false of the model's.
    pub(crate) of_data: bool,
    /// 0 to 2.
    pub(crate) axis: usize,
    /// Its lateness, seconds.
    pub(crate) by: WithSigma,
    /// Probability of it.
    pub(crate) probability: f64,
    /// Variance of the shift that the other two have in common, s².
    pub(crate) variance: f64,
}

type Row = SMatrix<f64, 3, 4>;

/// Shifts of the three axes of a stream, and a rate, against the result of the fit.
struct Shifts {
    of_data: bool,
    found: Vector4<f64>,
    covariance: Matrix4<f64>,
    /// Chi-square, of two degrees of freedom, of all shifts being the same.
    chi_square: f64,
}

impl Shifts {
    fn row(fit: &Fit, node: &Node, of_data: bool, inverse: &Matrix3<f64>) -> Row {
        let by_axis = if of_data {
            Matrix3::from_diagonal(&node.slope)
        } else {
            fit.calibration.matrix * Matrix3::from_diagonal(&(inverse * node.slope))
        };
        let mut row = Row::zeros();
        row.fixed_columns_mut::<3>(0).copy_from(&by_axis);
        let u = node.t - fit.link.at_data;
        row.set_column(3, &(node.slope * u));
        row
    }

    fn new(fit: &Fit, of_data: bool, oversampling: f64) -> Option<Self> {
        let turned = fit.calibration.matrix.try_inverse()?;
        let mut normal = Matrix4::zeros();
        let mut right = Vector4::zeros();
        let rows = fit.nodes.iter();
        let rows: Vec<Row> = rows.map(|n| Self::row(fit, n, of_data, &turned)).collect();
        for (row, node) in rows.iter().zip(&fit.nodes) {
            let weighed = fit.weights * row * node.weight;
            normal += row.tr_mul(&weighed);
            right += weighed.tr_mul(&node.residual);
        }
        for axis in 0..3 {
            normal[(axis, axis)] += oversampling / (LATEST_S * LATEST_S);
        }
        let inverse = normal.cholesky()?.inverse();
        let found = inverse * right;
        let mut scatter = Matrix4::zeros();
        let mut block = (f64::NEG_INFINITY, Vector4::zeros());
        for (row, node) in rows.iter().zip(&fit.nodes) {
            if node.t > block.0 + BLOCK_S {
                scatter += block.1 * block.1.transpose();
                block = (node.t, Vector4::zeros());
            }
            let left = node.residual - row * found;
            block.1 += row.tr_mul(&(fit.weights * left * node.weight));
        }
        scatter += block.1 * block.1.transpose();
        let ideal = inverse * oversampling;
        let mut covariance = inverse * scatter * inverse;
        // Few blocks scatter: white noise is the least.
        let ratios = (0..4).map(|k| ideal[(k, k)] / covariance[(k, k)]);
        covariance *= ratios.fold(1.0, f64::max);
        let difference = |i: usize, j: usize| Vector4::ith(i, 1.0) - Vector4::ith(j, 1.0);
        let contrasts = SMatrix::<f64, 4, 2>::from_columns(&[difference(0, 1), difference(1, 2)]);
        let apart: Vector2<f64> = contrasts.tr_mul(&found);
        let spread = contrasts.tr_mul(&(covariance * contrasts)).try_inverse()?;
        Some(Self {
            of_data,
            chi_square: apart.dot(&(spread * apart)),
            found,
            covariance,
        })
    }

    fn difference(&self, i: usize, j: usize) -> WithSigma {
        let c = &self.covariance;
        let variance = c[(i, i)] + c[(j, j)] - 2.0 * c[(i, j)];
        WithSigma {
            value: self.found[i] - self.found[j],
            sigma: variance.max(f64::MIN_POSITIVE).sqrt(),
        }
    }

    /// Shift that two axes have in common, and its variance.
    fn common(&self, i: usize, j: usize) -> (f64, f64) {
        let c = &self.covariance;
        let of_i = (c[(j, j)] - c[(i, j)]) / self.difference(i, j).sigma.powi(2);
        let of_i = of_i.clamp(0.0, 1.0);
        let of_j = 1.0 - of_i;
        let shift = of_i * self.found[i] + of_j * self.found[j];
        let variance =
            of_i * of_i * c[(i, i)] + of_j * of_j * c[(j, j)] + 2.0 * of_i * of_j * c[(i, j)];
        (shift, variance)
    }

    /// Logarithm of the likelihood that this axis is late, against that all are the same.
    fn late_ln(&self, axis: usize) -> f64 {
        let (i, j) = others(axis);
        let agree = self.difference(i, j);
        let apart = self
            .difference(axis, i)
            .sigma
            .hypot(self.difference(axis, j).sigma);
        0.5 * (self.chi_square - (agree.value / agree.sigma).powi(2))
            - 0.5 * (RANGE_S / apart).powi(2).ln_1p()
    }
}

fn others(axis: usize) -> (usize, usize) {
    ((axis + 1) % 3, (axis + 2) % 3)
}

/// The relation over all hypotheses.
pub(crate) struct Found {
    /// Shift against the fit, seconds.
    pub(crate) shift_s: f64,
    /// Its variance, s².
    pub(crate) variance: f64,
    /// The most probable late axis, if it is more probable than none.
    pub(crate) axis: Option<LateAxis>,
}

/// Averages the fit's relation over the hypotheses.
pub(crate) fn found(fit: &Fit, oversampling: f64) -> Option<Found> {
    let both = [true, false].map(|of_data| Shifts::new(fit, of_data, oversampling));
    let all_same = Supposed {
        prior: 1.0 - 6.0 * LATE,
        likelihood_ln: 0.0,
        mean: Vector1::zeros(),
        covariance: Vector1::new(fit.covariance[(0, 0)]),
    };
    let mut supposed = vec![all_same];
    let mut axes = Vec::new();
    for shifts in both.iter().flatten() {
        for axis in 0..3 {
            let (i, j) = others(axis);
            let (shift, variance) = shifts.common(i, j);
            supposed.push(Supposed {
                prior: LATE,
                likelihood_ln: shifts.late_ln(axis).min(MOST_LN),
                mean: Vector1::new(shift),
                covariance: Vector1::new(variance.max(fit.covariance[(0, 0)])),
            });
            let c = &shifts.covariance;
            // What the data's axis shows later, it was stamped too late.
            let sign = if shifts.of_data { -1.0 } else { 1.0 };
            axes.push(LateAxis {
                of_data: shifts.of_data,
                axis,
                by: WithSigma {
                    value: sign * (shifts.found[axis] - shift),
                    sigma: (c[(axis, axis)] + variance).sqrt(),
                },
                probability: 0.0,
                variance,
            });
        }
    }
    let (mean, covariance) = mixed(&supposed);
    if !(mean[0].is_finite() && covariance[0].is_finite()) {
        return None;
    }
    let weight = |own: &Supposed<1>| own.prior.ln() + own.likelihood_ln;
    let none = weight(&supposed[0]);
    let sum: f64 = supposed.iter().map(|own| (weight(own) - none).exp()).sum();
    let probability = |own: &Supposed<1>| (weight(own) - none).exp() / sum;
    let late = supposed[1..].iter().zip(axes);
    let late = late.map(|(own, axis)| LateAxis {
        probability: probability(own),
        ..axis
    });
    let most = late.max_by(|x, y| x.probability.total_cmp(&y.probability));
    Some(Found {
        shift_s: mean[0],
        variance: covariance[0],
        axis: most.filter(|most| most.probability > 1.0 / sum),
    })
}
