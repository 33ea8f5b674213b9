//! Pairs of a phone frame and a depth frame, and their differences in time.
//!
//! A pair is two frames that are nearest to each other, comparing the phone's middle of
//! exposure of the middle row with the depth camera's centre of exposure, and no
//! farther apart than half a frame period. Every frame is in at most one pair.

use crate::time::BoardNanos;

/// Largest difference of a pair in an aligned recording unless all pairs are asked for, ns: twice
/// the unmeasured constants of a rig.
pub(crate) const LIMIT_NS: i64 = 10_000_000;

/// A phone frame and a depth frame of the same instant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Pair {
    /// Index of the phone frame in its table.
    pub(crate) color: usize,
    /// Index of the depth frame in its table.
    pub(crate) depth: usize,
    /// Depth − phone, ns.
    pub(crate) difference: i64,
}

/// Finds the pairs no farther apart than `limit` (ns). Both lists are (table index, time), sorted
/// by time.
pub(crate) fn find(
    color: &[(usize, BoardNanos)],
    depth: &[(usize, BoardNanos)],
    limit: i64,
) -> Vec<Pair> {
    let mut pairs = Vec::with_capacity(color.len().min(depth.len()));
    for &(index, at) in color {
        let Some(partner) = nearest(depth, at.0, |frame| frame.1.0) else {
            continue;
        };
        let (depth_index, depth_at) = depth[partner];
        let back = nearest(color, depth_at.0, |frame| frame.1.0).map(|place| color[place].0);
        let difference = depth_at.0.saturating_sub(at.0);
        if back == Some(index) && difference.saturating_abs() <= limit {
            pairs.push(Pair {
                color: index,
                depth: depth_index,
                difference,
            });
        }
    }
    pairs
}

/// Returns the position of the entry nearest to a time (ns), of two equally near ones the
/// earlier.
pub(crate) fn nearest<T>(sorted: &[T], at: i64, time: impl Fn(&T) -> i64) -> Option<usize> {
    let after = sorted.partition_point(|entry| time(entry) < at);
    let candidates = after.saturating_sub(1)..sorted.len().min(after + 1);
    candidates.min_by_key(|&place| time(&sorted[place]).abs_diff(at))
}

/// Histogram of the differences of pairs.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct DifferenceHistogram {
    /// Width of a bin, ns.
    pub bin_ns: i64,
    /// Lower edge of the first bin, ns.
    pub first_ns: i64,
    /// Number of differences in each bin.
    pub counts: Vec<u64>,
}

/// Largest number of bins, save for extreme ranges.
const BINS: i64 = 60;

/// Returns the histogram of all differences, with bins of 1, 2 or 5 · 10ⁿ ns; `None` without
/// pairs.
pub(crate) fn histogram(pairs: &[Pair]) -> Option<DifferenceHistogram> {
    let smallest = pairs.iter().map(|pair| pair.difference).min()?;
    let largest = pairs.iter().map(|pair| pair.difference).max()?;
    let range = largest.saturating_sub(smallest).saturating_add(1);
    let mut bin_ns: i64 = 100;
    for step in [2, 5, 10].into_iter().cycle() {
        let decade = 10_i64.pow(bin_ns.ilog10());
        if range / bin_ns < BINS {
            break;
        }
        bin_ns = match decade.checked_mul(step) {
            Some(wider) if wider <= 1_000_000_000_000_000_000 => wider,
            _ => break,
        };
    }
    let first_ns = smallest.div_euclid(bin_ns).saturating_mul(bin_ns);
    let bins = largest.saturating_sub(first_ns).div_euclid(bin_ns) + 1;
    let mut counts = vec![0; usize::try_from(bins.min(10 * BINS)).unwrap_or(1)];
    for pair in pairs {
        let bin = pair.difference.saturating_sub(first_ns).div_euclid(bin_ns);
        if let Some(count) = usize::try_from(bin)
            .ok()
            .and_then(|bin| counts.get_mut(bin))
        {
            *count += 1;
        }
    }
    Some(DifferenceHistogram {
        bin_ns,
        first_ns,
        counts,
    })
}

/// Returns the pairs near the median: no farther from the quartiles than ten times the distance
/// of the quartiles. Others (from before the trigger has arrived on the phone's
/// frames) would hide the shape of the histogram.
pub(crate) fn central(pairs: &[Pair], spread: &DifferenceSpread) -> Vec<Pair> {
    let [low, high] = spread.quartiles_ns;
    let reach = high.saturating_sub(low).max(1_000).saturating_mul(10);
    let range = low.saturating_sub(reach)..=high.saturating_add(reach);
    let near = |pair: &&Pair| range.contains(&pair.difference);
    pairs.iter().filter(near).copied().collect()
}

/// Distribution of the differences of pairs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct DifferenceSpread {
    /// Number of pairs.
    pub count: usize,
    /// Median, ns.
    pub median_ns: i64,
    /// First and third quartile, ns.
    pub quartiles_ns: [i64; 2],
    /// Smallest and largest, ns.
    pub range_ns: [i64; 2],
}

/// Returns the distribution of the differences; `None` without pairs.
pub(crate) fn spread(pairs: &[Pair]) -> Option<DifferenceSpread> {
    let mut sorted: Vec<i64> = pairs.iter().map(|pair| pair.difference).collect();
    sorted.sort_unstable();
    let at = |numerator: usize| {
        sorted
            .get((sorted.len().saturating_sub(1)) * numerator / 4)
            .copied()
    };
    Some(DifferenceSpread {
        count: sorted.len(),
        median_ns: at(2)?,
        quartiles_ns: [at(1)?, at(3)?],
        range_ns: [at(0)?, at(4)?],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times(times: &[i64]) -> Vec<(usize, BoardNanos)> {
        times
            .iter()
            .enumerate()
            .map(|(i, &t)| (i, BoardNanos(t)))
            .collect()
    }

    #[test]
    fn every_frame_is_in_one_pair_at_most() {
        let color = times(&[0, 100, 200, 300, 400]);
        let depth = times(&[5, 98, 140, 306, 360, 460]);
        let pairs = find(&color, &depth, 50);
        let found: Vec<_> = pairs
            .iter()
            .map(|p| (p.color, p.depth, p.difference))
            .collect();
        assert_eq!(found, [(0, 0, 5), (1, 1, -2), (3, 3, 6), (4, 4, -40)]);
        assert_eq!(find(&color, &[], 50), []);
        let far = times(&[i64::MIN, i64::MAX]);
        assert_eq!(find(&color, &far, 50), []);
    }

    #[test]
    fn the_histogram_holds_all_pairs() {
        let pair = |difference| Pair {
            color: 0,
            depth: 0,
            difference,
        };
        let pairs: Vec<Pair> = (-500..500).map(|i| pair(i * 37)).collect();
        let histogram = histogram(&pairs).unwrap();
        assert_eq!(histogram.counts.iter().sum::<u64>(), 1000);
        assert_eq!(histogram.bin_ns, 1000);
        assert_eq!(histogram.first_ns, -19_000);
        assert!(histogram.counts.len() <= 60);
        assert_eq!(super::histogram(&[]), None);
        let one = super::histogram(&[pair(7)]).unwrap();
        assert_eq!((one.bin_ns, one.counts.as_slice()), (100, &[1][..]));
        let spread = spread(&pairs).unwrap();
        assert_eq!(spread.range_ns, [-500 * 37, 499 * 37]);
        let _ = super::histogram(&[pair(i64::MIN), pair(i64::MAX)]);
        assert_eq!(central(&pairs, &spread), pairs);
        let far = [&pairs[..], &[pair(11_000_000), pair(-9_000_000)]].concat();
        assert_eq!(central(&far, &super::spread(&far).unwrap()), pairs);
        assert_eq!(central(&[], &spread), []);
    }
}
