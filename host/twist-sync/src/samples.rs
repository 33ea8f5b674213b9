//! Faults of a stream that its own samples show, without the other gyroscope.
//!
//! Motion is smooth over a few samples, so each sample can be predicted from its
//! neighbours (Lagrange interpolation at the true times, three on each side).
//! A sample whose content belongs to another time stands off by `−d · rate`,
//! where `d` is its displacement; summed over a class of samples that recurs
//! with a fixed period, displacements far below the noise of one sample show.
//!
//! * **Clipping**: a plateau at the extreme value.
//! * **Copies**: neighbours that agree to the bit in all three axes while noise
//!   or motion makes that implausible. Which of the two is stale is decided by
//!   their displacements; if that cannot be seen, both are left out.
//! * **Displaced class**: the period and phase with the most significant
//!   displacement, found one after the other, since a faulty class also spoils
//!   the predictions of its neighbours.
//!
//! Limits: of two classes of equal size (period 2) nobody can tell from this
//! alone which one is right; it is reported as unresolved time.

use super::faults::{Action, Fault, FaultKind, Stream, recurrence};
use super::robust;
use super::spline::Vec3;

/// Longest period of a displaced class that is looked for, in samples.
pub const LONGEST_PERIOD: usize = 64;
/// Significance that a displaced class must have.
const CLASS_Z: f64 = 8.0;
/// The same against the scatter of its members.
const CLASS_Z_SCATTER: f64 = 6.0;
/// Least displacement of a class, as a part of the sampling step.
const CLASS_STEP: f64 = 0.04;
/// Predictions in a block whose scatter is judged together.
const SCALE_BLOCK: usize = 64;
/// Neighbours on each side.
const SIDE: usize = 3;

/// Result of the checks of one stream's samples.
#[derive(Debug, Clone, Default)]
pub struct SampleCheck {
    /// White noise of one sample, rad/s, per axis.
    pub noise: Vec3,
    /// Uncertainty of the stream's time that a fault leaves open, seconds.
    pub unresolved_s: f64,
    /// What was found.
    pub faults: Vec<Fault>,
}

/// A sample against the prediction from its neighbours.
#[derive(Debug, Clone, Copy)]
struct Against {
    index: usize,
    /// Sample minus prediction, scaled to the noise of one sample.
    error: Vec3,
    /// Rate of change, scaled likewise.
    slope: Vec3,
}

/// Checks the samples and clears `usable` where they are to be left out.
pub fn check(
    stream: Stream,
    t: &[f64],
    w: &[Vec3],
    usable: &mut [bool],
    step_s: f64,
) -> SampleCheck {
    let mut out = SampleCheck::default();
    let fault = |kind, samples: Vec<usize>, period, displacement_s| Fault {
        stream,
        kind,
        count: samples.len(),
        period,
        displacement_s,
        action: Action::LeftOut,
        samples,
    };

    let clipped = clipped(w, usable);
    if !clipped.is_empty() {
        for &k in &clipped {
            usable[k] = false;
        }
        let found = fault(FaultKind::Clipped, clipped, None, None);
        out.faults.push(found);
    }

    let against = predictions(t, w, usable, step_s, &[]);
    out.noise = noise_of(&against);

    let pairs = copies(w, usable, &out.noise);
    if !pairs.is_empty() {
        let (left_out, displacement) = stale_copies(t, w, usable, step_s, &pairs, &out.noise);
        for &k in &left_out {
            usable[k] = false;
        }
        let period = recurrence(&pairs.iter().map(|p| p.1).collect::<Vec<_>>());
        let mut found = fault(
            FaultKind::CopiedSample,
            left_out,
            period.map(|(p, _)| p as f64),
            displacement,
        );
        found.count = pairs.len();
        out.faults.push(found);
    }

    let total = usable.iter().filter(|&&u| u).count();
    for _ in 0..12 {
        let Some(class) = next_class(t, w, usable, step_s) else {
            break;
        };
        let members: Vec<usize> = (0..t.len())
            .filter(|&k| usable[k] && k % class.period == class.phase)
            .collect();
        let kept = usable.iter().filter(|&&u| u).count();
        if class.period == 2 || (kept - members.len()) * 10 < total * 6 {
            out.unresolved_s = out.unresolved_s.max(0.5 * class.displacement_s.abs());
            let mut found = fault(
                FaultKind::DisplacedClass,
                members,
                Some(class.period as f64),
                Some(class.displacement_s),
            );
            found.action = Action::Noted;
            out.faults.push(found);
            break;
        }
        for &k in &members {
            usable[k] = false;
        }
        out.faults.push(fault(
            FaultKind::DisplacedClass,
            members,
            Some(class.period as f64),
            Some(class.displacement_s),
        ));
    }
    if out
        .faults
        .iter()
        .any(|f| f.kind == FaultKind::DisplacedClass)
    {
        out.noise = noise_of(&predictions(t, w, usable, step_s, &[]));
    }
    out
}

/// Samples at a plateau of the largest or smallest value of an axis.
fn clipped(w: &[Vec3], usable: &[bool]) -> Vec<usize> {
    let mut hit = vec![false; w.len()];
    for axis in 0..3 {
        for sign in [1.0, -1.0] {
            let extreme = (0..w.len())
                .filter(|&k| usable[k])
                .map(|k| sign * w[k][axis])
                .fold(0.0, f64::max);
            if extreme < 1.0 {
                continue;
            }
            let level = extreme * (1.0 - 1e-6);
            let (mut run, mut longest, mut count) = (0, 0, 0);
            for (v, &ok) in w.iter().zip(usable) {
                if ok && sign * v[axis] >= level {
                    run += 1;
                    count += 1;
                    longest = longest.max(run);
                } else {
                    run = 0;
                }
            }
            if longest >= 3 || (longest == 2 && count >= 6) {
                for (k, v) in w.iter().enumerate() {
                    hit[k] |= usable[k] && sign * v[axis] >= level;
                }
            }
        }
    }
    (0..w.len()).filter(|&k| hit[k]).collect()
}

/// Predicts each usable sample from its neighbours. `partner[k]`, if given,
/// is left out of the prediction of `k` too.
fn predictions(
    t: &[f64],
    w: &[Vec3],
    usable: &[bool],
    step_s: f64,
    pairs: &[(usize, usize)],
) -> Vec<Against> {
    let kept: Vec<usize> = (0..t.len()).filter(|&k| usable[k]).collect();
    let slopes = slow_slopes(t, w, &kept, step_s);
    let position = |index: usize| kept.binary_search(&index).ok();
    let mut out = Vec::with_capacity(kept.len());
    let mut predict = |at: usize, partner: Option<usize>| {
        let mut near = [0_usize; 2 * SIDE];
        let mut found = 0;
        for p in (0..at).rev() {
            if Some(kept[p]) != partner {
                near[found] = kept[p];
                found += 1;
                if found == SIDE {
                    break;
                }
            }
        }
        if found < SIDE {
            return;
        }
        for &k in &kept[at + 1..] {
            if Some(k) != partner {
                near[found] = k;
                found += 1;
                if found == 2 * SIDE {
                    break;
                }
            }
        }
        if found < 2 * SIDE {
            return;
        }
        let (first, last) = (near[SIDE - 1], near[2 * SIDE - 1]);
        let left = near[..SIDE].iter().copied().min().unwrap_or(first);
        let k = kept[at];
        let near_enough = |reach: f64, i: usize| (t[k] - t[i]).abs() < reach * step_s;
        // The nearest on each side close, all six not far: across a gap the
        // prediction errs in proportion to the rate of any vibration.
        let close = near_enough(2.6, near[0]) && near_enough(2.6, near[SIDE]);
        if !close || t[last] - t[left] > 4.0 * SIDE as f64 * step_s {
            return;
        }
        let mut predicted = [0.0; 3];
        let mut gain = 1.0;
        for (i, &n) in near.iter().enumerate() {
            let mut weight = 1.0;
            for (j, &m) in near.iter().enumerate() {
                if i != j {
                    weight *= (t[k] - t[m]) / (t[n] - t[m]);
                }
            }
            gain += weight * weight;
            for axis in 0..3 {
                predicted[axis] += weight * w[n][axis];
            }
        }
        let scale = 1.0 / gain.sqrt();
        let mut against = Against {
            index: k,
            error: [0.0; 3],
            slope: [0.0; 3],
        };
        for axis in 0..3 {
            against.error[axis] = scale * (w[k][axis] - predicted[axis]);
            against.slope[axis] = scale * slopes[at][axis];
        }
        out.push(against);
    };
    if pairs.is_empty() {
        for at in 0..kept.len() {
            predict(at, None);
        }
    } else {
        for &(first, second) in pairs {
            if let Some(at) = position(first) {
                predict(at, Some(second));
            }
        }
    }
    out
}

/// Rate of change of the slow part of the motion at each kept sample: the
/// least-squares line over 15 ms (at least four samples) on either side.
///
/// Slow on purpose: a vibration's own derivative would correlate with the
/// prediction errors that the vibration makes, in step with every period that
/// fits it.
fn slow_slopes(t: &[f64], w: &[Vec3], kept: &[usize], step_s: f64) -> Vec<Vec3> {
    let reach_s = f64::max(0.015, 4.2 * step_s);
    let (mut from, mut to) = (0, 0);
    kept.iter()
        .map(|&k| {
            while t[kept[from]] < t[k] - reach_s {
                from += 1;
            }
            while to < kept.len() && t[kept[to]] <= t[k] + reach_s {
                to += 1;
            }
            let near = &kept[from..to];
            let n = near.len() as f64;
            let centre = near.iter().map(|&i| t[i] - t[k]).sum::<f64>() / n;
            let mut spread = 0.0;
            let mut slope = [0.0; 3];
            for &i in near {
                let x = t[i] - t[k] - centre;
                spread += x * x;
                for axis in 0..3 {
                    slope[axis] += x * (w[i][axis] - w[k][axis]);
                }
            }
            slope.map(|s| if spread > 0.0 { s / spread } else { 0.0 })
        })
        .collect()
}

fn noise_of(against: &[Against]) -> Vec3 {
    let mut noise = [0.0; 3];
    for (axis, value) in noise.iter_mut().enumerate() {
        let errors: Vec<f64> = against.iter().map(|a| a.error[axis]).collect();
        *value = robust::mad_sigma(&errors)
            .filter(|sigma| sigma.is_finite())
            .unwrap_or(0.0);
    }
    noise
}

/// Neighbours that are equal to the bit where they should not be: (first, second).
///
/// A coarse or silent sensor gives equal neighbours by chance. How often is
/// estimated from how often single axes agree where the sample as a whole does
/// not. Only if there are clearly more equal neighbours than that, all of them
/// count; otherwise only those during motion that must have shown.
fn copies(w: &[Vec3], usable: &[bool], noise: &Vec3) -> Vec<(usize, usize)> {
    let kept: Vec<usize> = (0..w.len()).filter(|&k| usable[k]).collect();
    let pairs: Vec<(usize, usize)> = kept
        .windows(2)
        .map(|p| (p[0], p[1]))
        .filter(|(a, b)| b - a == 1)
        .collect();
    let equal: Vec<(usize, usize)> = pairs
        .iter()
        .copied()
        .filter(|&(a, b)| w[a] == w[b])
        .collect();
    if equal.is_empty() {
        return equal;
    }
    let others = (pairs.len() - equal.len()).max(1) as f64;
    let mut by_chance = 1.0;
    let mut resolution = [0.0; 3];
    for axis in 0..3 {
        let same = pairs
            .iter()
            .filter(|&&(a, b)| w[a] != w[b] && w[a][axis] == w[b][axis])
            .count();
        by_chance *= same as f64 / others;
        let least = pairs
            .iter()
            .map(|&(a, b)| (w[a][axis] - w[b][axis]).abs())
            .filter(|&d| d > 0.0)
            .fold(f64::INFINITY, f64::min);
        resolution[axis] = f64::max(
            4.0 * noise[axis],
            if least.is_finite() { 2.0 * least } else { 0.0 },
        );
    }
    let moving = |&(a, b): &(usize, usize)| {
        let before = w[a.saturating_sub(1)];
        let after = w[(b + 1).min(w.len() - 1)];
        (0..3).any(|axis| (after[axis] - before[axis]).abs() / 3.0 > resolution[axis])
    };
    // Long runs at rest are a silent sensor, not copies.
    let mut in_long_run = vec![false; w.len()];
    let mut from = 0;
    for k in 1..=equal.len() {
        if k == equal.len() || equal[k].0 != equal[k - 1].1 {
            if k - from > 12 {
                for &(a, b) in &equal[from..k] {
                    in_long_run[a] = true;
                    in_long_run[b] = true;
                }
            }
            from = k;
        }
    }
    let (silent, short): (Vec<_>, Vec<_>) = equal.into_iter().partition(|p| in_long_run[p.0]);
    let plausible = by_chance * pairs.len() as f64;
    let all = silent.is_empty() && short.len() as f64 > 3.0 * plausible + 8.0;
    short.into_iter().filter(|p| all || moving(p)).collect()
}

/// Which samples of the copied pairs to leave out, and how stale they are.
fn stale_copies(
    t: &[f64],
    w: &[Vec3],
    usable: &[bool],
    step_s: f64,
    pairs: &[(usize, usize)],
    noise: &Vec3,
) -> (Vec<usize>, Option<f64>) {
    let displacement = |pairs: &[(usize, usize)]| {
        let (mut top, mut bottom) = (0.0, 0.0);
        let against = predictions(t, w, usable, step_s, pairs);
        for (a, variance) in against.iter().zip(local_variances(&against, noise)) {
            let (score, information) = score(a, &variance);
            top += score;
            bottom += information;
        }
        (top / bottom, 1.0 / f64::sqrt(bottom))
    };
    let reversed: Vec<(usize, usize)> = pairs.iter().map(|&(a, b)| (b, a)).collect();
    let (first, first_sigma) = displacement(pairs);
    let (second, second_sigma) = displacement(&reversed);
    let known = first_sigma.max(second_sigma) < 0.1 * step_s;
    let is_displaced = |d: f64| d.abs() > 0.5 * step_s;
    // Runs of equal samples: the sensor is slower than the stream, and only the
    // first of each run is fresh.
    let held = pairs.len() * 5 > usable.iter().filter(|&&u| u).count() * 2;
    let chains = held || pairs.windows(2).filter(|p| p[0].1 == p[1].0).count() * 3 > pairs.len();
    // (leave out the first, leave out the second, staleness)
    let (drop_first, drop_second, stale) = if chains {
        (false, true, None)
    } else if known && is_displaced(second) && !is_displaced(first) {
        (false, true, Some(second))
    } else if known && is_displaced(first) && !is_displaced(second) {
        (true, false, Some(first))
    } else {
        (true, true, None)
    };
    let mut out: Vec<usize> = Vec::new();
    for &(first, second) in pairs {
        out.extend(drop_first.then_some(first));
        out.extend(drop_second.then_some(second));
    }
    out.sort_unstable();
    out.dedup();
    (out, stale)
}

/// Variance of the prediction errors around each sample: the noise, or more
/// where the rig vibrates (from blocks of [`SCALE_BLOCK`] predictions, robust).
fn local_variances(against: &[Against], noise: &Vec3) -> Vec<Vec3> {
    let mut out = Vec::with_capacity(against.len());
    for block in against.chunks(SCALE_BLOCK) {
        let local = noise_of(block);
        let variance: Vec3 =
            std::array::from_fn(|axis| local[axis].max(noise[axis]).powi(2).max(1e-12));
        out.extend(std::iter::repeat_n(variance, block.len()));
    }
    out
}

/// Contribution of one sample to a displacement: score and information.
fn score(a: &Against, variance: &Vec3) -> (f64, f64) {
    let (mut score, mut information) = (0.0, 0.0);
    for axis in 0..3 {
        let variance = variance[axis];
        score -= a.error[axis] * a.slope[axis] / variance;
        information += a.slope[axis] * a.slope[axis] / variance;
    }
    (score, information)
}

/// The most significant displaced class among the usable samples.
fn next_class(t: &[f64], w: &[Vec3], usable: &[bool], step_s: f64) -> Option<Class> {
    let search = |usable: &[bool], periods| {
        let against = predictions(t, w, usable, step_s, &[]);
        let noise = noise_of(&against);
        displaced_class(&against, &noise, step_s, periods)
    };
    let class = search(usable, 2..=LONGEST_PERIOD)?;
    if class.period > 2 {
        return Some(class);
    }
    // Every fourth (sixth, ...) sample displaced spoils every second prediction
    // and looks like period 2. If leaving out that class leaves nothing, it was it.
    for period in [4, 6, 8] {
        if let Some(finer) = search(usable, period..=period) {
            let mut without = usable.to_vec();
            for k in (finer.phase..without.len()).step_by(finer.period) {
                without[k] = false;
            }
            if search(&without, 2..=LONGEST_PERIOD).is_none() {
                return Some(finer);
            }
        }
    }
    Some(class)
}

#[derive(Debug, Clone, Copy)]
struct Class {
    period: usize,
    phase: usize,
    displacement_s: f64,
}

/// Sums over a class.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    score: f64,
    information: f64,
    score_squared: f64,
    product: f64,
    information_squared: f64,
    members: usize,
}

fn displaced_class(
    against: &[Against],
    noise: &Vec3,
    step_s: f64,
    periods: std::ops::RangeInclusive<usize>,
) -> Option<Class> {
    let scored: Vec<(usize, f64, f64)> = against
        .iter()
        .zip(local_variances(against, noise))
        .map(|(a, variance)| {
            let (score, information) = score(a, &variance);
            (a.index, score, information)
        })
        .collect();
    let mut best: Option<(f64, Class)> = None;
    let mut sums = [Sums::default(); LONGEST_PERIOD];
    for period in periods {
        sums[..period].fill(Sums::default());
        for &(index, score, information) in &scored {
            let sum = &mut sums[index % period];
            sum.score += score;
            sum.information += information;
            sum.score_squared += score * score;
            sum.product += score * information;
            sum.information_squared += information * information;
            sum.members += 1;
        }
        for (phase, sum) in sums[..period].iter().enumerate() {
            if sum.members < 8 || sum.information <= 0.0 {
                continue;
            }
            let displacement_s = sum.score / sum.information;
            let z = sum.score.abs() / sum.information.sqrt();
            // Significance from the scatter of the scores themselves: a burst of
            // vibration is not the even noise that `z` assumes.
            let scatter = sum.score_squared - 2.0 * displacement_s * sum.product
                + displacement_s * displacement_s * sum.information_squared;
            let z_scatter = sum.score.abs() / scatter.max(f64::MIN_POSITIVE).sqrt();
            if z > CLASS_Z
                && z_scatter > CLASS_Z_SCATTER
                && displacement_s.abs() > CLASS_STEP * step_s
                && best.is_none_or(|(top, _)| z > top)
            {
                best = Some((
                    z,
                    Class {
                        period,
                        phase,
                        displacement_s,
                    },
                ));
            }
        }
    }
    best.map(|(_, class)| class)
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP: f64 = 0.002;

    fn motion(t: f64) -> Vec3 {
        let e = (-(t - 4.5).powi(2) / 4.0).exp();
        [
            3.0 * e * (9.0 * t).sin(),
            2.0 * e * (7.0 * t).cos(),
            e * (11.0 * t).sin(),
        ]
    }

    fn noisy(k: usize) -> Vec3 {
        // A cheap repeatable noise of about 1.5 mrad/s.
        std::array::from_fn(|axis| {
            let x = ((k * 3 + axis) as f64 * 12.9898).sin() * 43758.5453;
            0.005 * (x - x.floor() - 0.5)
        })
    }

    fn stream(content: impl Fn(usize) -> f64) -> (Vec<f64>, Vec<Vec3>) {
        let t: Vec<f64> = (0..4500).map(|k| STEP * k as f64).collect();
        let w = (0..4500)
            .map(|k| {
                let (m, n) = (motion(content(k)), noisy(k));
                std::array::from_fn(|axis| m[axis] + n[axis])
            })
            .collect();
        (t, w)
    }

    #[test]
    fn a_clean_stream_is_clean() {
        let (t, w) = stream(|k| STEP * k as f64);
        let mut usable = vec![true; t.len()];
        let checked = check(Stream::Phone, &t, &w, &mut usable, STEP);
        assert!(checked.faults.is_empty(), "{:?}", checked.faults);
        assert!(usable.iter().all(|&u| u));
        assert!(
            (checked.noise[0] - 1.5e-3).abs() < 0.5e-3,
            "{:?}",
            checked.noise
        );
    }

    #[test]
    fn a_displaced_class_is_found_and_measured() {
        let (t, w) = stream(|k| STEP * k as f64 - if k % 10 == 7 { 1e-3 } else { 0.0 });
        let mut usable = vec![true; t.len()];
        let checked = check(Stream::Phone, &t, &w, &mut usable, STEP);
        assert_eq!(checked.faults.len(), 1, "{:?}", checked.faults);
        let fault = &checked.faults[0];
        assert_eq!(fault.kind, FaultKind::DisplacedClass);
        assert_eq!((fault.period, fault.count), (Some(10.0), 450));
        assert!((fault.displacement_s.unwrap() - 1e-3).abs() < 0.1e-3);
        assert!((0..4500).all(|k| usable[k] != (k % 10 == 7)));
    }

    #[test]
    fn stale_copies_are_found() {
        let (t, mut w) = stream(|k| STEP * k as f64);
        for k in (21..4500).step_by(10) {
            w[k] = w[k - 1];
        }
        let mut usable = vec![true; t.len()];
        let checked = check(Stream::Phone, &t, &w, &mut usable, STEP);
        assert_eq!(checked.faults.len(), 1, "{:?}", checked.faults);
        let fault = &checked.faults[0];
        assert_eq!(fault.kind, FaultKind::CopiedSample);
        assert_eq!(fault.period, Some(10.0));
        assert!((fault.displacement_s.unwrap() - STEP).abs() < 0.2e-3);
        assert!((0..4500).all(|k| usable[k] != (k >= 21 && k % 10 == 1)));
    }

    #[test]
    fn clipping_is_found() {
        let (t, mut w) = stream(|k| STEP * k as f64);
        for v in &mut w {
            v[0] = v[0].clamp(-2.5, 2.5);
        }
        let mut usable = vec![true; t.len()];
        let checked = check(Stream::Mcu, &t, &w, &mut usable, STEP);
        assert_eq!(checked.faults.len(), 1, "{:?}", checked.faults);
        assert_eq!(checked.faults[0].kind, FaultKind::Clipped);
        assert!((0..4500).all(|k| usable[k] != (w[k][0].abs() >= 2.5)));
    }

    #[test]
    fn silence_has_no_copies() {
        let t: Vec<f64> = (0..1000).map(|k| STEP * k as f64).collect();
        let w = vec![[0.0; 3]; 1000];
        let mut usable = vec![true; 1000];
        assert!(
            check(Stream::Mcu, &t, &w, &mut usable, STEP)
                .faults
                .is_empty()
        );
    }
}
