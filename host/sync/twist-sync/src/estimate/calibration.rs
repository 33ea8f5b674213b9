//! The linear relation of the two sensors, at a given relation of their clocks.

use nalgebra::{Matrix3, Matrix4, SMatrix, Vector3, Vector4};

/// Linear relation of the two sensors: `y = C·x + b`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Calibration {
    /// Rotation, scale and cross-axis errors.
    pub(crate) matrix: Matrix3<f64>,
    /// Bias, rad/s.
    pub(crate) bias: Vector3<f64>,
}

impl Calibration {
    /// Adds a step of the parameters: `C` and bias by rows.
    pub(crate) fn step(&mut self, by: &[f64]) {
        for (row, by) in by.as_chunks::<4>().0.iter().enumerate() {
            for column in 0..3 {
                self.matrix[(row, column)] += by[column];
            }
            self.bias[row] += by[3];
        }
    }

    /// Returns the residual of `y` at `x`.
    pub(crate) fn residual(&self, x: &Vector3<f64>, y: &Vector3<f64>) -> Vector3<f64> {
        y - self.matrix * x - self.bias
    }
}

/// The rates of both at each node: `x` and `y`.
pub(crate) type Rates = (Vector3<f64>, Vector3<f64>);

/// Returns the best orthogonal `C` and bias at a given relation of the clocks.
pub(crate) fn rotation(rates: impl Iterator<Item = Rates> + Clone) -> Calibration {
    let (mut n, mut mean_x, mut mean_y) = (0.0, Vector3::zeros(), Vector3::zeros());
    for (x, y) in rates.clone() {
        n += 1.0;
        mean_x += x;
        mean_y += y;
    }
    mean_x /= f64::max(n, 1.0);
    mean_y /= f64::max(n, 1.0);
    let mut m = Matrix3::zeros();
    for (x, y) in rates {
        m += (y - mean_y) * (x - mean_x).transpose();
    }
    let svd = m.svd(true, true);
    let matrix = match (svd.u, svd.v_t) {
        (Some(u), Some(v_t)) => {
            let mut fix = Matrix3::identity();
            // Without motion about three axes the sign of the last is not seen:
            // sensors are right-handed.
            let weak = svd.singular_values[2] < 0.01 * svd.singular_values[0];
            if weak && (u * v_t).determinant() < 0.0 {
                fix[(2, 2)] = -1.0;
            }
            u * fix * v_t
        }
        _ => Matrix3::identity(),
    };
    Calibration {
        matrix,
        bias: mean_y - matrix * mean_x,
    }
}

/// `Σ x xᵀ`-style regression of `y` on `x` with a prior: the best rotation.
///
/// Used for the calibration that is reported, at the final relation.
pub(crate) fn regress(
    rates: impl Iterator<Item = Rates> + Clone,
    noise_variance: f64,
) -> Calibration {
    regress_about(rotation(rates.clone()), rates, noise_variance)
}

/// Like [`regress`], with a given prior.
pub(crate) fn regress_about(
    prior: Calibration,
    rates: impl Iterator<Item = Rates>,
    noise_variance: f64,
) -> Calibration {
    let mut count = 0;
    let mut m = Matrix4::zeros();
    let mut right = SMatrix::<f64, 4, 3>::zeros();
    for (x, y) in rates {
        count += 1;
        let z = Vector4::new(x.x, x.y, x.z, 1.0);
        m += z * z.transpose();
        right += z * (y - prior.matrix * x - prior.bias).transpose();
    }
    let ridge = prior_strength(count, noise_variance, m.fixed_view::<3, 3>(0, 0).trace());
    for axis in 0..3 {
        m[(axis, axis)] += ridge;
    }
    match m.cholesky() {
        Some(c) => {
            let solution = c.solve(&right);
            Calibration {
                matrix: prior.matrix + solution.fixed_rows::<3>(0).transpose(),
                bias: prior.bias + solution.row(3).transpose(),
            }
        }
        None => prior,
    }
}

/// Strength of the prior of `C`; `motion` is the sum of the squares of `x`.
pub(crate) fn prior_strength(n: usize, noise_variance: f64, motion: f64) -> f64 {
    30.0 * n as f64 * noise_variance + 1e-10 * motion
}
