//! Classes of samples that recur with a fixed period and belong to another time
//! than their timestamps say.

use crate::interpolant::Vec3;
use crate::neighbours::{Against, Samples, local_variances, noise_of};
use crate::robust;

/// Longest period that is looked for, in samples.
const LONGEST_PERIOD: usize = 64;
/// Significance that a displaced class must have.
const CLASS_Z: f64 = 8.0;
/// The same against the scatter of its members.
const CLASS_Z_SCATTER: f64 = 6.0;
/// So many of the most significant hypotheses are looked at.
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

/// The most significant displaced class among the usable samples, whose predictions are
/// `against`.
pub(crate) fn most_displaced(
    samples: Samples<'_>,
    usable: &[bool],
    against: &[Against],
) -> Option<Class> {
    let search_in = |against: &[Against], periods| {
        displaced_class(against, &noise_of(against), samples.step_s, periods)
    };
    let search = |usable: &[bool], periods| search_in(&samples.predictions(usable), periods);
    let class = search_in(against, 2..=LONGEST_PERIOD)?;
    if class.period > 2 {
        return Some(class);
    }
    // Every fourth (sixth, ...) sample displaced spoils every second prediction
    // and looks like period 2. If leaving out that class leaves nothing, it was it.
    for period in [4, 6, 8] {
        if let Some(finer) = search_in(against, period..=period) {
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

impl Sums {
    fn add(&mut self, other: &Self) {
        self.score += other.score;
        self.information += other.information;
        self.score_squared += other.score_squared;
        self.product += other.product;
        self.information_squared += other.information_squared;
        self.members += other.members;
    }
}

/// The sums of each phase of a period, over (index, score, information).
fn by_phase(scored: &[(usize, f64, f64)], period: usize) -> Vec<Sums> {
    let mut sums = vec![Sums::default(); period];
    let (mut before, mut phase) = (0, 0);
    for &(index, score, information) in scored {
        phase += index - before;
        before = index;
        while phase >= period {
            phase -= period;
        }
        sums[phase].add(&Sums {
            score,
            information,
            score_squared: score * score,
            product: score * information,
            information_squared: information * information,
            members: 1,
        });
    }
    sums
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
    let mut found: Vec<Hypothesis> = Vec::new();
    let mut longer: Vec<Vec<Sums>> = vec![Vec::new(); LONGEST_PERIOD + 1];
    for period in periods.rev() {
        // The phases of a multiple, folded, are those of the period itself.
        let multiple = LONGEST_PERIOD / period * period;
        if longer[multiple].is_empty() {
            longer[multiple] = by_phase(&scored, multiple);
        }
        let mut sums = longer[multiple][..period].to_vec();
        for more in longer[multiple][period..].chunks_exact(period) {
            for (sum, more) in sums.iter_mut().zip(more) {
                sum.add(more);
            }
        }
        for (phase, sum) in sums.iter().enumerate() {
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

/// Significance against even noise, against the scatter of the members; the class.
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
    let scatter = robust::mad_sigma(&values).filter(|_| values.len() > LONGEST_PERIOD);
    scatter.map_or(1.0, |sigma| sigma.max(1.0))
}
