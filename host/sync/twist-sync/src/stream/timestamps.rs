//! Faults that a stream's timestamps alone show.
//!
//! * **Far from the rest**: a gap of a minute parts a recording, and only the part with
//!   the most samples is used. Shorter gaps part it too where the samples would be fewer
//!   than [`LEAST_RATE_HZ`] on the average. So the span that remains is at most
//!   `samples / LEAST_RATE_HZ`, and what is allocated for bins and grids is bounded by
//!   the number of samples, for any timestamps.
//! * **Order**: the fewest timestamps whose removal leaves an increasing
//!   sequence are left out (longest increasing subsequence), so one wild value
//!   costs one sample, not the rest of the recording.
//! * **Outliers**: one timestamp late or early between regular neighbours.
//! * **Coarse stamps**: all are whole multiples of a step, which is decimal or the period of a
//!   counter, and their distances are not equal. They may be rounded or truncated, so
//!   half a step remains as an uncertainty.
//! * **Sawtooth**: a device whose sensor clock is steered in steps shows small
//!   jumps of one size and sign with a slow drift in between. Jumps and drift
//!   together average out. With two jumps or more the drift is the jumps' size over their
//!   distance; of a single one only the least distance is known ([`LONE_DRIFT`]), and that is
//!   an uncertainty of the skew. A single jump may be another step of the clock, and its height
//!   over √12 remains as an uncertainty ([`Timestamps::unresolved_s`]); of several, the mean of a
//!   sawtooth is at the middle of its jumps as far as they are alike. Only the other stream shows whether the stamps
//!   jump or the samples do ([`Pattern`]).
//!   A sawtooth that is known from elsewhere and does not jump here cannot be seen: its drift
//!   looks like that of another clock. The mean and spread of all sawtooths that do not jump
//!   are used ([`UNSEEN_DRIFT`]).
//! * **A jump** of another kind is left as it is, and passed to the comparison with the other
//!   stream.
//! * **Gaps** are noted; whether they are bridged is decided by the signal.

use super::sampling::{self, Sampling};
use crate::faults::{Action, Fault, FaultKind, Stream, recurrence};
use crate::robust;
use crate::signal::neighbours::{self, leave_out};

/// Below this number of jumps they may be steps of the clock.
const FEW_RESETS: usize = 3;

/// Least jump that counts as a sawtooth's reset.
const LEAST_RESET_S: f64 = 8e-6;
/// Largest jump that counts as a reset if there are fewer than [`FEW_RESETS`].
const LARGEST_LONE_RESET_S: f64 = 100e-6;

/// Drift of a sawtooth of which a single jump is seen, mean and 1-sigma, in jumps over the
/// longer part of the recording before or after it: of periods evenly over their logarithm,
/// weighted by the probability that one jump is seen.
const LONE_DRIFT: (f64, f64) = (0.52, 0.25);
/// Drift of a known sawtooth of which no jump is seen, mean and 1-sigma, in jumps over the
/// length of the recording, for periods up to five lengths; and the 1-sigma of its mean, in
/// jumps.
const UNSEEN_DRIFT: (f64, f64, f64) = (0.40, 0.17, 0.18);
/// 1-sigma beforehand of what a jump leaves of the drift before it, as a part of a jump: the
/// instant of a jump between two samples is unknown.
const UNEVEN: f64 = 0.02;

/// 1-sigma of the mean of a sawtooth of several jumps, as a part of a jump: the instant of a
/// jump between two samples is unknown.
const UNEVEN_MEAN: f64 = 0.01;

/// Least number of samples between the jumps of a sawtooth: rounded stamps jump more often.
const MOST_OFTEN: usize = 10;

/// Least jump of the sampling itself, as a part of its step; those of stamps may be smaller.
const OWN_JUMP: f64 = 0.1;

/// Decimal resolutions of stamps that are searched for, seconds, the coarsest first.
const RESOLUTIONS_S: [f64; 9] = [20e-3, 10e-3, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5];
/// Largest number of stamps that are late together, on either side of a distance that stands out.
const LATE_TOGETHER: usize = 3;
/// Part of the samples with the stamp of the sample before, above which stamps are of batches;
/// below it, those samples are left out.
const SHARED: f64 = 0.1;
/// Distance of a stamp from a multiple, as a part of the resolution.
const NEAR_MULTIPLE: f64 = 0.02;
/// Least other resolution that is searched for, seconds: a twist does not resolve half of it.
const LEAST_RESOLUTION_S: f64 = 3e-6;
/// Rounding of the stamps on their way here, seconds.
const ROUNDING_S: f64 = 2e-9;

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
    /// 1-sigma of the mean of the timestamps due to faults, seconds.
    pub(crate) unresolved_s: f64,
    /// 1-sigma of their rate due to faults.
    pub(crate) unresolved_skew: f64,
    /// Step of coarse stamps, seconds; 0 for fine ones.
    pub(crate) resolution_s: f64,
    /// Deviation of the stamps that may be the samples' own.
    pub(crate) pattern: Option<Pattern>,
    /// Regular sampling behind the stamps, from which they deviate.
    pub(crate) sampling: Option<Sampling>,
    /// True if several samples have one stamp, so that only the regular sampling tells them apart.
    pub(crate) shared: bool,
    /// Faults that were found.
    pub(crate) faults: Vec<Fault>,
}

/// Deviation of stamps from a regular sequence: either the stamps deviate, or the sampling
/// did.
pub(crate) struct Pattern {
    /// Deviation of each stamp, seconds.
    pub(crate) later_s: Vec<f64>,
    /// The sawtooth, if the deviation is one.
    pub(crate) sawtooth: Option<Sawtooth>,
}

/// Uncertainty due to a sawtooth, if it is one of the stamps.
pub(crate) struct Sawtooth {
    /// 1-sigma of the mean of the stamps, seconds.
    pub(crate) open_s: f64,
    /// 1-sigma of their rate.
    pub(crate) open_skew: f64,
    /// Prior probability that the stamps jump and not the samples.
    pub(crate) prior: f64,
    pub(crate) fault: Fault,
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

/// Checks the timestamps of one stream. `finite[k]` marks samples whose rate is finite;
/// `known_jump_s` is the jump of a sawtooth that the stamps are known to have, or 0. Returns
/// `None` if fewer than eight usable samples remain.
pub(crate) fn check(
    stream: Stream,
    t: &[f64],
    finite: &[bool],
    known_jump_s: f64,
    first_s: Option<f64>,
) -> Option<Timestamps> {
    let mut out = Timestamps {
        t: t.to_vec(),
        usable: t
            .iter()
            .zip(finite)
            .map(|(t, &ok)| ok && t.is_finite())
            .collect(),
        step_s: 0.0,
        unresolved_s: 0.0,
        unresolved_skew: 0.0,
        resolution_s: 0.0,
        pattern: None,
        sampling: None,
        shared: false,
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
    let equal = kept.windows(2).filter(|p| t[p[1]] == t[p[0]]);
    let equal: Vec<usize> = equal.map(|p| p[1]).collect();
    if kept.len() < 8 {
        return None;
    }
    let share = equal.len() as f64 / kept.len() as f64;
    out.shared = share > SHARED;
    if !out.shared {
        out.leave_out(&mut kept, fault(FaultKind::TimestampOrder, equal));
    }
    let steps: Vec<f64> = kept.windows(2).map(|p| t[p[1]] - t[p[0]]).collect();
    let span_s = t[*kept.last()?] - t[*kept.first()?];
    let step = if out.shared {
        span_s / steps.len() as f64
    } else {
        robust::median(&steps)?
    };
    if step <= 0.0 {
        return None;
    }
    out.step_s = step;
    out.resolution_s = first_s.map_or(0.0, |first_s| resolution(t, &kept, &steps, step, first_s));
    // Steps of coarse stamps are no faults.
    if out.resolution_s == 0.0 && !out.shared {
        let mut outliers = fault(FaultKind::TimestampOutlier, isolated(&kept, &steps, step));
        outliers.period = recurrence(&outliers.samples);
        out.leave_out(&mut kept, outliers);
        look_for_jumps(stream, &kept, &mut out);
        if out.pattern.is_none() && known_jump_s != 0.0 {
            let (begin, end) = (t[kept[0]], t[kept[kept.len() - 1]]);
            let (drift, drift_sigma, mean_sigma) = UNSEEN_DRIFT;
            let each_s = known_jump_s / (end - begin);
            let middle = 0.5 * (begin + end);
            let undone = out.t.iter_mut();
            undone.for_each(|t| *t += drift * each_s * (*t - middle));
            out.unresolved_s = mean_sigma * known_jump_s.abs();
            out.unresolved_skew = (drift_sigma * each_s).abs();
        }
    }
    let sawtooth = out.pattern.as_ref().filter(|p| p.sawtooth.is_some());
    let is_step = sawtooth.is_none() && has_steps(&steps, step, out.resolution_s);
    let even = sawtooth.map(|pattern| {
        let pairs = out.t.iter().zip(&pattern.later_s);
        pairs.map(|(t, later)| t - later).collect::<Vec<f64>>()
    });
    // Regular sampling has no steps.
    if out.shared || !is_step {
        let t = even.as_deref().unwrap_or(&out.t);
        out.sampling = sampling::find(t, &kept, step, out.resolution_s, out.shared);
    }
    if out.shared {
        let sampling = out.sampling.as_ref()?;
        out.faults.push(Fault {
            samples: Vec::new(),
            count: (share * kept.len() as f64) as usize,
            ..Fault::new(
                stream,
                FaultKind::TimestampOrder,
                vec![kept[0]],
                Action::Corrected,
            )
        });
        for (t, fast) in out.t.iter_mut().zip(&sampling.fast_s) {
            *t -= fast;
        }
        let disordered = out_of_order(&out.t, &kept);
        leave_out(&mut out.usable, &disordered);
    }

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

/// Returns true if one or two distances of neighbours stand out from all others, but for samples
/// that were lost, and by more than the `resolution_s` of the stamps: then the clock, or the
/// sampling, stepped.
fn has_steps(steps: &[f64], step: f64, resolution_s: f64) -> bool {
    let odd = |d: &f64| d - (d / step).round().max(1.0) * step;
    // A sample so late that one seems lost before it seems one too many after it.
    let whole = |sum: f64| sum - (sum / step).round() * step;
    let odd: Vec<f64> = steps.iter().map(odd).collect();
    let scatter = robust::mad_sigma(odd.clone()).unwrap_or(0.0);
    let least = (8.0 * scatter).max(LEAST_RESET_S).max(1.5 * resolution_s);
    // After stamps that are late alone, the sum of the distances is right again.
    let sums = odd.iter().scan(0.0, |sum, odd| {
        *sum += odd;
        Some(*sum)
    });
    let sums: Vec<f64> = std::iter::once(0.0).chain(sums).collect();
    let stays = |k: usize| {
        let before = &sums[k - LATE_TOGETHER..=k];
        let after = &sums[k + 1..=k + 1 + LATE_TOGETHER];
        let each = after
            .iter()
            .flat_map(|after| before.iter().map(move |x| after - x));
        each.map(|by| whole(by).abs()).fold(f64::INFINITY, f64::min)
    };
    // Late batches have long tails: each is little more than the next.
    // At the ends, a step and a late batch look alike.
    let inner = LATE_TOGETHER..odd.len().saturating_sub(LATE_TOGETHER);
    let mut all: Vec<f64> = inner.map(stays).collect();
    all.sort_by(|x, y| y.total_cmp(x));
    let count = all.partition_point(|by| *by > least);
    let stands_out = |count: usize| {
        all.get(count)
            .is_none_or(|next| all[count - 1] > 2.0 * next)
    };
    (1..FEW_RESETS).contains(&count) && stands_out(count)
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

/// Returns the fewest samples whose removal leaves times that do not decrease.
fn out_of_order(t: &[f64], kept: &[usize]) -> Vec<usize> {
    if kept.windows(2).all(|p| t[p[1]] >= t[p[0]]) {
        return Vec::new();
    }
    // Patience sorting: tails[l] ends the best increasing run of length l + 1.
    let mut tails: Vec<usize> = Vec::new();
    let mut before: Vec<Option<usize>> = vec![None; t.len()];
    for &k in kept {
        let at = tails.partition_point(|&tail| t[tail] <= t[k]);
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

/// Samples whose timestamp alone deviates: late and then early, or the reverse.
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
    // Frequent deviations are jitter, not faults.
    if out.len() * 4 > kept.len() {
        out.clear();
    }
    out
}

/// Step of coarse stamps, the first of which is `first_s` on the device's clock; 0 for fine ones.
///
/// Stamps at equal distances, all whole multiples of a decimal step, may be cut to that step as
/// well: a rate near a whole number of milliseconds shows no beat.
fn resolution(t: &[f64], kept: &[usize], steps: &[f64], step: f64, first_s: f64) -> f64 {
    let off_by = |x: f64| (x - x.round()).abs();
    let first = t[kept[0]];
    let is_multiple = |q: f64, off_s: f64| {
        let off = |&&k: &&usize| off_by((t[k] - first) / q) * q > off_s;
        let most = kept.len() / 50;
        kept.iter().filter(off).take(most + 1).count() <= most
    };
    let is_near = |&q: &f64| is_multiple(q, NEAR_MULTIPLE * q);
    // Uneven distances show the step, even ones a power of ten at most.
    let is_odd = |q: &f64| steps.iter().any(|d| off_by(d / step) * step > 0.5 * q);
    // A double of seconds since 1970 is exact to 0.24 µs.
    let rounding_s = ROUNDING_S.max(4.0 * f64::EPSILON * first_s.abs());
    let is_whole = |q: &f64| {
        let begins = off_by((first_s + first) / q) * q < rounding_s;
        off_by(q.log10()) < 1e-9 && begins && is_multiple(*q, rounding_s)
    };
    let odd = RESOLUTIONS_S.into_iter().find(is_near).filter(is_odd);
    let decimal = odd.or_else(|| RESOLUTIONS_S.into_iter().find(is_whole));
    let is_counter = |q: &f64| *q < 0.75 * step && is_near(q);
    let counter = || counter_period(t, kept, steps, step).filter(is_counter);
    decimal.or_else(counter).unwrap_or(0.0)
}

/// Period of the counter that may have made the stamps: the least difference of their distances.
fn counter_period(t: &[f64], kept: &[usize], steps: &[f64], step: f64) -> Option<f64> {
    let uneven = steps.iter().map(|d| (d - step).abs());
    let mut uneven: Vec<f64> = uneven.filter(|d| *d > 2.0 * ROUNDING_S).collect();
    if uneven.len() < 2 * FEW_RESETS {
        return None;
    }
    // Some stamps may be damaged.
    let least = uneven.len() / 50;
    let rough = *uneven.select_nth_unstable_by(least, f64::total_cmp).1;
    if rough < LEAST_RESOLUTION_S {
        return None;
    }
    // The longer the span, the better it is known.
    let mut period = rough;
    for &k in kept {
        let span = t[k] - t[kept[0]];
        let turns = (span / period).round();
        if turns > 0.0 && (span / period - turns).abs() < NEAR_MULTIPLE {
            period = span / turns;
        }
    }
    ((period - rough).abs() < ROUNDING_S).then_some(period)
}

/// Adds the jumps that fall on samples that were left out, where the distance of two is a
/// multiple of the usual one, and removes those that follow too soon.
fn with_missed(
    jumps: Vec<(usize, f64)>,
    size: f64,
    kept: &[usize],
    t: &[f64],
) -> Vec<(usize, f64)> {
    let apart = |p: &[(usize, f64)]| t[p[1].0] - t[p[0].0];
    let spacing: Vec<f64> = jumps.windows(2).map(apart).collect();
    let usual = robust::median(&spacing).filter(|_| jumps.len() > FEW_RESETS);
    let Some(usual) = usual else {
        return jumps;
    };
    let mut all: Vec<(usize, f64)> = Vec::with_capacity(jumps.len());
    for &jump in &jumps {
        if let Some(&before) = all.last() {
            let between = apart(&[before, jump]);
            if between < 0.5 * usual {
                continue;
            }
            let missed = (between / usual).round() as usize;
            for k in 1..missed.min(kept.len()) {
                let at = t[before.0] + between * k as f64 / missed as f64;
                let place = kept.partition_point(|&k| t[k] < at);
                all.push((kept[place], size));
            }
        }
        all.push(jump);
    }
    all
}

/// Finds a sawtooth, or a single jump, for the comparison with the other stream.
fn look_for_jumps(stream: Stream, kept: &[usize], out: &mut Timestamps) {
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
    if count < 16 || jumps.is_empty() || jumps.len() * MOST_OFTEN > count {
        return;
    }
    let sizes: Vec<f64> = jumps.iter().map(|&(_, d)| d).collect();
    let Some(size) = robust::median(&sizes) else {
        return;
    };
    let is_alike = |jump: &f64| (jump / size - 1.0).abs() < 0.4;
    let alike = sizes.iter().filter(|jump| is_alike(jump)).count();
    let is_mostly_alike = alike * 5 >= sizes.len() * 4;
    let mut jumps = jumps;
    if is_mostly_alike {
        jumps.retain(|(_, jump)| is_alike(jump));
    }
    let times: Vec<f64> = jumps.iter().map(|(k, _)| out.t[*k]).collect();
    let first = times[0];
    let (begin, end) = (out.t[kept[0]], out.t[kept[kept.len() - 1]]);
    // One or two large jumps are a step of the clock, not a sawtooth.
    let is_sawtooth =
        is_mostly_alike && (jumps.len() >= FEW_RESETS || size.abs() <= LARGEST_LONE_RESET_S);
    let jumps = if is_sawtooth {
        with_missed(jumps, size, kept, &out.t)
    } else {
        jumps
    };
    let (drift, drift_sigma, uneven_s) = if !is_sawtooth {
        (0.0, 0.0, 0.0)
    } else if jumps.len() == 1 {
        let longer = (first - begin).max(end - first);
        (
            size / longer * LONE_DRIFT.0,
            size / longer * LONE_DRIFT.1,
            0.0,
        )
    } else {
        // Each jump undoes the drift since the one before.
        let last = jumps[jumps.len() - 1];
        let undone: f64 = jumps[1..].iter().map(|jump| jump.1).sum();
        let span_s = out.t[last.0] - out.t[jumps[0].0];
        let drift = undone / span_s;
        let left = |p: &[(usize, f64)]| {
            let since = out.t[p[1].0] - out.t[p[0].0];
            (p[1].1 - drift * since).powi(2)
        };
        let intervals = (jumps.len() - 1) as f64;
        let own = (UNEVEN * size).powi(2);
        let squares = jumps.windows(2).map(left).sum::<f64>() + own;
        let uneven_s = (squares / intervals).sqrt();
        (drift, uneven_s * intervals.sqrt() / span_s, uneven_s)
    };
    // Accumulated jumps less the drift; between two jumps, which come half a step before the
    // sample that shows them, their mean is zero.
    let mut sum = 0.0;
    let after = jumps.iter().map(|&(k, jump)| {
        sum += jump;
        sum - 0.5 * jump - drift * (out.t[k] - 0.5 * step - first)
    });
    let mean = after.sum::<f64>() / jumps.len() as f64;
    let mean = if is_sawtooth { mean } else { 0.0 };
    let mut later_s = vec![0.0; out.t.len()];
    let mut next = jumps.iter().peekable();
    let mut sum = 0.0;
    for &k in kept {
        while let Some((_, jump)) = next.next_if(|(at, _)| *at <= k) {
            sum += jump;
        }
        later_s[k] = sum - drift * (out.t[k] - first) - mean;
    }
    let sawtooth = is_sawtooth.then(|| {
        let spacing: Vec<f64> = jumps.windows(2).map(|p| (p[1].0 - p[0].0) as f64).collect();
        let count = jumps.len();
        let lone_s = if count == 1 {
            size.abs() / 12.0_f64.sqrt()
        } else {
            0.0
        };
        // If the time before a jump, and so its height, differs from that after it, its middle is
        // off the mean by a quarter of the difference.
        let unlike = jumps.windows(2).map(|pair| (pair[1].1 - pair[0].1).powi(2));
        let unlike_s = 0.25 * (unlike.sum::<f64>() / (count - 1).max(1) as f64).sqrt();
        let mean_s = uneven_s.hypot(unlike_s) / (count as f64).sqrt();
        let samples = jumps.into_iter().map(|(k, _)| k).collect();
        let kind = FaultKind::TimestampSawtooth;
        Sawtooth {
            open_s: lone_s + mean_s.hypot(UNEVEN_MEAN * size),
            open_skew: drift_sigma.abs(),
            prior: if size.abs() < OWN_JUMP * step {
                0.9
            } else {
                0.5
            },
            fault: Fault {
                period: robust::median(&spacing),
                displacement_s: Some(size),
                ..Fault::new(stream, kind, samples, Action::Corrected)
            },
        }
    });
    out.pattern = Some(Pattern { later_s, sawtooth });
}

#[cfg(test)]
mod tests {
    use super::*;

    fn regular(n: usize) -> Vec<f64> {
        (0..n).map(|k| 0.002 * k as f64).collect()
    }

    #[test]
    fn a_wild_timestamp_costs_one_sample() {
        let mut t = regular(1000);
        t[300] += 5.0;
        t[500] -= 0.7;
        t[700] = f64::NAN;
        t[900] += 0.0007;
        let checked = check(Stream::A, &t, &vec![true; 1000], 0.0, Some(1_000.012_345)).unwrap();
        let lost: Vec<usize> = (0..1000).filter(|&k| !checked.usable[k]).collect();
        assert_eq!(lost, [300, 500, 700, 900]);
    }

    #[test]
    fn timestamps_far_from_the_rest_are_left_out() {
        for wild in [-9.2e9, 9.2e9, 432_000.0, 1e300, f64::MAX] {
            for at in [0, 500, 999] {
                let mut t = regular(1000);
                t[at] = wild;
                let checked =
                    check(Stream::A, &t, &vec![true; 1000], 0.0, Some(1_000.012_345)).unwrap();
                assert_eq!(checked.faults.len(), 1, "{wild} at {at}");
                let fault = &checked.faults[0];
                assert_eq!(fault.kind, FaultKind::TimestampFar);
                assert_eq!(fault.samples, [at]);
            }
        }
        // Samples that are all far from each other leave nothing.
        let t: Vec<f64> = (0..1000).map(|k| 59.0 * f64::from(k)).collect();
        assert!(check(Stream::A, &t, &vec![true; 1000], 0.0, Some(1_000.012_345)).is_none());
    }

    #[test]
    fn a_sawtooth_is_undone_without_moving_the_mean() {
        // Zero-mean sawtooth of 57 µs, period 250 samples.
        let t: Vec<f64> = regular(4500)
            .iter()
            .enumerate()
            .map(|(k, t)| t + 57e-6 * (0.5 - (k % 250) as f64 / 250.0))
            .collect();
        let checked = check(Stream::B, &t, &vec![true; 4500], 0.0, Some(1_000.012_345)).unwrap();
        // The comparison with the other stream decides; until then the stamps stay.
        assert_eq!((checked.faults.len(), &checked.t), (0, &t));
        let pattern = checked.pattern.unwrap();
        let sawtooth = pattern.sawtooth.unwrap();
        assert_eq!(sawtooth.fault.kind, FaultKind::TimestampSawtooth);
        assert_eq!(
            (sawtooth.fault.count, sawtooth.fault.period),
            (17, Some(250.0))
        );
        let undone = t.iter().zip(&pattern.later_s).map(|(t, later)| t - later);
        let worst = undone
            .zip(regular(4500))
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f64::max);
        assert!(worst < 3e-6, "{worst}");
        assert!(sawtooth.open_s < 1e-6 && checked.unresolved_s == 0.0);
    }

    #[test]
    fn coarse_stamps_are_distinguished_from_even_ones() {
        let odd_s = 1_000.012_345;
        let cases = [
            // Step of the samples, resolution of the stamps, the first of them, expected result.
            (8.333e-3, 1e-3, 1000.0, 1e-3),
            (8.333e-3, 1e-3, odd_s, 1e-3),
            (11.86e-3, 10e-3, 1000.0, 10e-3),
            (3.497e-3, 1e-3, odd_s, 1e-3),
            // A sampling of whole steps may be cut as well, unless it begins beside one.
            (10e-3, 10e-3, 1000.0, 10e-3),
            (5e-3, 1e-9, 1000.0, 1e-3),
            (10e-3, 10e-3, odd_s, 0.0),
            (10e-3, 1e-3, odd_s, 0.0),
            (5e-3, 1e-9, odd_s, 0.0),
            (2.0001e-3, 1e-9, 1000.0, 0.0),
        ];
        for (step, resolution, first_s, expected) in cases {
            let t: Vec<f64> = (0..1000)
                .filter(|k| k * k % 1009 % 97 != 5)
                .map(|k| (step * f64::from(k) / resolution + 1e-6).floor() * resolution)
                .collect();
            let checked = check(Stream::A, &t, &vec![true; t.len()], 0.0, Some(first_s)).unwrap();
            assert_eq!(
                checked.resolution_s, expected,
                "{step} {resolution} {first_s}"
            );
            let noted = |f: &Fault| matches!(f.kind, FaultKind::Gap | FaultKind::TimestampOrder);
            assert!(checked.faults.iter().all(noted), "{:?}", checked.faults);
        }
    }

    #[test]
    fn gaps_are_noted_and_nothing_else() {
        let mut t = regular(1000);
        for x in &mut t[400..] {
            *x += 0.05;
        }
        let checked = check(Stream::A, &t, &vec![true; 1000], 0.0, Some(1_000.012_345)).unwrap();
        assert_eq!(checked.faults.len(), 1);
        assert_eq!(checked.faults[0].kind, FaultKind::Gap);
        assert_eq!(checked.t, t);
    }
}
