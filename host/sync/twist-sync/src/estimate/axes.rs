//! Delays that differ by axis or by frequency.
//!
//! Some phones read their axes one after the other, or report one from an older sample, and a
//! low-pass of delay `D` delays motion of the angular frequency `ω` by `k·D³·ω²` more, where only
//! `D` is configured. With `S` the slopes of the prediction by axis of one stream and `s` their
//! sum, the residual is `S·η + u·s·ρ + s″·κ + noise`, with a shift `η` of each axis, a rate `ρ`
//! and the dispersion `κ`. That is solved once for either stream.
//!
//! Three hypotheses explain the shifts of the axes: all are the same; one axis is late; or
//! each is late. Such delays are normal, of a size that the shifts themselves decide. The
//! relation is averaged over all of them, each weighted by its restricted likelihood, so that an
//! undecided axis is part of the sigma.
//!
//! Limits: if two axes are late by the same, the third is reported as early. With motion about
//! one axis alone it is often unknown which stream's axis is late. A delay that all axes have in
//! common is part of the offset.

use nalgebra::{Matrix2, Matrix3, Matrix4, SMatrix, SVector, Vector2, Vector3, Vector4};

use super::calibration::prior_strength;
use super::fit::{Fit, FitOptions, Node, at_least};
use crate::clock::WithSigma;
use crate::mixture::{Supposed, mixed};

/// Prior probability that a given axis is late.
const LATE: f64 = 0.01;
/// 1-sigma of its lateness, seconds; all are equally likely.
const LATE_S: [f64; 5] = [30e-6, 100e-6, 300e-6, 1e-3, 3e-3];
/// Prior probability that each axis of a given stream has a delay of its own.
const EACH: f64 = 0.03;
/// 1-sigma of those delays, seconds; all are equally likely.
const EACH_S: [f64; 5] = [10e-6, 30e-6, 100e-6, 300e-6, 1e-3];
/// 1-sigma of an axis' shift where the motion shows nothing of it, seconds.
const LARGEST_S: f64 = 2e-3;
/// Largest variance of the shift that two axes have in common, in those of the third's lateness:
/// two axes that show less say nothing about the third, whose time is the gyroscope's.
const SHOWN: f64 = 0.1;
/// Largest logarithm of a likelihood against that of equal axes: beyond it they are not.
const MOST_LN: f64 = 500.0;
/// Length of the blocks over which the residual's scores are summed, seconds.
const BLOCK_S: f64 = 0.25;

/// `k` of a low-pass of second order, from 1/6 for Butterworth's to −1/12 for two equal poles:
/// mean and 1-sigma of an even spread. The series of the phase `atan(2ζx / (1 − x²))`, with
/// `x = ω/ω₀` and `D = 2ζ/ω₀`, gives `k = (2ζ − 8ζ³/3) / 8ζ³`.
const DISPERSION: (f64, f64) = (1.0 / 24.0, 0.25 / 3.464_101_6);

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

/// Columns of the residual's derivatives at a node.
type Row<const N: usize> = SMatrix<f64, 3, N>;

/// Variance of the dispersion without a filter, s⁶: that of a delay of 0.1 ms.
const NONE_S3: f64 = 1e-26;

/// Dispersion known beforehand, s³: mean and variance.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Dispersion {
    mean: f64,
    variance: f64,
}

/// Dispersion of a low-pass with this delay in seconds. If the other stream has been through a
/// filter of a `shape`, only the difference from that is left.
pub(crate) fn dispersion(delay_s: f64, shape: Option<f64>) -> Dispersion {
    let (mean, sigma) = DISPERSION;
    let same = shape.map_or(0.0, |shape| shape - 1.0 / 3.0);
    let cube = delay_s.abs().powi(3);
    Dispersion {
        mean: (mean - same) * cube,
        variance: (sigma * cube).powi(2),
    }
}

impl Dispersion {
    /// Returns the dispersion of the data against the model.
    pub(crate) fn less(self, model: Self) -> Self {
        Self {
            mean: self.mean - model.mean,
            variance: (self.variance + model.variance).max(NONE_S3),
        }
    }

    fn is_none(self) -> bool {
        self.variance <= NONE_S3
    }
}

/// Second derivative of the prediction's slope at each node; zero beside a gap.
fn curvatures(nodes: &[Node]) -> Vec<Vector3<f64>> {
    let mut out = vec![Vector3::zeros(); nodes.len()];
    let steps = nodes.windows(2).map(|p| p[1].t - p[0].t);
    let step = steps.fold(f64::INFINITY, f64::min);
    for (k, near) in nodes.windows(3).enumerate() {
        if near[2].t - near[0].t < 2.5 * step {
            let bent = near[0].slope - near[1].slope * 2.0 + near[2].slope;
            out[k + 1] = bent / (step * step);
        }
    }
    out
}

/// Takes from the columns what the relation of the sensors explains of them: the fit has taken
/// it from the residual.
fn without_calibration<const N: usize>(
    fit: &Fit,
    rows: &mut [Row<N>],
    noise_variance: f64,
) -> Option<()> {
    let z = |node: &Node| Vector4::new(node.x.x, node.x.y, node.x.z, 1.0);
    let mut normal = Matrix4::zeros();
    let mut products = [SMatrix::<f64, 4, N>::zeros(); 3];
    for (row, node) in rows.iter().zip(&fit.nodes) {
        let weighed = z(node) * node.weight;
        normal += weighed * z(node).transpose();
        for (axis, products) in products.iter_mut().enumerate() {
            *products += weighed * row.row(axis);
        }
    }
    let motion = normal.fixed_view::<3, 3>(0, 0).trace();
    let ridge = prior_strength(fit.nodes.len(), noise_variance, motion);
    (0..3).for_each(|axis| normal[(axis, axis)] += ridge);
    let cholesky = normal.cholesky()?;
    let explained = products.map(|products| cholesky.solve(&products));
    for (row, node) in rows.iter_mut().zip(&fit.nodes) {
        for (axis, explained) in explained.iter().enumerate() {
            let own = row.row(axis) - z(node).transpose() * explained;
            row.set_row(axis, &own);
        }
    }
    Some(())
}

/// Least squares of the residual on these columns, with what is known beforehand as mean and
/// precision of each parameter; returns the parameters and their covariance from the scatter of
/// blocks.
fn regressed<const N: usize>(
    fit: &Fit,
    mut rows: Vec<Row<N>>,
    options: &FitOptions,
    (mean, precision): (SVector<f64, N>, SVector<f64, N>),
) -> Option<(SVector<f64, N>, SMatrix<f64, N, N>)> {
    without_calibration(fit, &mut rows, options.noise_variance)?;
    let oversampling = options.oversampling;
    let known = precision * oversampling;
    let mut normal = SMatrix::<f64, N, N>::from_diagonal(&known);
    let mut right = known.component_mul(&mean);
    for (row, node) in rows.iter().zip(&fit.nodes) {
        let weighed = fit.weights * row * node.weight;
        normal += row.tr_mul(&weighed);
        right += weighed.tr_mul(&node.residual);
    }
    let inverse = normal.cholesky()?.inverse();
    let found = inverse * right;
    let mut scatter = SMatrix::<f64, N, N>::from_diagonal(&(known * oversampling));
    let mut block = (f64::NEG_INFINITY, SVector::<f64, N>::zeros());
    for (row, node) in rows.iter().zip(&fit.nodes) {
        if node.t > block.0 + BLOCK_S {
            scatter += block.1 * block.1.transpose();
            block = (node.t, SVector::zeros());
        }
        let left = node.residual - row * found;
        block.1 += row.tr_mul(&(fit.weights * left * node.weight));
    }
    scatter += block.1 * block.1.transpose();
    let ideal = inverse * oversampling;
    let covariance = inverse * scatter * inverse;
    // Few blocks scatter: white noise is the least.
    let ratios = (0..N).map(|k| ideal[(k, k)] / covariance[(k, k)]);
    Some((found, covariance * ratios.fold(1.0, f64::max)))
}

/// Shifts of a stream's axes and a rate, against the result of the fit.
struct Shifts {
    of_data: bool,
    found: SVector<f64, 4>,
    covariance: SMatrix<f64, 4, 4>,
}

/// Columns of the regression on the axes' shifts, after these: rate and dispersion.
const RATE: usize = 3;
const CURVED: usize = 4;

impl Shifts {
    fn new(
        fit: &Fit,
        of_data: bool,
        options: &FitOptions,
        curved: &[Vector3<f64>],
        known: Dispersion,
    ) -> Option<Self> {
        let turned = fit.calibration.matrix.try_inverse()?;
        let row = |(node, curved): (&Node, &Vector3<f64>)| {
            let by_axis = if of_data {
                Matrix3::from_diagonal(&node.slope)
            } else {
                fit.calibration.matrix * Matrix3::from_diagonal(&(turned * node.slope))
            };
            let mut row = Row::<5>::zeros();
            row.fixed_columns_mut::<3>(0).copy_from(&by_axis);
            row.set_column(RATE, &(node.slope * (node.t - fit.link.at_data)));
            row.set_column(CURVED, curved);
            row
        };
        let rows: Vec<Row<5>> = fit.nodes.iter().zip(curved).map(row).collect();
        let (mut mean, mut precision) = (SVector::<f64, 5>::zeros(), SVector::<f64, 5>::zeros());
        precision
            .fixed_rows_mut::<3>(0)
            .fill(1.0 / (LARGEST_S * LARGEST_S));
        (mean[CURVED], precision[CURVED]) = (known.mean, 1.0 / known.variance);
        let (found, covariance) = regressed(fit, rows, options, (mean, precision))?;
        Some(Self {
            of_data,
            found: found.fixed_rows::<4>(0).into_owned(),
            covariance: covariance.fixed_view::<4, 4>(0, 0).into_owned(),
        })
    }

    /// Shift and rate if the axes have own delays of this covariance, s².
    fn supposed(&self, own: Matrix3<f64>, prior: f64) -> Option<Supposed<2>> {
        let mut spread = self.covariance;
        let mut axes = spread.fixed_view_mut::<3, 3>(0, 0);
        axes += own;
        let cholesky = spread.cholesky()?;
        let volume_ln = cholesky.l_dirty().diagonal().map(f64::ln).sum();
        let mut common = SMatrix::<f64, 4, 2>::zeros();
        common.fixed_view_mut::<3, 1>(0, 0).fill(1.0);
        common[(RATE, 1)] = 1.0;
        let weighed = cholesky.solve(&common);
        let normal: Matrix2<f64> = common.tr_mul(&weighed);
        let inverse = normal.try_inverse()?;
        let mean: Vector2<f64> = inverse * weighed.tr_mul(&self.found);
        let left = self.found - common * mean;
        let square = left.dot(&cholesky.solve(&left));
        Some(Supposed {
            prior,
            likelihood_ln: -volume_ln - 0.5 * (normal.determinant().ln() + square),
            mean,
            covariance: inverse,
        })
    }

    /// Lateness of an axis against the other two, whose common shift has this mean and variance.
    fn late(&self, axis: usize, others: &Supposed<2>) -> LateAxis {
        // What the data's axis shows later, it was stamped too late.
        let sign = if self.of_data { -1.0 } else { 1.0 };
        let variance = others.covariance[(0, 0)];
        LateAxis {
            of_data: self.of_data,
            axis,
            by: WithSigma {
                value: sign * (self.found[axis] - others.mean[0]),
                sigma: (self.covariance[(axis, axis)] + variance).sqrt(),
            },
            probability: 0.0,
            variance,
        }
    }
}

/// The relation over all hypotheses.
pub(crate) struct Found {
    /// Shift and rate against the fit.
    pub(crate) shift: Vector2<f64>,
    /// Their covariance.
    pub(crate) covariance: Matrix2<f64>,
    /// The most probable late axis, if it is more probable than none.
    pub(crate) axis: Option<LateAxis>,
}

/// Shift and rate against the fit with the filters' dispersion, and their covariance.
fn dispersed(
    fit: &Fit,
    options: &FitOptions,
    curved: &[Vector3<f64>],
    known: Dispersion,
) -> Option<(Vector2<f64>, Matrix2<f64>)> {
    let row = |(node, curved): (&Node, &Vector3<f64>)| {
        let turned = node.slope * (node.t - fit.link.at_data);
        Row::<3>::from_columns(&[node.slope, turned, *curved])
    };
    let rows: Vec<Row<3>> = fit.nodes.iter().zip(curved).map(row).collect();
    let mean = Vector3::new(0.0, 0.0, known.mean);
    let precision = Vector3::new(0.0, 0.0, 1.0 / known.variance);
    let (found, covariance) = regressed(fit, rows, options, (mean, precision))?;
    let covariance = covariance.fixed_view::<2, 2>(0, 0).into_owned();
    Some((found.xy(), at_least(covariance, &fit.covariance)))
}

/// Averages the fit's relation over the hypotheses.
pub(crate) fn found(fit: &Fit, options: &FitOptions, known: Dispersion) -> Option<Found> {
    let curved = curvatures(&fit.nodes);
    let (shift, least) = if known.is_none() {
        (Vector2::zeros(), fit.covariance)
    } else {
        dispersed(fit, options, &curved, known)?
    };
    let same = Supposed {
        prior: 1.0 - 6.0 * LATE - 2.0 * EACH,
        likelihood_ln: 0.0,
        mean: shift,
        covariance: least,
    };
    let (mut supposed, mut axes) = (vec![same], Vec::new());
    let both = [true, false].map(|of_data| Shifts::new(fit, of_data, options, &curved, known));
    for shifts in both.iter().flatten() {
        let same = shifts.supposed(Matrix3::zeros(), 1.0)?;
        let against_same = |other: &Supposed<2>| Supposed {
            likelihood_ln: (other.likelihood_ln - same.likelihood_ln).min(MOST_LN),
            covariance: at_least(other.covariance, &least),
            ..*other
        };
        for axis in 0..3 {
            let first = supposed.len();
            for size_s in LATE_S {
                let mut own = Matrix3::zeros();
                own[(axis, axis)] = size_s * size_s;
                let late = shifts.supposed(own, LATE / LATE_S.len() as f64)?;
                if late.covariance[(0, 0)] < SHOWN * size_s * size_s {
                    supposed.push(against_same(&late));
                }
            }
            // Of the largest size, the others' common shift is their own.
            let mut own = Matrix3::zeros();
            own[(axis, axis)] = LATE_S[LATE_S.len() - 1].powi(2);
            let others = shifts.supposed(own, 1.0)?;
            axes.push((shifts.late(axis, &others), first..supposed.len()));
        }
        // The time of a gyroscope is the mean of its axes'.
        let about_mean = Matrix3::identity() - Matrix3::repeat(1.0 / 3.0);
        for size_s in EACH_S {
            let own = about_mean * (size_s * size_s);
            let each = shifts.supposed(own, EACH / EACH_S.len() as f64)?;
            supposed.push(against_same(&each));
        }
    }
    let (mean, covariance) = mixed(&supposed);
    if !(mean[0].is_finite() && covariance[(0, 0)].is_finite()) {
        return None;
    }
    let weight = |own: &Supposed<2>| own.prior * (own.likelihood_ln - MOST_LN).exp();
    let sum: f64 = supposed.iter().map(weight).sum();
    let late = axes.into_iter().map(|(axis, sizes)| LateAxis {
        probability: supposed[sizes].iter().map(weight).sum::<f64>() / sum,
        ..axis
    });
    let most = late.max_by(|x, y| x.probability.total_cmp(&y.probability));
    Some(Found {
        shift: mean,
        covariance,
        axis: most.filter(|most| most.probability > weight(&supposed[0]) / sum),
    })
}
