//! Orthonormal bases of row profiles, and projections on them.

use nalgebra::allocator::Allocator;
use nalgebra::{DMatrix, DVector, DefaultAllocator, Dim, Dyn, OMatrix};

/// Least share of a column that is independent of those before it; other columns are dropped.
const DEPENDENT: f64 = 1e-4;

/// Result of [`orthonormal`]: `q · r` are the columns with the indices `kept`.
pub(crate) struct Orthonormal {
    pub(crate) q: DMatrix<f64>,
    pub(crate) r: DMatrix<f64>,
    pub(crate) kept: Vec<usize>,
}

/// Orthonormalises columns one after the other. A column is left out if its part outside of the
/// kept columns before it is not longer than its entry in `least`.
pub(crate) fn orthonormal(columns: &DMatrix<f64>, least: &DVector<f64>) -> Orthonormal {
    let mut kept: Vec<usize> = (0..columns.ncols()).collect();
    loop {
        let qr = columns.select_columns(&kept).qr();
        let r = qr.r();
        let dependent = (0..kept.len()).find(|&k| {
            let least = kept.get(k).and_then(|&column| least.get(column));
            // Columns beyond the number of rows have no entry.
            let own = r.get((k, k));
            own.zip(least).is_none_or(|(own, least)| own <= least)
        });
        match dependent {
            Some(k) => kept.remove(k),
            None => return Orthonormal { q: qr.q(), r, kept },
        };
    }
}

/// An orthonormal basis.
#[derive(Debug, Clone)]
pub(crate) struct Basis {
    columns: DMatrix<f64>,
}

impl Basis {
    /// Spans the given columns; dependent ones are dropped.
    pub(crate) fn spanning(columns: &DMatrix<f64>) -> Self {
        let least = columns.column_iter().map(|c| DEPENDENT * c.norm());
        let least = DVector::from_iterator(columns.ncols(), least);
        Self {
            columns: orthonormal(columns, &least).q,
        }
    }

    /// Polynomials of degree 0 to `degree` over `n` rows.
    pub(crate) fn polynomials(n: usize, degree: usize) -> Self {
        Self::spanning(&polynomial_columns(n, degree))
    }

    pub(crate) const fn columns(&self) -> &DMatrix<f64> {
        &self.columns
    }

    /// Subtracts from each column of `y` its part inside the basis.
    pub(crate) fn remove_from<C: Dim>(&self, y: &mut OMatrix<f64, Dyn, C>)
    where
        DefaultAllocator: Allocator<Dyn, C>,
    {
        let inside = &self.columns * self.columns.tr_mul(y);
        *y -= inside;
    }

    /// Returns the part of a profile outside the basis.
    pub(crate) fn outside(&self, profile: &[f32]) -> DVector<f64> {
        let mut y = DVector::from_iterator(profile.len(), profile.iter().map(|&v| v.into()));
        self.remove_from(&mut y);
        y
    }

    /// Returns the coefficients of the part of `y` inside the basis.
    pub(crate) fn coefficients(&self, y: &DVector<f64>) -> DVector<f64> {
        self.columns.tr_mul(y)
    }

    /// Returns the curve with these coefficients.
    pub(crate) fn curve(&self, coefficients: &DVector<f64>) -> DVector<f64> {
        &self.columns * coefficients
    }

    /// Returns the basis for means of `factor` neighbouring rows.
    pub(crate) fn binned(&self, factor: usize) -> Self {
        let (rows, columns) = self.columns.shape();
        Self::spanning(&DMatrix::from_fn(rows / factor, columns, |row, column| {
            let together = self.columns.rows(row * factor, factor);
            together.column(column).mean()
        }))
    }
}

/// Concatenates the columns of both.
pub(crate) fn side_by_side(left: &DMatrix<f64>, right: &DMatrix<f64>) -> DMatrix<f64> {
    let columns = left.ncols() + right.ncols();
    let mut both = left.clone().resize_horizontally(columns, 0.0);
    both.columns_mut(left.ncols(), right.ncols())
        .copy_from(right);
    both
}

/// Powers of the place in `-1..=1`, degree 0 to `degree`.
pub(crate) fn polynomial_columns(n: usize, degree: usize) -> DMatrix<f64> {
    let x = unit_places(n);
    DMatrix::from_fn(n, degree + 1, |row, power| x[row].powi(power as i32))
}

/// Places of `n` rows in `-1..=1`.
pub(crate) fn unit_places(n: usize) -> DVector<f64> {
    let half = (0.5 * (n as f64 - 1.0)).max(0.5);
    DVector::from_fn(n, |i, _| (i as f64 - half) / half)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_are_orthonormal_and_remove_polynomials() {
        let basis = Basis::polynomials(300, 5);
        for (i, a) in basis.columns().column_iter().enumerate() {
            for (j, b) in basis.columns().column_iter().enumerate() {
                let expected = if i == j { 1.0 } else { 0.0 };
                assert!((a.dot(&b) - expected).abs() < 1e-12);
            }
        }
        let mut y = unit_places(300).map(|x| 3.0 - x + 0.4 * x.powi(5));
        let back = basis.curve(&basis.coefficients(&y));
        assert!(back.iter().zip(&y).all(|(a, b)| (a - b).abs() < 1e-12));
        basis.remove_from(&mut y);
        assert!(y.iter().all(|v| v.abs() < 1e-12));
    }

    #[test]
    fn dependent_columns_are_dropped() {
        let columns = DMatrix::from_columns(&[
            DVector::from_vec(vec![1.0, 2.0, 3.0]),
            DVector::from_vec(vec![2.0, 4.0, 6.0]),
            DVector::zeros(3),
            DVector::from_vec(vec![1.0, 0.0, 0.0]),
        ]);
        let found = orthonormal(&columns, &DVector::repeat(4, 1e-6));
        assert_eq!(found.kept, [0, 3]);
        let back = &found.q * &found.r;
        assert!((back - columns.select_columns(&[0, 3])).norm() < 1e-12);
        assert_eq!(Basis::spanning(&columns).columns().ncols(), 2);
        // More columns than rows, and no rows at all.
        let square = DMatrix::from_fn(2, 4, |i, j| (i + j) as f64);
        assert_eq!(Basis::spanning(&square).columns().ncols(), 2);
        let nothing = Basis::spanning(&DMatrix::zeros(0, 2));
        nothing.remove_from(&mut DVector::zeros(0));
    }
}
