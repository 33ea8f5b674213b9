//! Faults that a stream's own samples show, without the other gyroscope.
//!
//! Motion is smooth over a few samples, so each sample can be predicted from its
//! neighbours (Lagrange interpolation at the true times, three on each side).
//! A sample whose content belongs to another time deviates by `−d · rate`,
//! where `d` is its displacement. Summed over a class of samples that recurs
//! with a fixed period, displacements far below the noise of one sample show.
//!
//! * **Spikes**: single samples far off all around them.
//! * **Clipping**: a plateau at which the motion, by its slope before and after, would have
//!   gone on. A peak of the motion that falls on one step of a coarse sensor has none.
//! * **Copies**: neighbours that agree to the bit in all three axes while noise
//!   or motion makes that implausible. Their displacements show which of the two is
//!   stale; if they do not, both are left out.
//! * **Displaced class**: the period and phase with the most significant
//!   displacement, found one after the other, since a faulty class also spoils
//!   the predictions of its neighbours.
//! * **Interpolated streams** ([`Made`]): samples that lie on straight lines between others.
//!   Nothing is left out of them.
//!
//! Limits: with two classes of equal size (period 2), nothing shows which of them is
//! right; that is reported as unresolved time.

use super::classes;
use crate::faults::{Action, Fault, FaultKind, Stream, recurrence};
use crate::robust;
use crate::signal::interpolant::Vec3;
use crate::signal::neighbours::{Against, Samples, kept, leave_out, local_variances, noise_of};

/// Least distance of a spike from the samples around it: in rad/s, and in multiples of their
/// own deviation.
const SPIKE: f64 = 1.0;
const SPIKE_SIGMAS: f64 = 15.0;
/// Least distance by which the motion would have gone on beyond a clipped plateau: in steps of
/// the sensor, plus sigmas of its noise.
const CLIPPED_STEPS: f64 = 6.0;
const CLIPPED_SIGMAS: f64 = 4.0;
/// Samples of a stretch in the search for straight lines between samples, and approximate
/// number of samples in all stretches.
const LOOKED_AT: usize = 64;
const LOOKED_AT_IN_ALL: usize = 1024;

/// Origin of samples that were made from slower ones, with the rate of those in Hz.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Made {
    /// Straight lines between the slower samples.
    Interpolated(f64),
    /// Each slower sample held for a while.
    Held(f64),
}

/// Result of the checks of one stream's samples.
#[derive(Default)]
pub(crate) struct SampleCheck {
    /// White noise of one sample, rad/s, per axis.
    pub(crate) noise: Vec3,
    /// 1-sigma of the stream's time due to an unresolved fault, seconds.
    pub(crate) unresolved_s: f64,
    pub(crate) made: Option<Made>,
    /// Faults that were found.
    pub(crate) faults: Vec<Fault>,
}

/// Checks the samples, whose stamps have steps of `resolution_s`, and clears `usable` for those
/// to leave out.
pub(crate) fn check(
    stream: Stream,
    samples: Samples<'_>,
    resolution_s: f64,
    usable: &mut [bool],
) -> SampleCheck {
    let mut out = SampleCheck::default();
    let fault = |kind, members| Fault::new(stream, kind, members, Action::LeftOut);

    let spikes = spikes(samples.w, usable);
    if !spikes.is_empty() {
        leave_out(usable, &spikes);
        out.faults.push(fault(FaultKind::Outlier, spikes));
    }
    let mut against = samples.predictions(usable);
    out.noise = noise_of(&against);
    let clipped = clipped(samples.w, usable, &out.noise);
    if !clipped.is_empty() {
        leave_out(usable, &clipped);
        out.faults.push(fault(FaultKind::Clipped, clipped));
        against = samples.predictions(usable);
        out.noise = noise_of(&against);
    }
    out.made = interpolated(samples, usable).map(Made::Interpolated);
    if out.made.is_some() {
        return out;
    }

    let pairs = copies(samples.w, usable, &out.noise);
    if !pairs.is_empty() {
        let (stale, displacement_s) = stale_copies(samples, usable, &pairs, &out.noise);
        let all = kept(usable).len();
        if pairs.len() * 5 > all * 2 {
            let fresh = (all - pairs.len()) as f64;
            out.made = Some(Made::Held(fresh / all as f64 / samples.step_s));
        }
        leave_out(usable, &stale);
        against = samples.predictions(usable);
        out.noise = noise_of(&against);
        out.faults.push(Fault {
            count: pairs.len(),
            period: recurrence(&pairs.iter().map(|p| p.1).collect::<Vec<_>>()),
            displacement_s,
            ..fault(FaultKind::CopiedSample, stale)
        });
    }

    leave_out_displaced(stream, samples, resolution_s, usable, against, &mut out);
    out
}

/// Leaves out displaced classes, the most significant first. `against` are the
/// predictions of the usable samples.
fn leave_out_displaced(
    stream: Stream,
    samples: Samples<'_>,
    resolution_s: f64,
    usable: &mut [bool],
    mut against: Vec<Against>,
    out: &mut SampleCheck,
) {
    let total = kept(usable).len();
    for _ in 0..12 {
        let Some(class) = classes::most_displaced(samples, usable, &against, &out.noise) else {
            break;
        };
        // Coarse stamps recur with the sampling.
        if class.displacement_s.abs() < resolution_s {
            break;
        }
        let left = kept(usable);
        let members: Vec<usize> = left
            .iter()
            .copied()
            .filter(|k| k % class.period == class.phase)
            .collect();
        let undecided = class.period == 2 || (left.len() - members.len()) * 10 < total * 6;
        let action = if undecided {
            Action::Noted
        } else {
            leave_out(usable, &members);
            against = samples.predictions(usable);
            out.noise = noise_of(&against);
            Action::LeftOut
        };
        out.faults.push(Fault {
            period: Some(class.period as f64),
            displacement_s: Some(class.displacement_s),
            ..Fault::new(stream, FaultKind::DisplacedClass, members, action)
        });
        if undecided {
            out.unresolved_s = 0.5 * class.displacement_s.abs();
            break;
        }
    }
}

/// Single samples, or a few, far from those around them.
fn spikes(w: &[Vec3], usable: &[bool]) -> Vec<usize> {
    let kept = kept(usable);
    let mut hit = vec![false; w.len()];
    for axis in 0..3 {
        let is_small = |p: &[usize]| (w[p[1]][axis] - w[p[0]][axis]).abs() < SPIKE / 4.0;
        // Far from the median of four on either side is far from one of them.
        if kept.windows(2).all(is_small) {
            continue;
        }
        let values: Vec<f64> = kept.iter().map(|&k| w[k][axis]).collect();
        let off = robust::without_local_median(&values);
        for at in (0..off.len()).filter(|&at| off[at].abs() > SPIKE) {
            let around = at.saturating_sub(4)..(at + 5).min(values.len());
            let local = robust::mad_sigma(values[around].to_vec()).unwrap_or(0.0);
            hit[kept[at]] |= off[at].abs() > SPIKE_SIGMAS * local;
        }
    }
    (0..w.len()).filter(|&k| hit[k]).collect()
}

/// Samples at a plateau of the largest or smallest value of an axis.
fn clipped(w: &[Vec3], usable: &[bool], noise: &Vec3) -> Vec<usize> {
    let mut hit = vec![false; w.len()];
    for axis in 0..3 {
        for sign in [1.0, -1.0] {
            let value = |k: usize| sign * w[k][axis];
            let values = (0..w.len()).filter(|&k| usable[k]);
            let extreme = values.clone().map(value).fold(0.0, robust::higher);
            if extreme < 1.0 {
                continue;
            }
            let level = extreme * (1.0 - 1e-6);
            let top: Vec<usize> = values.filter(|&k| value(k) >= level).collect();
            if top.len() < 3 {
                continue;
            }
            let changes = w.windows(2).map(|p| (p[1][axis] - p[0][axis]).abs());
            let step = changes.filter(|&d| d > 0.0).fold(f64::INFINITY, f64::min);
            let least = CLIPPED_STEPS * step + CLIPPED_SIGMAS * noise[axis];
            // Beyond the plateau the motion would have gone on by its slope.
            let beyond = |run: &[usize]| {
                let (first, last) = (run[0], run[run.len() - 1]);
                let before = extreme - value(first.checked_sub(3)?);
                let after = extreme - sign * w.get(last + 3)?[axis];
                Some(before.min(after) / 3.0 * (run.len() + 1) as f64 / 4.0)
            };
            let runs: Vec<&[usize]> = top.chunk_by(|k, next| next - k == 1).collect();
            let is_clipped = |run: &&&[usize]| beyond(run).is_some_and(|rate| rate > least);
            let clipped: usize = runs.iter().filter(is_clipped).map(|run| run.len()).sum();
            if clipped >= 3 {
                top.iter().for_each(|&k| hit[k] = true);
            }
        }
    }
    (0..w.len()).filter(|&k| hit[k]).collect()
}

/// Rate in Hz of the samples between which all others are interpolated on straight lines;
/// `None` for any other stream.
fn interpolated(samples: Samples<'_>, usable: &[bool]) -> Option<f64> {
    let Samples { t, w, step_s } = samples;
    let is_near = |k: usize| usable[k - 1] && usable[k] && usable[k + 1];
    // Distance of each sample but the first and last from the line between its neighbours.
    let bend = |k: usize| -> Vec3 {
        let (before, after) = (t[k] - t[k - 1], t[k + 1] - t[k]);
        let part = after / (before + after);
        let line = |axis: usize| w[k + 1][axis] + (w[k - 1][axis] - w[k + 1][axis]) * part;
        std::array::from_fn(|axis| (w[k][axis] - line(axis)).abs())
    };
    let (mut triples, mut straight, mut single) = (0.0, 0.0, [0.0; 3]);
    let end = w.len().saturating_sub(3);
    // A part of the stream shows it.
    let apart = LOOKED_AT * (w.len() / LOOKED_AT_IN_ALL).max(1);
    for from in (3..end).step_by(apart) {
        let to = (from + LOOKED_AT).min(end);
        let bends: Vec<Vec3> = (from - 2..to + 2).map(bend).collect();
        for k in (from..to).filter(|&k| is_near(k)) {
            if (0..3).any(|axis| w[k][axis] == w[k - 1][axis] || w[k][axis] == w[k + 1][axis]) {
                continue;
            }
            triples += 1.0;
            let near = &bends[k - from..k - from + 5];
            let on_line = |axis: usize| {
                let around = [0, 1, 3, 4].map(|at| near[at][axis]);
                near[2][axis] < 1e-3 * around.into_iter().fold(0.0, robust::higher)
            };
            let each: [bool; 3] = std::array::from_fn(on_line);
            if each == [true; 3] {
                straight += 1.0;
            } else {
                (0..3).for_each(|axis| single[axis] += f64::from(u8::from(each[axis])));
            }
        }
    }
    let others = f64::max(triples - straight, 1.0);
    let by_chance = triples * single.iter().map(|n| n / others).product::<f64>();
    let shows = straight > 0.05 * triples && straight > 3.0 * by_chance + 8.0;
    // Each sample of the slower stream bends the line in two triples.
    shows.then(|| 0.5 * (triples - straight) / triples / step_s)
}

/// Neighbours that are equal to the bit where they should not be: (first, second).
///
/// A coarse or silent sensor gives equal neighbours by chance. The expected number of those is
/// estimated from the agreement of single axes in samples that differ as a whole. If there are
/// clearly more equal neighbours, all of them count; otherwise only those during motion that
/// must have changed the sample.
fn copies(w: &[Vec3], usable: &[bool], noise: &Vec3) -> Vec<(usize, usize)> {
    let pairs = || {
        (1..w.len())
            .map(|k| (k - 1, k))
            .filter(|&(a, b)| usable[a] && usable[b])
    };
    let equal: Vec<(usize, usize)> = pairs().filter(|&(a, b)| w[a] == w[b]).collect();
    if equal.is_empty() {
        return equal;
    }
    let count = pairs().count();
    let others = (count - equal.len()).max(1) as f64;
    let mut by_chance = 1.0;
    let mut resolution = [0.0; 3];
    for axis in 0..3 {
        let same = pairs()
            .filter(|&(a, b)| w[a] != w[b] && w[a][axis] == w[b][axis])
            .count();
        by_chance *= same as f64 / others;
        let least = pairs()
            .map(|(a, b)| (w[a][axis] - w[b][axis]).abs())
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
    let runs = equal.chunk_by(|pair, next| pair.1 == next.0);
    let (silent, short): (Vec<_>, Vec<_>) = runs.partition(|run| run.len() > 12);
    let short = short.concat();
    let plausible = by_chance * count as f64;
    let all = silent.is_empty() && short.len() as f64 > 3.0 * plausible + 8.0;
    short.into_iter().filter(|p| all || moving(p)).collect()
}

/// Returns the samples of the copied pairs to leave out, and their staleness.
fn stale_copies(
    samples: Samples<'_>,
    usable: &[bool],
    pairs: &[(usize, usize)],
    noise: &Vec3,
) -> (Vec<usize>, Option<f64>) {
    let displacement = |against: Vec<Against>| {
        let (mut top, mut bottom) = (0.0, 0.0);
        for (a, variance) in against.iter().zip(local_variances(&against, noise)) {
            let (score, information) = a.score(&variance);
            top += score;
            bottom += information;
        }
        (top / bottom, 1.0 / f64::sqrt(bottom))
    };
    let each = samples.predictions_without(usable, pairs);
    let [(first, first_sigma), (second, second_sigma)] = each.map(displacement);
    let known = first_sigma.max(second_sigma) < 0.1 * samples.step_s;
    let is_displaced = |d: f64| d.abs() > 0.5 * samples.step_s;
    // Runs of equal samples: the sensor is slower than the stream, and only the
    // first of each run is fresh.
    let held = pairs.len() * 5 > kept(usable).len() * 2;
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

#[cfg(test)]
mod tests {
    use super::*;

    const STEP: f64 = 0.002;

    fn samples<'a>(t: &'a [f64], w: &'a [Vec3]) -> Samples<'a> {
        Samples { t, w, step_s: STEP }
    }

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
    fn a_displaced_class_is_found_and_measured() {
        let (t, w) = stream(|k| STEP * k as f64 - if k % 10 == 7 { 1e-3 } else { 0.0 });
        let mut usable = vec![true; t.len()];
        let checked = check(Stream::B, samples(&t, &w), 0.0, &mut usable);
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
        let checked = check(Stream::B, samples(&t, &w), 0.0, &mut usable);
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
        let checked = check(Stream::A, samples(&t, &w), 0.0, &mut usable);
        assert_eq!(checked.faults.len(), 1, "{:?}", checked.faults);
        assert_eq!(checked.faults[0].kind, FaultKind::Clipped);
        assert!((0..4500).all(|k| usable[k] != (w[k][0].abs() >= 2.5)));
    }

    #[test]
    fn peaks_on_steps_of_a_coarse_sensor_are_not_clipped() {
        // Steps of 16 and 70 mdps and of 1/16 °/s, at which a slow peak stands for long.
        for step in [16e-3_f64, 70e-3, 62.5e-3].map(f64::to_radians) {
            for lowest in [0.0, 1e-3, 5e-3] {
                let (t, mut w) = stream(|k| STEP * k as f64);
                for (k, v) in w.iter_mut().enumerate() {
                    let clean = motion(STEP * k as f64);
                    for (x, clean) in v.iter_mut().zip(clean) {
                        *x = ((clean + (*x - clean) * lowest / 1.5e-3) / step).round() * step;
                    }
                }
                let mut usable = vec![true; t.len()];
                let checked = check(Stream::A, samples(&t, &w), 0.0, &mut usable);
                let clipped = |f: &Fault| f.kind == FaultKind::Clipped;
                assert!(!checked.faults.iter().any(clipped), "{step} {lowest}");
            }
        }
    }

    #[test]
    fn spikes_are_left_out_and_nothing_beside_them() {
        let (t, mut w) = stream(|k| STEP * k as f64);
        for k in [700, 1500, 2200, 2201, 3000] {
            w[k][1] += 150.0;
        }
        let mut usable = vec![true; t.len()];
        let checked = check(Stream::A, samples(&t, &w), 0.0, &mut usable);
        assert_eq!(checked.faults.len(), 1, "{:?}", checked.faults);
        assert_eq!(checked.faults[0].samples, [700, 1500, 2200, 2201, 3000]);
    }

    #[test]
    fn silence_has_no_copies() {
        let t: Vec<f64> = (0..1000).map(|k| STEP * k as f64).collect();
        let w = vec![[0.0; 3]; 1000];
        let mut usable = vec![true; 1000];
        assert!(
            check(Stream::A, samples(&t, &w), 0.0, &mut usable)
                .faults
                .is_empty()
        );
    }
}
