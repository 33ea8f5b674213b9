//! Classes of samples that recur with a fixed period and belong to another time
//! than their timestamps say.

use crate::neighbours::{Against, Samples, local_variances, noise_of};
use crate::robust;
use crate::interpolant::Vec3;

/// Longest period that is looked for, in samples.
const LONGEST_PERIOD: usize = 64;
/// Significance that a displaced class must have.
const CLASS_Z: f64 = 8.0;
/// The same against the scatter of its members.
const CLASS_Z_SCATTER: f64 = 6.0;
/// Least displacement of a class, as a part of the sampling step.
const CLASS_STEP: f64 = 0.04;

/// The samples number `phase`, `phase + period`, and so on.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Class {
    pub(crate) period: usize,
    pub(crate) phase: usize,
    pub(crate) displacement_s: f64,
}

/// The most significant displaced class among the usable samples.
pub(crate) fn most_displaced(samples: Samples<'_>, usable: &[bool]) -> Option<Class> {
    let search = |usable: &[bool], periods| {
        let against = samples.predictions(usable);
        let noise = noise_of(&against);
        displaced_class(&against, &noise, samples.step_s, periods)
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
            let (score, information) = a.score(&variance);
            (a.index, score, information)
        })
        .collect();
    let mut found: Vec<(f64, f64, Class)> = Vec::new();
    let mut sums = [Sums::default(); LONGEST_PERIOD];
    for period in periods {
        sums[..period].fill(Sums::default());
        let (mut before, mut phase) = (0, 0);
        for &(index, score, information) in &scored {
            phase += index - before;
            before = index;
            while phase >= period {
                phase -= period;
            }
            let sum = &mut sums[phase];
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
            let z = sum.score / sum.information.sqrt();
            // Significance from the scatter of the scores themselves: a burst of
            // vibration is not the even noise that `z` assumes.
            let scatter = sum.score_squared - 2.0 * displacement_s * sum.product
                + displacement_s * displacement_s * sum.information_squared;
            let z_scatter = sum.score / scatter.max(f64::MIN_POSITIVE).sqrt();
            let class = Class {
                period,
                phase,
                displacement_s,
            };
            found.push((z, z_scatter, class));
        }
    }
    // Chance is what the hypotheses themselves show: nearly all of them are none.
    let by_chance = |of: fn(&(f64, f64, Class)) -> f64| {
        let values: Vec<f64> = found.iter().map(of).collect();
        // A few hypotheses do not show it.
        let enough = values.len() > LONGEST_PERIOD;
        let scatter = robust::mad_sigma(&values).filter(|_| enough);
        scatter.map_or(1.0, |sigma| sigma.max(1.0))
    };
    let z_limit = CLASS_Z * by_chance(|f| f.0);
    let scatter_limit = CLASS_Z_SCATTER * by_chance(|f| f.1);
    found
        .into_iter()
        .filter(|(z, z_scatter, class)| {
            z.abs() > z_limit
                && z_scatter.abs() > scatter_limit
                && class.displacement_s.abs() > CLASS_STEP * step_s
        })
        .max_by(|x, y| x.0.abs().total_cmp(&y.0.abs()))
        .map(|(.., class)| class)
}
