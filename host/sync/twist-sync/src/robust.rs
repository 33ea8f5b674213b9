//! Small robust statistics, and the straight line through points.

/// Returns the median (of an even number of values the mean of the middle two), or `None`
/// without values.
#[must_use]
pub fn median(values: &[f64]) -> Option<f64> {
    median_in_place(&mut values.to_vec())
}

/// Returns the [`median`] without a copy; the order of the values is lost.
#[must_use]
pub fn median_in_place(values: &mut [f64]) -> Option<f64> {
    let n = values.len();
    if n == 0 {
        return None;
    }
    let middle = n / 2;
    let (below, &mut upper, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    Some(if n % 2 == 1 {
        upper
    } else {
        let lower = below.iter().copied().fold(f64::NEG_INFINITY, higher);
        0.5 * (lower + upper)
    })
}

/// Values on each side that contribute to the local median.
const AROUND: usize = 4;

/// Subtracts from each value the median of itself and four neighbours on either side.
pub(crate) fn without_local_median(values: &[f64]) -> Vec<f64> {
    // Sorted threes, each of which is in three windows.
    let threes: Vec<[f64; 3]> = values
        .windows(3)
        .map(|v| sorted(v[0], v[1], v[2]))
        .collect();
    let local = |k: usize| {
        let (from, to) = (k.saturating_sub(AROUND), (k + AROUND + 1).min(values.len()));
        if to - from == 2 * AROUND + 1 {
            median_of_nine(&threes[from], &threes[from + 3], &threes[from + 6])
        } else {
            median(&values[from..to]).unwrap_or(0.0)
        }
    };
    values
        .iter()
        .enumerate()
        .map(|(k, v)| v - local(k))
        .collect()
}

/// Median of three sorted threes: that of the highest low, the middle middle and the
/// lowest high.
fn median_of_nine(a: &[f64; 3], b: &[f64; 3], c: &[f64; 3]) -> f64 {
    let low = higher(higher(a[0], b[0]), c[0]);
    let middle = sorted(a[1], b[1], c[1])[1];
    let high = lower(lower(a[2], b[2]), c[2]);
    sorted(low, middle, high)[1]
}

fn sorted(a: f64, b: f64, c: f64) -> [f64; 3] {
    let (low, high) = (lower(a, b), higher(a, b));
    [lower(low, c), higher(low, lower(high, c)), higher(high, c)]
}

/// Minimum in one instruction, where `f64::min` needs several to treat NaN.
fn lower(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

pub(crate) fn higher(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// Estimates the standard deviation from the median absolute deviation, scaled for a normal
/// distribution; `None` without values.
#[must_use]
pub fn mad_sigma(mut values: Vec<f64>) -> Option<f64> {
    let centre = median_in_place(&mut values)?;
    mad_sigma_about_zero(values.into_iter().map(|value| value - centre))
}

/// Like [`mad_sigma`], for values whose centre is known to be zero.
pub(crate) fn mad_sigma_about_zero(values: impl Iterator<Item = f64>) -> Option<f64> {
    // The bits of non-negative numbers are in the same order and compare faster.
    let mut bits: Vec<u64> = values.map(|v| v.abs().to_bits()).collect();
    let middle = bits.len() / 2;
    let median = (!bits.is_empty()).then(|| *bits.select_nth_unstable(middle).1)?;
    Some(1.482_602_218_505_602 * f64::from_bits(median))
}

/// A straight line fitted by least squares.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// Mean of the points' `x`.
    pub centre: f64,
    /// Value of the line at the centre: the mean of the points' `y`.
    pub mean: f64,
    /// Slope; 0 if all `x` are equal.
    pub slope: f64,
    /// Sum of the squares of `x − centre`.
    pub squares: f64,
}

impl Line {
    /// Fits a line through points (x, y), about their means, so that large times cost no
    /// precision.
    #[must_use]
    pub fn through(points: &[(f64, f64)]) -> Self {
        let n = points.len().max(1) as f64;
        let centre = points.iter().map(|p| p.0).sum::<f64>() / n;
        let mean = points.iter().map(|p| p.1).sum::<f64>() / n;
        let (mut squares, mut products) = (0.0, 0.0);
        for (x, y) in points {
            squares += (x - centre) * (x - centre);
            products += (x - centre) * (y - mean);
        }
        Self {
            centre,
            mean,
            slope: if squares > 0.0 {
                products / squares
            } else {
                0.0
            },
            squares,
        }
    }

    /// Returns the value of the line at `x`.
    #[must_use]
    pub fn at(&self, x: f64) -> f64 {
        self.mean + self.slope * (x - self.centre)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_and_lines() {
        assert_eq!(median(&[3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(&[4.0, 1.0, 3.0, 2.0]), Some(2.5));
        assert_eq!(median(&[]), None);
        for seed in 0..200 {
            let nine: [f64; 9] =
                std::array::from_fn(|k| f64::from((seed * 9 + k as i32) * 7919 % 13));
            let local = nine[4] - without_local_median(&nine)[4];
            assert_eq!(Some(local), median(&nine));
        }
        let sigma = mad_sigma(vec![0.0, 1.0, 2.0, 3.0, 100.0]).unwrap();
        assert!((sigma - 1.4826).abs() < 1e-3);
        let line = Line::through(&[(0.0, 1.0), (1.0, 3.0), (2.0, 5.0)]);
        assert_eq!((line.mean, line.slope, line.centre), (3.0, 2.0, 1.0));
        assert_eq!((line.squares, line.at(4.0)), (2.0, 9.0));
    }
}
