//! Orthonormal bases of row profiles, and what lies outside of them.

/// Columns whose remainder is smaller than this share of them add nothing new.
const DEPENDENT: f64 = 1e-4;

/// Scalar product.
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// `y += factor · x`.
pub fn add_scaled(y: &mut [f64], factor: f64, x: &[f64]) {
    for (y, x) in y.iter_mut().zip(x) {
        *y += factor * x;
    }
}

/// An orthonormal basis.
#[derive(Debug, Clone, Default)]
pub struct Basis {
    columns: Vec<Vec<f64>>,
}

impl Basis {
    /// Spans the given columns (modified Gram-Schmidt, twice); dependent ones are
    /// dropped.
    pub fn spanning(raw: impl IntoIterator<Item = Vec<f64>>) -> Self {
        let mut basis = Self::default();
        for mut column in raw {
            let before = dot(&column, &column).sqrt();
            basis.remove_from(&mut column);
            basis.remove_from(&mut column);
            let after = dot(&column, &column).sqrt();
            if after > DEPENDENT * before && after > 0.0 {
                column.iter_mut().for_each(|v| *v /= after);
                basis.columns.push(column);
            }
        }
        basis
    }

    /// Legendre-like polynomials of degree 0 to `degree` over `n` rows.
    pub fn polynomials(n: usize, degree: usize) -> Self {
        Self::spanning(polynomial_columns(n, degree))
    }

    /// The columns.
    pub fn columns(&self) -> &[Vec<f64>] {
        &self.columns
    }

    /// Takes the part inside the basis away from `y`.
    pub fn remove_from(&self, y: &mut [f64]) {
        for q in &self.columns {
            let c = dot(q, y);
            add_scaled(y, -c, q);
        }
    }

    /// Coefficients of the part of `y` inside the basis.
    pub fn coefficients(&self, y: &[f64]) -> Vec<f64> {
        self.columns.iter().map(|q| dot(q, y)).collect()
    }

    /// The curve with these coefficients.
    pub fn curve(&self, coefficients: &[f64]) -> Vec<f64> {
        let n = self.columns.first().map_or(0, Vec::len);
        let mut sum = vec![0.0; n];
        for (q, c) in self.columns.iter().zip(coefficients) {
            add_scaled(&mut sum, *c, q);
        }
        sum
    }
}

/// Powers of the place in `-1..=1`, degree 0 to `degree`.
pub fn polynomial_columns(n: usize, degree: usize) -> Vec<Vec<f64>> {
    let x = unit_places(n);
    (0..=degree)
        .map(|d| x.iter().map(|x| x.powi(d as i32)).collect())
        .collect()
}

/// Places of `n` rows in `-1..=1`.
pub fn unit_places(n: usize) -> Vec<f64> {
    let half = (0.5 * (n as f64 - 1.0)).max(0.5);
    (0..n).map(|i| (i as f64 - half) / half).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_are_orthonormal_and_remove_polynomials() {
        let basis = Basis::polynomials(300, 5);
        for (i, a) in basis.columns().iter().enumerate() {
            for (j, b) in basis.columns().iter().enumerate() {
                let expected = if i == j { 1.0 } else { 0.0 };
                assert!((dot(a, b) - expected).abs() < 1e-12);
            }
        }
        let mut y: Vec<f64> = unit_places(300)
            .iter()
            .map(|x| 3.0 - x + 0.4 * x.powi(5))
            .collect();
        let back = basis.curve(&basis.coefficients(&y));
        assert!(back.iter().zip(&y).all(|(a, b)| (a - b).abs() < 1e-12));
        basis.remove_from(&mut y);
        assert!(y.iter().all(|v| v.abs() < 1e-12));
    }

    #[test]
    fn dependent_columns_are_dropped() {
        let a = vec![1.0, 2.0, 3.0];
        let b = vec![2.0, 4.0, 6.0];
        assert_eq!(Basis::spanning([a, b, vec![0.0; 3]]).columns().len(), 1);
    }
}
