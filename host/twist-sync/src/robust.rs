//! Small robust statistics.

/// Median (mean of the middle two); `None` without values.
#[must_use]
pub fn median(values: &[f64]) -> Option<f64> {
    median_in_place(&mut values.to_vec())
}

/// [`median`] without a copy; the order of the values is lost.
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
        let lower = below.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        0.5 * (lower + upper)
    })
}

/// Standard deviation from the median absolute deviation, as for a normal
/// distribution; `None` without values.
pub(crate) fn mad_sigma(values: &[f64]) -> Option<f64> {
    let centre = median(values)?;
    let mut deviations: Vec<f64> = values.iter().map(|v| (v - centre).abs()).collect();
    Some(1.482_602_218_505_602 * median_in_place(&mut deviations)?)
}

/// Least-squares line: (value at the centre, slope, centre of `x`).
pub(crate) fn line(x: &[f64], y: &[f64]) -> (f64, f64, f64) {
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
        assert_eq!(median(&[3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(&[4.0, 1.0, 3.0, 2.0]), Some(2.5));
        assert_eq!(median(&[]), None);
        let sigma = mad_sigma(&[0.0, 1.0, 2.0, 3.0, 100.0]).unwrap();
        assert!((sigma - 1.4826).abs() < 1e-3);
        let (mean, slope, centre) = line(&[0.0, 1.0, 2.0], &[1.0, 3.0, 5.0]);
        assert_eq!((mean, slope, centre), (3.0, 2.0, 1.0));
    }
}
