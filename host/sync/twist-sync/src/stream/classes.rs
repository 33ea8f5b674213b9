//! Classes of samples that recur with a fixed period and belong to another time
//! than their timestamps say.

use std::ops::RangeInclusive;

use crate::robust;
use crate::signal::interpolant::Vec3;
use crate::signal::neighbours::{Against, Samples, local_variances, noise_of};

/// Longest period that is searched for, in samples.
const LONGEST_PERIOD: usize = 64;
/// Significance that a displaced class must have.
const CLASS_Z: f64 = 8.0;
/// Significance that it must have against the scatter of its members.
const CLASS_Z_SCATTER: f64 = 6.0;
/// Number of the most significant hypotheses that are examined.
const MOST_TRIED: usize = 8;
/// Least displacement of a class, as a part of the sampling step.
const CLASS_STEP: f64 = 0.04;

/// The samples number `phase`, `phase + period`, and so on.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Class {
    pub(crate) period: usize,
    pub(crate) phase: usize,
    pub(crate) displacement_s: f64,
}

/// Returns the most significant displaced class among the usable samples, whose predictions
/// are `against` and have this noise.
pub(crate) fn most_displaced(
    samples: Samples<'_>,
    usable: &[bool],
    against: &[Against],
    noise: &Vec3,
) -> Option<Class> {
    let search_in = |against: &[Against], noise: &Vec3, periods| {
        displaced_class(against, noise, samples.step_s, periods)
    };
    let class = search_in(against, noise, 2..=LONGEST_PERIOD)?;
    if class.period > 2 {
        return Some(class);
    }
    // Every fourth (sixth, ...) sample displaced spoils every second prediction
    // and looks like period 2. If leaving out that class leaves nothing, it was it.
    for period in [4, 6, 8] {
        if let Some(finer) = search_in(against, noise, period..=period) {
            let mut without = usable.to_vec();
            for k in (finer.phase..without.len()).step_by(finer.period) {
                without[k] = false;
            }
            let rest = samples.predictions(&without);
            if search_in(&rest, &noise_of(&rest), 2..=LONGEST_PERIOD).is_none() {
                return Some(finer);
            }
        }
    }
    Some(class)
}

/// The sums of the rows of each phase of a period.
fn by_phase<const N: usize>(rows: &[[f64; N]], period: usize) -> Vec<[f64; N]> {
    let mut sums = vec![[0.0; N]; period];
    for turn in rows.chunks(period) {
        for (sum, row) in sums.iter_mut().zip(turn) {
            for k in 0..N {
                sum[k] += row[k];
            }
        }
    }
    sums
}

/// Period, phase and sums of the rows of each class of these periods; `rows` has one row for
/// each sample.
fn summed<const N: usize>(
    rows: &[[f64; N]],
    periods: RangeInclusive<usize>,
) -> impl Iterator<Item = (usize, usize, [f64; N])> {
    let mut longer: Vec<Vec<[f64; N]>> = vec![Vec::new(); LONGEST_PERIOD + 1];
    periods.rev().flat_map(move |period| {
        // The phases of a multiple, folded, are those of the period itself.
        let multiple = LONGEST_PERIOD / period * period;
        if longer[multiple].is_empty() {
            longer[multiple] = by_phase(rows, multiple);
        }
        let sums = by_phase(&longer[multiple], period);
        let each = sums.into_iter().enumerate();
        each.map(move |(phase, sum)| (period, phase, sum))
    })
}

fn displaced_class(
    against: &[Against],
    noise: &Vec3,
    step_s: f64,
    periods: RangeInclusive<usize>,
) -> Option<Class> {
    // Score and information; zero where there is no prediction.
    let mut rows = vec![[0.0; 2]; against.last()?.index + 1];
    for (a, variance) in against.iter().zip(local_variances(against, noise)) {
        rows[a.index] = a.score(&variance).into();
    }
    let is_clear = |(_, _, [score, information]): (usize, usize, [f64; 2])| {
        score * score > CLASS_Z * CLASS_Z * information
            && score.abs() > CLASS_STEP * step_s * information
    };
    // In a good stream no class stands out, and this is all.
    if !summed(&rows, periods.clone()).any(is_clear) {
        return None;
    }
    // With the number, and the squares for the scatter of the scores themselves: a burst of
    // vibration is not the even noise that `z` assumes.
    let mut squares = vec![[0.0; 6]; rows.len()];
    for a in against {
        let [s, i] = rows[a.index];
        squares[a.index] = [s, i, 1.0, s * s, s * i, i * i];
    }
    let mut found: Vec<Hypothesis> = Vec::new();
    for (period, phase, [score, information, members, ss, si, ii]) in summed(&squares, periods) {
        if members < 8.0 || information <= 0.0 {
            continue;
        }
        let displacement_s = score / information;
        let z = score / information.sqrt();
        let scatter = ss - 2.0 * displacement_s * si + displacement_s * displacement_s * ii;
        let z_scatter = score / scatter.max(f64::MIN_POSITIVE).sqrt();
        let class = Class {
            period,
            phase,
            displacement_s,
        };
        found.push((z, z_scatter, class));
    }
    found.retain(|f| f.2.displacement_s.is_finite());
    let mut best: Vec<&Hypothesis> = found
        .iter()
        .filter(|(z, z_scatter, class)| {
            z.abs() > CLASS_Z
                && z_scatter.abs() > CLASS_Z_SCATTER
                && class.displacement_s.abs() > CLASS_STEP * step_s
        })
        .collect();
    best.sort_by(|x, y| y.0.abs().total_cmp(&x.0.abs()));
    let earned = |f: &&&Hypothesis| f.1.abs() > CLASS_Z_SCATTER * by_chance(&found, f.2.period);
    best.iter().take(MOST_TRIED).find(earned).map(|f| f.2)
}

/// Significance against even noise, significance against the scatter of the members, class.
type Hypothesis = (f64, f64, Class);

/// Scatter of the significance that the data show by chance, at least 1: that of the
/// classes whose period has no factor in common with this one, over which a class of
/// this period spreads evenly.
fn by_chance(found: &[Hypothesis], period: usize) -> f64 {
    let coprime = |other: usize| {
        let (mut a, mut b) = (period, other);
        while b != 0 {
            (a, b) = (b, a % b);
        }
        a == 1
    };
    let others = found.iter().filter(|f| coprime(f.2.period));
    let values: Vec<f64> = others.map(|f| f.1).collect();
    // A few hypotheses do not show it.
    if values.len() <= LONGEST_PERIOD {
        return 1.0;
    }
    robust::mad_sigma(values).map_or(1.0, |sigma| sigma.max(1.0))
}
