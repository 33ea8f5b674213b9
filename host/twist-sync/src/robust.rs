//! Small robust statistics.

/// Median (mean of the middle two); not-a-number of an empty slice.
#[must_use]
pub fn median(values: &[f64]) -> f64 {
    median_in_place(&mut values.to_vec())
}

/// [`median`] without a copy; the order of the values is lost.
#[must_use]
pub fn median_in_place(sorted: &mut [f64]) -> f64 {
    let n = sorted.len();
    if n == 0 {
        return f64::NAN;
    }
    let middle = n / 2;
    let (below, &mut upper, _) = sorted.select_nth_unstable_by(middle, f64::total_cmp);
    if n % 2 == 1 {
        upper
    } else {
        let lower = below.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        0.5 * (lower + upper)
    }
}

/// Standard deviation from the median absolute deviation, as for a normal distribution.
#[must_use]
pub fn mad_sigma(values: &[f64]) -> f64 {
    let centre = median(values);
    let deviations: Vec<f64> = values.iter().map(|v| (v - centre).abs()).collect();
    1.482_602_218_505_602 * median(&deviations)
}

/// Least-squares line: (value at the centre, slope, centre of `x`).
#[must_use]
pub fn line(x: &[f64], y: &[f64]) -> (f64, f64, f64) {
    let n = x.len().max(1) as f64;
    let centre = x.iter().sum::<f64>() / n;
    let mean = y.iter().sum::<f64>() / n;
    let (mut xx, mut xy) = (0.0, 0.0);
    for (a, b) in x.iter().zip(y) {
        xx += (a - centre) * (a - centre);
        xy += (a - centre) * (b - mean);
    }
    (mean, if xx > 0.0 { xy / xx } else { 0.0 }, centre)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_and_lines() {
        assert_eq!(median(&[3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&[4.0, 1.0, 3.0, 2.0]), 2.5);
        assert!(median(&[]).is_nan());
        assert!((mad_sigma(&[0.0, 1.0, 2.0, 3.0, 100.0]) - 1.4826).abs() < 1e-3);
        let (mean, slope, centre) = line(&[0.0, 1.0, 2.0], &[1.0, 3.0, 5.0]);
        assert_eq!((mean, slope, centre), (3.0, 2.0, 1.0));
    }
}
