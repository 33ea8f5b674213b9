//! Spread, regression, even choices, and the uncertainty of sums whose errors are correlated.

use twist_sync::robust;

/// Factor from one standard deviation to the 99 % interval of a normal distribution.
pub(crate) const COVERAGE_99: f64 = 2.576;

/// Quantile by linear interpolation between order statistics (the usual default,
/// type 7 of Hyndman and Fan). `None` without values.
pub fn quantile(values: &[f64], q: f64) -> Option<f64> {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let last = sorted.len().checked_sub(1)?;
    let at = q.clamp(0.0, 1.0) * last as f64;
    let below = *sorted.get(at.floor() as usize)?;
    let above = *sorted.get(at.ceil() as usize)?;
    Some(below + (at - at.floor()) * (above - below))
}

/// Median; zero without values.
pub(crate) fn median(values: &[f64]) -> f64 {
    quantile(values, 0.5).unwrap_or(0.0)
}

/// Mean; zero without values.
pub fn mean(values: &[f64]) -> f64 {
    if values.is_empty() {
        0.0
    } else {
        values.iter().sum::<f64>() / values.len() as f64
    }
}

/// Standard deviation with `n - 1`; `None` for fewer than two values.
pub fn standard_deviation(values: &[f64]) -> Option<f64> {
    let n = values.len();
    if n < 2 {
        return None;
    }
    let m = mean(values);
    let sum: f64 = values.iter().map(|v| (v - m).powi(2)).sum();
    Some((sum / (n - 1) as f64).sqrt())
}

/// Variance of the sum of `terms` whose errors are correlated over up to `lag`
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

/// By how much correlation between neighbours raises the variance of a sum of
/// `residuals` over that of independent ones; at least 1.
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
    // All lags at once: sums that do not wait for one another.
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

/// At most `count` indices spread evenly over `0..len`.
pub(crate) fn spread(len: usize, count: usize) -> Vec<usize> {
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
    /// Through points (x, y); `None` for fewer than three or no spread in `x`.
    /// Residuals may be correlated over `lag` neighbours.
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

    /// Value at `x`.
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
        // A repeatable stand-in for noise: the fractional parts of a quadratic.
        let noise = |i: usize| ((i * i) as f64 * 0.618_033_988_75).fract() - 0.5;
        let white: Vec<f64> = (0..4000).map(noise).collect();
        let truth = 4000.0 / 12.0;
        let got = variance_of_sum(&white, 16);
        assert!((got / truth - 1.0).abs() < 0.25, "{got} against {truth}");
        // Each value four times: the sum is four times a sum of a quarter of the terms.
        let repeated: Vec<f64> = (0..4000).map(|i| noise(i / 4)).collect();
        let truth = 16.0 * 1000.0 / 12.0;
        let got = variance_of_sum(&repeated, 32);
        assert!((got / truth - 1.0).abs() < 0.35, "{got} against {truth}");
        assert_eq!(variance_of_sum(&[0.0; 8], 4), 0.0);
    }
}
