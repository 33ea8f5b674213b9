//! Statistics: quantiles, deviations, regression, evenly chosen indices, and the uncertainty of
//! sums whose errors are correlated.
//!
//! The latter is the estimator of Newey and West with Bartlett weights, for one variable over
//! row or frame numbers. `twist-sync` has one with a Parzen kernel for pairs of variables on a
//! time grid with gaps. They stay apart: published results are by these weights, and each is
//! adapted to its input (this one scales for the few terms of a frame that matter).

use twist_sync::robust;

/// Factor from one standard deviation to the 99 % interval of a normal distribution.
pub(crate) const COVERAGE_99: f64 = 2.576;

/// Returns the quantile `q` (0 to 1) of the finite values by linear interpolation between order
/// statistics (type 7 of Hyndman and Fan), or `None` without values.
pub fn quantile(values: &[f64], q: f64) -> Option<f64> {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let last = sorted.len().checked_sub(1)?;
    let at = q.clamp(0.0, 1.0) * last as f64;
    let below = *sorted.get(at.floor() as usize)?;
    let above = *sorted.get(at.ceil() as usize)?;
    Some(below + (at - at.floor()) * (above - below))
}

/// Returns the median of the finite values; zero without values.
pub(crate) fn median(values: &[f64]) -> f64 {
    quantile(values, 0.5).unwrap_or(0.0)
}

/// Returns the mean; zero without values.
pub fn mean(values: &[f64]) -> f64 {
    if values.is_empty() {
        0.0
    } else {
        values.iter().sum::<f64>() / values.len() as f64
    }
}

/// Returns the standard deviation of a sample (with `n - 1`), or `None` for fewer than two
/// values.
pub fn standard_deviation(values: &[f64]) -> Option<f64> {
    let n = values.len();
    if n < 2 {
        return None;
    }
    let m = mean(values);
    let sum: f64 = values.iter().map(|v| (v - m).powi(2)).sum();
    Some((sum / (n - 1) as f64).sqrt())
}

/// Returns the variance of the sum of `terms`, whose errors are correlated over up to `lag`
/// neighbours: the larger of the uncorrelated estimate `Σ e²` and the estimate of
/// Newey and West (1987) with Bartlett weights.
///
/// `terms` come from residuals of a least-squares fit, which are smaller than the
/// errors and sum to zero; the correlated part is scaled up for the number of
/// terms that matter.
pub(crate) fn variance_of_sum(terms: &[f64], lag: usize) -> f64 {
    let white: f64 = terms.iter().map(|e| e * e).sum();
    if white <= 0.0 {
        return 0.0;
    }
    let fourth: f64 = terms.iter().map(|e| e.powi(4)).sum();
    // As many equal terms would have the same ratio of moments; normal errors of
    // equal size show a third of their number.
    let effective = (3.0 * white * white / fourth).min(terms.len() as f64);
    let shrunk = 1.0 - (lag as f64 + 1.0) / effective;
    let correlated = (white + neighbours(terms, lag)) / shrunk.max(0.33);
    correlated.max(white)
}

/// Returns the factor, at least 1, by which the correlation between neighbours raises the
/// variance of a sum of `residuals` over that of independent ones.
pub(crate) fn correlation_inflation(residuals: &[f64], lag: usize) -> f64 {
    let zero: f64 = residuals.iter().map(|e| e * e).sum();
    if zero <= 0.0 {
        return 1.0;
    }
    (1.0 + neighbours(residuals, lag) / zero).max(1.0)
}

/// Variance that the correlation of each term with up to `lag` following ones adds to
/// their sum, with Bartlett's weights.
fn neighbours(terms: &[f64], lag: usize) -> f64 {
    // All lags in one pass, so that the sums do not depend on one another.
    let mut products = vec![0.0; lag.min(terms.len())];
    let mut later = terms;
    while let Some((first, rest)) = later.split_first() {
        for (product, term) in products.iter_mut().zip(rest) {
            *product += first * term;
        }
        later = rest;
    }
    let weight = |l: usize| 2.0 * (1.0 - l as f64 / (lag as f64 + 1.0));
    let weighted = products.iter().enumerate();
    weighted.map(|(i, product)| weight(i + 1) * product).sum()
}

/// Returns at most `count` indices at even distances over `0..len`.
pub(crate) fn evenly_spaced(len: usize, count: usize) -> Vec<usize> {
    if len <= count {
        return (0..len).collect();
    }
    (0..count)
        .map(|k| k * (len - 1) / (count - 1).max(1))
        .collect()
}

/// A least-squares line whose residuals may be correlated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Line {
    line: robust::Line,
    /// Change per unit of the abscissa.
    pub(crate) slope: f64,
    /// Standard uncertainty of the slope, with the correlation of the residuals.
    pub(crate) slope_sigma: f64,
    /// Standard deviation of the residuals.
    pub(crate) residual_sd: f64,
}

impl Line {
    /// Fits a line through points (x, y) whose residuals may be correlated over `lag` neighbours.
    /// Returns `None` for fewer than three points or equal `x`.
    pub(crate) fn fit(points: &[(f64, f64)], lag: usize) -> Option<Self> {
        let line = robust::Line::through(points);
        if points.len() < 3 || line.squares <= 0.0 {
            return None;
        }
        let n = points.len() as f64;
        let scale = (n / (n - 2.0)).sqrt();
        let residuals: Vec<f64> = points
            .iter()
            .map(|&(x, y)| scale * (y - line.at(x)))
            .collect();
        let influence: Vec<f64> = points
            .iter()
            .zip(&residuals)
            .map(|((x, _), e)| (x - line.centre) / line.squares * e)
            .collect();
        let variance = residuals.iter().map(|e| e * e).sum::<f64>() / n;
        let white = variance / line.squares;
        Some(Self {
            line,
            slope: line.slope,
            slope_sigma: variance_of_sum(&influence, lag).max(white).sqrt(),
            residual_sd: variance.sqrt(),
        })
    }

    /// Returns the value of the line at `x`.
    pub(crate) fn at(&self, x: f64) -> f64 {
        self.line.at(x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_interpolate_and_too_little_is_no_line() {
        let v = [4.0, 1.0, 3.0, 2.0];
        assert_eq!(median(&v), 2.5);
        assert_eq!(quantile(&v, 0.25), Some(1.75));
        assert_eq!(quantile(&[], 0.5), None);
        assert_eq!(quantile(&[7.0], 0.9), Some(7.0));
        assert_eq!(Line::fit(&[(1.0, 1.0), (1.0, 2.0), (1.0, 3.0)], 2), None);
        assert_eq!(Line::fit(&[(1.0, 1.0), (2.0, 2.0)], 2), None);
    }

    #[test]
    fn variance_of_white_and_of_correlated_sums() {
        // Repeatable and close to white: the fractional parts of a quadratic.
        let noise = |i: usize| ((i * i) as f64 * 0.618_033_988_75).fract() - 0.5;
        let white: Vec<f64> = (0..4000).map(noise).collect();
        let expected = 4000.0 / 12.0;
        let got = variance_of_sum(&white, 16);
        assert!((got / expected - 1.0).abs() < 0.25, "{got}, {expected}");
        // Each value four times: the sum is four times a sum of a quarter of the terms.
        let repeated: Vec<f64> = (0..4000).map(|i| noise(i / 4)).collect();
        let expected = 16.0 * 1000.0 / 12.0;
        let got = variance_of_sum(&repeated, 32);
        assert!((got / expected - 1.0).abs() < 0.35, "{got}, {expected}");
        assert_eq!(variance_of_sum(&[0.0; 8], 4), 0.0);
    }
}
