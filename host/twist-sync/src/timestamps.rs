//! Faults of a stream that its timestamps alone show.
//!
//! * **Far from the rest**: a gap of a minute parts a recording, and only the part with
//!   the most samples is used. Shorter gaps part it too where the samples would be fewer
//!   than [`LEAST_RATE_HZ`] on the average. So the span that remains is at most
//!   `samples / LEAST_RATE_HZ`, and what is allocated for bins and grids is bounded by
//!   the number of samples, whatever the timestamps say.
//! * **Order**: the fewest timestamps whose removal leaves an increasing
//!   sequence are left out (longest increasing subsequence), so one wild value
//!   costs one sample, not the rest of the recording.
//! * **Outliers**: one timestamp late or early between regular neighbours.
//! * **Sawtooth**: a device whose sensor clock is steered in steps shows small
//!   jumps of one size and sign with a slow drift in between. Jumps and drift
//!   together average out, so the correction removes the jumps *and* the
//!   straight line through them: the mean and the rate of the timestamps stay
//!   what they were. With fewer than [`FEW_RESETS`] jumps the phase of the
//!   sawtooth is not known, and its height over √12 remains as an uncertainty
//!   ([`Timestamps::unresolved_s`]).
//! * **Gaps** are noted; whether they are bridged is decided by the signal.

use crate::faults::{Action, Fault, FaultKind, Stream, recurrence};
use crate::neighbours::{self, leave_out};
use crate::robust::{self, Line};

/// Below this number of jumps a sawtooth's mean is uncertain.
const FEW_RESETS: usize = 3;

/// Least jump that is taken for a sawtooth's reset.
const LEAST_RESET_S: f64 = 8e-6;
/// Largest jump that is taken for one with fewer of them.
const LARGEST_LONE_RESET_S: f64 = 100e-6;

/// Longest gap within a recording, seconds.
const LONGEST_GAP_S: f64 = 60.0;
/// Least mean rate of the samples.
const LEAST_RATE_HZ: f64 = 10.0;

/// Timestamps after the checks.
pub(crate) struct Timestamps {
    /// Corrected times, relative seconds; as many as were given.
    pub(crate) t: Vec<f64>,
    /// True for those that can be used.
    pub(crate) usable: Vec<bool>,
    /// Median distance of neighbours in seconds.
    pub(crate) step_s: f64,
    /// 1-sigma of the mean of the timestamps that the faults leave open, seconds.
    pub(crate) unresolved_s: f64,
    /// Faults that were found.
    pub(crate) faults: Vec<Fault>,
}

impl Timestamps {
    /// Leaves out the samples of a fault, if it has any.
    fn leave_out(&mut self, kept: &mut Vec<usize>, fault: Fault) {
        if !fault.samples.is_empty() {
            leave_out(&mut self.usable, &fault.samples);
            kept.retain(|&k| self.usable[k]);
            self.faults.push(fault);
        }
    }
}

/// Checks the timestamps of one stream. `finite[k]` marks samples whose rate is
/// finite. `None` if fewer than eight usable samples remain.
pub(crate) fn check(stream: Stream, t: &[f64], finite: &[bool]) -> Option<Timestamps> {
    let mut out = Timestamps {
        t: t.to_vec(),
        usable: t
            .iter()
            .zip(finite)
            .map(|(t, &ok)| ok && t.is_finite())
            .collect(),
        step_s: 0.0,
        unresolved_s: 0.0,
        faults: Vec::new(),
    };
    let mut kept = neighbours::kept(&out.usable);
    let fault = |kind, samples| Fault::new(stream, kind, samples, Action::LeftOut);

    let bad = (0..t.len()).filter(|&k| !out.usable[k]).collect();
    out.leave_out(&mut kept, fault(FaultKind::NotFinite, bad));
    let far = far(t, &kept);
    out.leave_out(&mut kept, fault(FaultKind::TimestampFar, far));
    let disordered = out_of_order(t, &kept);
    out.leave_out(&mut kept, fault(FaultKind::TimestampOrder, disordered));
    if kept.len() < 8 {
        return None;
    }
    let steps: Vec<f64> = kept.windows(2).map(|p| t[p[1]] - t[p[0]]).collect();
    let step = robust::median(&steps).filter(|&step| step > 0.0)?;
    out.step_s = step;

    let mut outliers = fault(FaultKind::TimestampOutlier, isolated(&kept, &steps, step));
    outliers.period = recurrence(&outliers.samples);
    out.leave_out(&mut kept, outliers);

    correct_sawtooth(stream, &kept, &mut out);

    let gaps: Vec<usize> = kept
        .windows(2)
        .filter(|p| p[1] - p[0] == 1 && t[p[1]] - t[p[0]] > 1.5 * step)
        .map(|p| p[1])
        .collect();
    if !gaps.is_empty() {
        let gaps = Fault::new(stream, FaultKind::Gap, gaps, Action::Noted);
        out.faults.push(gaps);
    }
    Some(out)
}

/// Samples outside of the largest part of the recording.
fn far(t: &[f64], kept: &[usize]) -> Vec<usize> {
    let mut bulk = kept.to_vec();
    bulk.sort_unstable_by(|&x, &y| t[x].total_cmp(&t[y]));
    let mut gap_s = LONGEST_GAP_S;
    loop {
        let parts = bulk.chunk_by(|&k, &next| t[next] - t[k] <= gap_s);
        let Some(largest) = parts.max_by_key(|part| part.len()) else {
            break;
        };
        bulk = largest.to_vec();
        let span_s = t[bulk[bulk.len() - 1]] - t[bulk[0]];
        if span_s * LEAST_RATE_HZ <= bulk.len() as f64 {
            break;
        }
        gap_s *= 0.5;
    }
    let mut is_near = vec![false; t.len()];
    for k in bulk {
        is_near[k] = true;
    }
    kept.iter().copied().filter(|&k| !is_near[k]).collect()
}

/// The fewest samples to remove so that the rest increases strictly.
fn out_of_order(t: &[f64], kept: &[usize]) -> Vec<usize> {
    if kept.windows(2).all(|p| t[p[1]] > t[p[0]]) {
        return Vec::new();
    }
    // Patience sorting: tails[l] ends the best increasing run of length l + 1.
    let mut tails: Vec<usize> = Vec::new();
    let mut before: Vec<Option<usize>> = vec![None; t.len()];
    for &k in kept {
        let at = tails.partition_point(|&tail| t[tail] < t[k]);
        before[k] = at.checked_sub(1).map(|i| tails[i]);
        if at == tails.len() {
            tails.push(k);
        } else {
            tails[at] = k;
        }
    }
    let mut in_order = vec![false; t.len()];
    let mut next = tails.last().copied();
    while let Some(k) = next {
        in_order[k] = true;
        next = before[k];
    }
    kept.iter().copied().filter(|&k| !in_order[k]).collect()
}

/// Samples whose timestamp alone stands off: late and then early, or the reverse.
fn isolated(kept: &[usize], steps: &[f64], step: f64) -> Vec<usize> {
    let deviation: Vec<f64> = steps.iter().map(|d| d - step).collect();
    let least = 0.12 * step;
    if deviation.iter().all(|d| d.abs() <= least) {
        return Vec::new();
    }
    let scatter = robust::mad_sigma(deviation.clone()).unwrap_or(0.0);
    let threshold = (12.0 * scatter).max(least);
    let mut out = Vec::new();
    for i in 1..deviation.len() {
        let (before, after) = (deviation[i - 1], deviation[i]);
        if before.abs() > threshold
            && after.abs() > threshold
            && (before + after).abs() < 0.3 * before.abs().max(after.abs())
            && out.last() != Some(&kept[i - 1])
        {
            out.push(kept[i]);
        }
    }
    // So many that they are the rule: jitter, not faults.
    if out.len() * 4 > kept.len() {
        out.clear();
    }
    out
}

fn correct_sawtooth(stream: Stream, kept: &[usize], out: &mut Timestamps) {
    let step = out.step_s;
    let adjacent = kept
        .windows(2)
        .filter(|p| p[1] - p[0] == 1)
        .map(|p| (p[1], out.t[p[1]] - out.t[p[0]] - step))
        .filter(|(_, d)| d.abs() < 0.45 * step);
    if adjacent.clone().all(|(_, d)| d.abs() <= LEAST_RESET_S) {
        return;
    }
    let deviation: Vec<f64> = adjacent.clone().map(|(_, d)| d).collect();
    let count = deviation.len();
    let scatter = robust::mad_sigma(deviation).unwrap_or(0.0);
    let threshold = (8.0 * scatter).max(LEAST_RESET_S);
    let jumps: Vec<(usize, f64)> = adjacent.filter(|(_, d)| d.abs() > threshold).collect();
    if count < 16 || jumps.is_empty() || jumps.len() * 4 > count {
        return;
    }
    let sizes: Vec<f64> = jumps.iter().map(|&(_, d)| d).collect();
    let Some(size) = robust::median(&sizes) else {
        return;
    };
    let alike = sizes
        .iter()
        .filter(|s| (*s / size - 1.0).abs() < 0.4)
        .count();
    if alike * 5 < sizes.len() * 4 {
        return;
    }
    // One or two large jumps are a step of the clock, not a sawtooth.
    if jumps.len() < FEW_RESETS && size.abs() > LARGEST_LONE_RESET_S {
        return;
    }
    // Accumulated jumps, without the straight line through them.
    let mut stairs: Vec<(f64, f64)> = Vec::with_capacity(kept.len());
    let mut sum = 0.0;
    let mut next = jumps.iter().peekable();
    for &k in kept {
        while let Some((_, jump)) = next.next_if(|(at, _)| *at <= k) {
            sum += jump;
        }
        stairs.push((out.t[k], sum));
    }
    let line = Line::through(&stairs);
    for (&k, &(x, s)) in kept.iter().zip(&stairs) {
        out.t[k] = x - (s - line.mean - line.slope * (x - line.centre));
    }
    if jumps.len() < FEW_RESETS {
        out.unresolved_s = size.abs() / 12.0_f64.sqrt();
    }
    let spacing: Vec<f64> = jumps.windows(2).map(|p| (p[1].0 - p[0].0) as f64).collect();
    let samples = jumps.into_iter().map(|(k, _)| k).collect();
    out.faults.push(Fault {
        period: robust::median(&spacing),
        displacement_s: Some(size),
        ..Fault::new(
            stream,
            FaultKind::TimestampSawtooth,
            samples,
            Action::Corrected,
        )
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    fn regular(n: usize) -> Vec<f64> {
        (0..n).map(|k| 0.002 * k as f64).collect()
    }

    #[test]
    fn a_clean_stream_has_no_faults() {
        let t: Vec<f64> = regular(1000)
            .iter()
            .enumerate()
            .map(|(k, t)| t + 20e-6 * (k as f64 * 1.3).sin())
            .collect();
        let checked = check(Stream::B, &t, &vec![true; 1000]).unwrap();
        assert!(checked.faults.is_empty(), "{:?}", checked.faults);
        assert_eq!(checked.t, t);
    }

    #[test]
    fn a_wild_timestamp_costs_one_sample() {
        let mut t = regular(1000);
        t[300] += 5.0;
        t[500] -= 0.7;
        t[700] = f64::NAN;
        t[900] += 0.0007;
        let checked = check(Stream::A, &t, &vec![true; 1000]).unwrap();
        let lost: Vec<usize> = (0..1000).filter(|&k| !checked.usable[k]).collect();
        assert_eq!(lost, [300, 500, 700, 900]);
    }

    #[test]
    fn timestamps_far_from_the_rest_are_left_out() {
        for wild in [-9.2e9, 9.2e9, 432_000.0, 1e300, f64::MAX] {
            for at in [0, 500, 999] {
                let mut t = regular(1000);
                t[at] = wild;
                let checked = check(Stream::A, &t, &vec![true; 1000]).unwrap();
                assert_eq!(checked.faults.len(), 1, "{wild} at {at}");
                let fault = &checked.faults[0];
                assert_eq!(fault.kind, FaultKind::TimestampFar);
                assert_eq!(fault.samples, [at]);
            }
        }
        // Samples that are all far from each other leave nothing.
        let t: Vec<f64> = (0..1000).map(|k| 59.0 * f64::from(k)).collect();
        assert!(check(Stream::A, &t, &vec![true; 1000]).is_none());
    }

    #[test]
    fn a_sawtooth_is_undone_without_moving_the_mean() {
        // Zero-mean sawtooth of 57 µs, period 250 samples.
        let t: Vec<f64> = regular(4500)
            .iter()
            .enumerate()
            .map(|(k, t)| t + 57e-6 * (0.5 - (k % 250) as f64 / 250.0))
            .collect();
        let checked = check(Stream::B, &t, &vec![true; 4500]).unwrap();
        assert_eq!(checked.faults.len(), 1);
        let fault = &checked.faults[0];
        assert_eq!(fault.kind, FaultKind::TimestampSawtooth);
        assert_eq!((fault.count, fault.period), (17, Some(250.0)));
        let worst = checked
            .t
            .iter()
            .zip(regular(4500))
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f64::max);
        assert!(worst < 3e-6, "{worst}");
        assert_eq!(checked.unresolved_s, 0.0);
    }

    #[test]
    fn gaps_are_noted_and_nothing_else() {
        let mut t = regular(1000);
        for x in &mut t[400..] {
            *x += 0.05;
        }
        let checked = check(Stream::A, &t, &vec![true; 1000]).unwrap();
        assert_eq!(checked.faults.len(), 1);
        assert_eq!(checked.faults[0].kind, FaultKind::Gap);
        assert_eq!(checked.t, t);
    }
}
