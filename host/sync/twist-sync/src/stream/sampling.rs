//! The regular sampling behind a stream's stamps.
//!
//! A gyroscope samples by an oscillator of its own, and the stamps that a device puts on the
//! samples err: by the latency of a bus or of a host, by batches, by the step of a counter, by a
//! clock that is steered. So each stamp is a straight line over the number of its sample, plus
//! white noise, plus a process of first order or a smooth one ([`crate::slow`]); kind, size and
//! memory come from the stamps themselves. The same deviations may also be the sampling's own, with right stamps.
//! The samples decide: the fast part by how well each sample follows from its neighbours, the
//! slow part by the other stream.
//!
//! Two hypotheses number the samples: none was lost, or all distances are whole multiples of
//! one step. The second holds if it leaves far less of the deviation.

use nalgebra::{Matrix2, Vector2};

use crate::mixture::{Supposed, mixed};
use crate::robust;
use crate::slow::{self, Point};

/// Deviation of stamps, rms, below which they are as regular as their rounding, seconds.
const REGULAR_S: f64 = 0.2e-6;
/// Length over which the slow part of the deviation is averaged, seconds: long against a
/// batch, short against a twist.
const AVERAGED_S: f64 = 0.5;
/// Part of the deviation that is left if lost samples explain it.
const LOST: f64 = 0.3;
/// Largest deviation that a stamp has in common with its neighbours, in robust 1-sigmas: of
/// exponential latencies one in 5,000 is larger.
const FAR: f64 = 12.0;
/// Slow deviation, rms in steps of the sampling, above which the sampling is not regular.
const IRREGULAR: f64 = 4.0;
/// Part of each deviation by which the loop that numbers the samples follows.
const PHASE_GAIN: f64 = 0.05;
/// Blocks over which the deviation is averaged for the line.
const BLOCKS: usize = 128;
/// Memories of the slow part, seconds, and the range of its size in parts of the rms of what it is
/// to explain.
const MEMORIES_S: [f64; 6] = [0.1, 0.2, 0.4, 0.8, 1.6, 3.2];
const SIZES: (f64, f64) = (0.01, 10.0);

/// Deviation of the stamps from regular sampling.
pub(crate) struct Sampling {
    /// Fast part of each stamp's deviation, seconds.
    pub(crate) fast_s: Vec<f64>,
    /// Slow part, seconds.
    pub(crate) slow_s: Vec<f64>,
    /// Time at which shift and rate of the line are given.
    pub(crate) middle: f64,
    /// Covariance of that shift (s) and rate, if the deviation is the stamps' error.
    pub(crate) covariance: Matrix2<f64>,
    /// True if all of the deviation is in the fast part.
    pub(crate) is_whole: bool,
}

/// Returns the regular sampling behind the stamps `t[k]` of the samples `kept`, which do not
/// decrease; `None` if they show none, or do not deviate. Stamps cut to steps of `coarse_s` err by
/// all of a deviation of that size, and stamps that are `shared` by samples by all of any.
pub(crate) fn find(
    t: &[f64],
    kept: &[usize],
    step_s: f64,
    coarse_s: f64,
    shared: bool,
) -> Option<Sampling> {
    let times: Vec<f64> = kept.iter().map(|&k| t[k]).collect();
    let middle = 0.5 * (times[0] + times[times.len() - 1]);
    let (mut number, mut deviation) = counted(&times)?;
    let mut cut = within_steps(&times, &deviation, coarse_s, middle);
    if cut.is_none() {
        (number, deviation) = numbered((number, deviation), &times, step_s)?;
        cut = within_steps(&times, &deviation, coarse_s, middle);
    }
    let rms =
        |values: &[f64]| (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt();
    let size_s = rms(&deviation);
    if size_s < REGULAR_S && coarse_s == 0.0 && !shared {
        return None;
    }
    let (slow, shift, covariance) = if let Some((shift, covariance)) = cut {
        (vec![0.0; times.len()], shift, covariance)
    } else if shared {
        let (shift, covariance) = line(&times, &deviation, middle)?;
        (vec![0.0; times.len()], shift, covariance)
    } else {
        // Of single stamps far off, all is fast.
        let scatter = robust::mad_sigma(deviation.clone()).unwrap_or(0.0);
        let most = (FAR * scatter).max(REGULAR_S);
        let deviation: Vec<f64> = deviation.iter().map(|d| d.clamp(-most, most)).collect();
        let slow = smoothed(&number, &deviation, (AVERAGED_S / step_s).max(4.0));
        if rms(&slow) > IRREGULAR * step_s {
            return None;
        }
        let (shift, covariance) = line(&times, &deviation, middle)?;
        (slow, shift, covariance)
    };
    let is_whole = slow.iter().all(|s| *s == 0.0);
    let of_line = |t: f64| shift[0] + shift[1] * (t - middle);
    let fast: Vec<f64> = if is_whole {
        deviation
            .iter()
            .zip(&times)
            .map(|(d, t)| d - of_line(*t))
            .collect()
    } else {
        deviation.iter().zip(&slow).map(|(d, s)| d - s).collect()
    };
    let (mut fast_s, mut slow_s) = (vec![0.0; t.len()], vec![0.0; t.len()]);
    for (at, &k) in kept.iter().enumerate() {
        fast_s[k] = fast[at];
        slow_s[k] = if is_whole {
            0.0
        } else {
            slow[at] - of_line(times[at])
        };
    }
    Some(Sampling {
        fast_s,
        slow_s,
        middle,
        covariance,
        is_whole,
    })
}

/// The lines that keep all deviations within one step of the stamps: as shift at the middle and
/// rate of their centre, and the covariance of an even spread over them. `None` if there are
/// none.
fn within_steps(
    times: &[f64],
    deviation: &[f64],
    step_s: f64,
    middle: f64,
) -> Option<(Vector2<f64>, Matrix2<f64>)> {
    if step_s <= 0.0 {
        return None;
    }
    // Lowest and highest deviation from a line of this rate.
    let bounds = |rate: f64| {
        let each = times
            .iter()
            .zip(deviation)
            .map(|(t, d)| d - rate * (t - middle));
        each.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), d| {
            (low.min(d), high.max(d))
        })
    };
    let range = |rate: f64| {
        let (low, high) = bounds(rate);
        high - low
    };
    // The range is convex over the rate, so that each search halves its interval.
    let most = 2.0 * step_s / (times[times.len() - 1] - times[0]);
    let (mut low, mut high) = (-most, most);
    for _ in 0..HALVED {
        let thirds = [low + (high - low) / 3.0, high - (high - low) / 3.0];
        if range(thirds[0]) < range(thirds[1]) {
            high = thirds[1];
        } else {
            low = thirds[0];
        }
    }
    let best = 0.5 * (low + high);
    let limit = step_s * (1.0 + 1e-3) + REGULAR_S;
    if range(best) > limit {
        return None;
    }
    let end = |mut outside: f64| {
        let mut inside = best;
        for _ in 0..HALVED {
            let between = 0.5 * (inside + outside);
            if range(between) > limit {
                outside = between;
            } else {
                inside = between;
            }
        }
        inside
    };
    let (first, last) = (end(-most), end(most));
    let rate = 0.5 * (first + last);
    let (low, high) = bounds(rate);
    let slack = (step_s - (high - low)).max(0.0);
    // The rates' spread is a triangle over twice its half-width, the shift's is even.
    let variances = Vector2::new(slack * slack / 12.0, (last - first).powi(2) / 24.0);
    Some((
        Vector2::new(0.5 * (low + high), rate),
        Matrix2::from_diagonal(&variances),
    ))
}

/// Halvings of an interval of rates.
const HALVED: usize = 40;

/// Numbers of samples, and the deviation of their times from the straight line over them.
type Numbered = (Vec<f64>, Vec<f64>);

/// Numbers the samples as if none was lost.
fn counted(times: &[f64]) -> Option<Numbered> {
    let number: Vec<f64> = (0..times.len()).map(|k| k as f64).collect();
    let (_, deviation) = deviation(&number, times)?;
    Some((number, deviation))
}

/// Numbers the samples by whole steps between them, if that explains the times far better.
fn numbered(counted: Numbered, times: &[f64], step_s: f64) -> Option<Numbered> {
    let scale = |deviation: &[f64]| robust::mad_sigma(deviation.to_vec()).unwrap_or(f64::INFINITY);
    let mut step = step_s;
    let mut best = counted;
    for _ in 0..3 {
        // A loop follows the phase, so that an error of the step does not add up.
        let mut number = vec![0.0];
        let (mut last, mut expected) = (0.0, times[0]);
        for &t in &times[1..] {
            let steps = ((t - expected) / step).round().max(1.0);
            last += steps;
            expected += steps * step;
            expected += PHASE_GAIN * (t - expected);
            number.push(last);
        }
        let (slope, left) = deviation(&number, times)?;
        step = slope;
        if scale(&left) < LOST * scale(&best.1) {
            best = (number, left);
        }
    }
    Some(best)
}

/// Slope of the straight line through `times` over `number`, and the deviations from it.
fn deviation(number: &[f64], times: &[f64]) -> Option<(f64, Vec<f64>)> {
    let points: Vec<(f64, f64)> = number.iter().copied().zip(times.iter().copied()).collect();
    let line = robust::Line::through(&points);
    let each = points.iter().map(|&(n, t)| t - line.at(n)).collect();
    (line.slope > 0.0).then_some((line.slope, each))
}

/// Mean of the values whose numbers are within half of `length`, twice.
fn smoothed(number: &[f64], values: &[f64], length: f64) -> Vec<f64> {
    let pass = |values: &[f64]| -> Vec<f64> {
        let (mut from, mut to, mut sum) = (0, 0, 0.0);
        let mean = |&n: &f64| {
            while to < values.len() && number[to] <= n + 0.5 * length {
                sum += values[to];
                to += 1;
            }
            while number[from] < n - 0.5 * length {
                sum -= values[from];
                from += 1;
            }
            sum / (to - from) as f64
        };
        number.iter().map(mean).collect()
    };
    pass(&pass(values))
}

/// Line through the deviations, as shift at the middle and rate, and its covariance.
fn line(times: &[f64], deviation: &[f64], middle: f64) -> Option<(Vector2<f64>, Matrix2<f64>)> {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    // The samples of a batch have one error.
    let mut from = 0;
    let batches = times.chunk_by(|t, next| t == next).map(|batch| {
        let own = &deviation[from..from + batch.len()];
        from += batch.len();
        (batch[0], mean(own))
    });
    let (mut times, mut deviation): (Vec<f64>, Vec<f64>) = batches.unzip();
    if times.len() < from {
        // The first and the last batch may be a part of one.
        let within = 1..times.len().saturating_sub(1).max(1);
        times = times[within.clone()].to_vec();
        deviation = deviation[within].to_vec();
    }
    // White noise makes the differences of neighbours alternate, a process does not.
    let steps: Vec<f64> = deviation.windows(2).map(|p| p[1] - p[0]).collect();
    let n = deviation.len().max(1) as f64;
    let most = 0.5 * steps.iter().map(|d| d * d).sum::<f64>() / n;
    let alternating = -steps.windows(2).map(|d| d[0] * d[1]).sum::<f64>() / n;
    let noise = alternating.clamp(most * 2.0 / n.sqrt(), most);
    let each = times.len().div_ceil(BLOCKS).max(1);
    let point = |(t, d): (&[f64], &[f64])| Point {
        u: mean(t) - middle,
        y: mean(d),
        variance: noise.max(REGULAR_S * REGULAR_S) / t.len() as f64,
    };
    let points: Vec<Point> = times
        .chunks(each)
        .zip(deviation.chunks(each))
        .map(point)
        .collect();
    let span_s = times.last()? - times.first()?;
    let memories = MEMORIES_S
        .into_iter()
        .filter(|memory| *memory < 0.5 * span_s);
    let kinds = memories.flat_map(|memory_s| [(memory_s, false), (memory_s, true)]);
    let straight: Vec<(f64, f64)> = points.iter().map(|p| (p.u, p.y)).collect();
    let straight = robust::Line::through(&straight);
    let squares = points.iter().map(|p| (p.y - straight.at(p.u)).powi(2));
    let size_s = (squares.sum::<f64>() / points.len() as f64)
        .sqrt()
        .max(REGULAR_S);
    let of_kind = |(memory_s, is_smooth)| {
        let range_s = (SIZES.0 * size_s, SIZES.1 * size_s);
        slow::of_sizes(&points, memory_s, is_smooth, range_s)
    };
    let all: Vec<Supposed<2>> = kinds.filter_map(of_kind).flatten().collect();
    if all.is_empty() {
        return None;
    }
    Some(mixed(&all))
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;

    /// Over wanders of any memory, the mean of the stamps is as uncertain as is said, and one wild
    /// stamp changes nothing.
    #[test]
    fn the_line_is_as_uncertain_as_the_stamps_wander() {
        let mut random = Pcg64::seed_from_u64(5);
        let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        let step_s = 5e-3;
        let mut squares = Vec::new();
        for trial in 0..240 {
            let memory_s: f64 = [0.15, 0.4, 1.0][trial % 3];
            let kept = (-step_s / memory_s).exp();
            let mut wander = 100e-6 * normal();
            let stamp = |k: u32| {
                wander = kept * wander + 100e-6 * (1.0 - kept * kept).sqrt() * normal();
                step_s * f64::from(k) + wander
            };
            let mut t: Vec<f64> = (0..2000).map(stamp).collect();
            t[1998] += 4e-3;
            let all: Vec<usize> = (0..2000).collect();
            let found = find(&t, &all, step_s, 0.0, false).unwrap();
            // The instant of a sample in the middle without its error.
            let regular = t[999] - found.fast_s[999] - found.slow_s[999];
            let error = regular - step_s * 999.0;
            squares.push(error * error / found.covariance[(0, 0)]);
        }
        let rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
        let largest = squares.iter().copied().fold(0.0, f64::max).sqrt();
        assert!(
            (0.75..1.25).contains(&rms) && largest < 4.5,
            "{rms} {largest}"
        );
    }
}
