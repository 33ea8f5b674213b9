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

/// Median of nine: that of the highest low, the middle middle and the lowest high of
/// three sorted threes.
pub(crate) fn median_of_nine(v: &[f64; 9]) -> f64 {
    let sorted = |a: f64, b: f64, c: f64| {
        let (low, high) = (a.min(b), a.max(b));
        (low.min(c), low.max(high.min(c)), high.max(c))
    };
    let (a, b, c) = (
        sorted(v[0], v[1], v[2]),
        sorted(v[3], v[4], v[5]),
        sorted(v[6], v[7], v[8]),
    );
    let low = a.0.max(b.0).max(c.0);
    let middle = sorted(a.1, b.1, c.1).1;
    let high = a.2.min(b.2).min(c.2);
    sorted(low, middle, high).1
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
        for seed in 0..200 {
            let nine = std::array::from_fn(|k| f64::from((seed * 9 + k as i32) * 7919 % 13));
            assert_eq!(Some(median_of_nine(&nine)), median(&nine));
        }
        let sigma = mad_sigma(&[0.0, 1.0, 2.0, 3.0, 100.0]).unwrap();
        assert!((sigma - 1.4826).abs() < 1e-3);
        let (mean, slope, centre) = line(&[0.0, 1.0, 2.0], &[1.0, 3.0, 5.0]);
        assert_eq!((mean, slope, centre), (3.0, 2.0, 1.0));
    }
}
