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

use crate::classes;
use crate::faults::{Action, Fault, FaultKind, Stream, recurrence};
use crate::interpolant::Vec3;
use crate::neighbours::{Against, Samples, kept, leave_out, local_variances, noise_of};
use crate::robust::higher;

/// Result of the checks of one stream's samples.
#[derive(Default)]
pub(crate) struct SampleCheck {
    /// White noise of one sample, rad/s, per axis.
    pub(crate) noise: Vec3,
    /// Uncertainty of the stream's time that a fault leaves open, seconds.
    pub(crate) unresolved_s: f64,
    /// Faults that were found.
    pub(crate) faults: Vec<Fault>,
}

/// Checks the samples and clears `usable` where they are to be left out.
pub(crate) fn check(stream: Stream, samples: Samples<'_>, usable: &mut [bool]) -> SampleCheck {
    let mut out = SampleCheck::default();
    let fault = |kind, members| Fault::new(stream, kind, members, Action::LeftOut);

    let clipped = clipped(samples.w, usable);
    if !clipped.is_empty() {
        leave_out(usable, &clipped);
        out.faults.push(fault(FaultKind::Clipped, clipped));
    }

    let mut against = samples.predictions(usable);
    out.noise = noise_of(&against);

    let pairs = copies(samples.w, usable, &out.noise);
    if !pairs.is_empty() {
        let (stale, displacement_s) = stale_copies(samples, usable, &pairs, &out.noise);
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

    leave_out_displaced(stream, samples, usable, against, &mut out);
    out
}

/// Leaves out displaced classes, the most significant first. `against` are the
/// predictions of the usable samples.
fn leave_out_displaced(
    stream: Stream,
    samples: Samples<'_>,
    usable: &mut [bool],
    mut against: Vec<Against>,
    out: &mut SampleCheck,
) {
    let total = kept(usable).len();
    for _ in 0..12 {
        let Some(class) = classes::most_displaced(samples, usable, &against, &out.noise) else {
            break;
        };
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

/// Samples at a plateau of the largest or smallest value of an axis.
fn clipped(w: &[Vec3], usable: &[bool]) -> Vec<usize> {
    let mut hit = vec![false; w.len()];
    for axis in 0..3 {
        for sign in [1.0, -1.0] {
            let values = (0..w.len()).filter(|&k| usable[k]);
            let values = values.map(|k| (k, sign * w[k][axis]));
            let extreme = values.clone().map(|v| v.1).fold(0.0, higher);
            if extreme < 1.0 {
                continue;
            }
            let level = extreme * (1.0 - 1e-6);
            let top: Vec<usize> = values.filter(|v| v.1 >= level).map(|v| v.0).collect();
            let runs = top.chunk_by(|k, next| next - k == 1);
            let longest = runs.map(<[usize]>::len).max().unwrap_or(0);
            if longest >= 3 || (longest == 2 && top.len() >= 6) {
                for k in top {
                    hit[k] = true;
                }
            }
        }
    }
    (0..w.len()).filter(|&k| hit[k]).collect()
}

/// Neighbours that are equal to the bit where they should not be: (first, second).
///
/// A coarse or silent sensor gives equal neighbours by chance. How often is
/// estimated from how often single axes agree where the sample as a whole does
/// not. Only if there are clearly more equal neighbours than that, all of them
/// count; otherwise only those during motion that must have shown.
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

/// Samples of the copied pairs to leave out, and their staleness.
fn stale_copies(
    samples: Samples<'_>,
    usable: &[bool],
    pairs: &[(usize, usize)],
    noise: &Vec3,
) -> (Vec<usize>, Option<f64>) {
    let displacement = |pairs: &[(usize, usize)]| {
        let (mut top, mut bottom) = (0.0, 0.0);
        let against = samples.predictions_without(usable, pairs);
        for (a, variance) in against.iter().zip(local_variances(&against, noise)) {
            let (score, information) = a.score(&variance);
            top += score;
            bottom += information;
        }
        (top / bottom, 1.0 / f64::sqrt(bottom))
    };
    let reversed: Vec<(usize, usize)> = pairs.iter().map(|&(a, b)| (b, a)).collect();
    let (first, first_sigma) = displacement(pairs);
    let (second, second_sigma) = displacement(&reversed);
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
    fn a_clean_stream_is_clean() {
        let (t, w) = stream(|k| STEP * k as f64);
        let mut usable = vec![true; t.len()];
        let checked = check(Stream::B, samples(&t, &w), &mut usable);
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
        let checked = check(Stream::B, samples(&t, &w), &mut usable);
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
        let checked = check(Stream::B, samples(&t, &w), &mut usable);
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
        let checked = check(Stream::A, samples(&t, &w), &mut usable);
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
            check(Stream::A, samples(&t, &w), &mut usable)
                .faults
                .is_empty()
        );
    }
}
