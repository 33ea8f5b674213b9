//! Search for parts of two recordings that move alike, where the gyroscopes were on one body only
//! at times.
//!
//! A correlation over whole recordings adds up all the time in which they were apart: a minute
//! together is lost in hours. So each part of a is correlated by itself with all of b, zero-mean
//! and normalised by the power of both where it lies (the correlation coefficient).

use crate::correlate::Correlator;

/// Values of b that one correlation takes.
const CHUNK: usize = 8192;
/// Most parts that are tried, the busiest: those of ten hours.
const MOST_PARTS: usize = 3000;
/// Part of the usual variance below which b is at rest.
const AT_REST: f64 = 1e-4;

/// Returns where parts of `length` values begin in a, and their lags (value `i` of a is value
/// `i + lag` of b), the best agreement first.
pub(super) fn alike(a: &[f64], b: &[f64], length: usize, most: usize) -> Vec<(i64, i64)> {
    let correlator = Correlator::new(CHUNK);
    let sums = Sums::new(b);
    let rest = AT_REST * sums.variance(0, b.len());
    let chunks: Vec<_> = (0..b.len())
        .step_by(CHUNK - length)
        .map(|from| {
            let values = &b[from..b.len().min(from + CHUNK)];
            (
                from,
                values.len(),
                correlator.spectrum(values.iter().copied()),
            )
        })
        .collect();
    let sums_a = Sums::new(a);
    let starts = (0..(a.len() + 1).saturating_sub(length)).step_by(length);
    let mut parts: Vec<(usize, f64)> = starts
        .map(|from| (from, sums_a.variance(from, length)))
        .filter(|part| part.1 > 0.0)
        .collect();
    parts.sort_by(|x, y| y.1.total_cmp(&x.1));
    parts.truncate(MOST_PARTS);
    let mut found: Vec<(f64, i64, i64)> = Vec::new();
    for (start, variance) in parts {
        let part = &a[start..start + length];
        let mean = part.iter().sum::<f64>() / length as f64;
        let spectrum = correlator.spectrum(part.iter().map(|value| value - mean));
        for (from, count, chunk) in &chunks {
            let correlation = correlator.correlation(&spectrum, chunk);
            let agreement = (0..(count + 1).saturating_sub(length))
                .map(|k| (k, sums.variance(from + k, length)))
                .filter(|&(_, own)| own > rest)
                .map(|(k, own)| {
                    (
                        correlation[k] / (length as f64 * (variance * own).sqrt()),
                        k,
                    )
                })
                .max_by(|x, y| x.0.total_cmp(&y.0));
            let lag = |k: usize| (from + k) as i64 - start as i64;
            found.extend(agreement.map(|(value, k)| (value, start as i64, lag(k))));
        }
    }
    found.sort_by(|x, y| y.0.total_cmp(&x.0));
    found
        .into_iter()
        .take(most)
        .map(|own| (own.1, own.2))
        .collect()
}

/// Sums of values and of their squares up to each place.
struct Sums(Vec<(f64, f64)>);

impl Sums {
    fn new(values: &[f64]) -> Self {
        let mut sums = vec![(0.0, 0.0)];
        let mut sum = (0.0, 0.0);
        for value in values {
            sum = (sum.0 + value, sum.1 + value * value);
            sums.push(sum);
        }
        Self(sums)
    }

    fn variance(&self, from: usize, length: usize) -> f64 {
        let (first, last) = (self.0[from], self.0[from + length]);
        let count = length.max(1) as f64;
        let mean = (last.0 - first.0) / count;
        (last.1 - first.1) / count - mean * mean
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;

    #[test]
    fn a_part_in_common_is_found_in_recordings_that_have_nothing_else_in_common() {
        let mut random = Pcg64::seed_from_u64(7);
        let mut noise = |count| -> Vec<f64> { (0..count).map(|_| random.random()).collect() };
        let (mut a, mut b, common) = (noise(30_000), noise(40_000), noise(700));
        a[12_000..12_700].copy_from_slice(&common);
        b[31_234..31_934].copy_from_slice(&common);
        // A stretch at rest has no power to be divided by.
        b[..20_000].fill(0.1);
        let found = alike(&a, &b, 300, 3);
        assert_eq!(found.len(), 3);
        assert_eq!(found[0].1, 31_234 - 12_000);
        assert!((12_000..12_400).contains(&found[0].0));
        assert_eq!(alike(&a[..299], &b, 300, 3), []);
        assert_eq!(alike(&a, &[], 300, 3), []);
    }
}
