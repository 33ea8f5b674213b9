//! Coarse place of the LED's bands: all frames are stacked at their distance from the flashes.

use rayon::prelude::*;

use super::film::View;
use super::{Code, Expected, Place, READOUT_US};

/// Parts into which the picture is divided.
const PARTS: usize = 40;

/// Step of the stacked distance, µs.
const STEP_US: f64 = 250.0;

/// Step of the middle's candidates, µs.
const MIDDLE_STEP_US: f64 = 500.0;

/// Step of the readout's candidates, µs.
const READOUT_STEP_US: f64 = 750.0;

/// Candidates of the length of a band at half its height, µs: exposures up to 17 ms.
const LENGTHS_US: [f64; 8] = [
    500.0, 1_000.0, 2_000.0, 3_500.0, 6_000.0, 9_000.0, 13_000.0, 17_000.0,
];

/// Relative changes of the periods that no LED follows. The least lets the bands walk by a
/// period within a run.
const WRONG: [f64; 10] = [
    -0.037, -0.029, -0.022, -0.016, -0.011, 0.012, 0.017, 0.023, 0.031, 0.039,
];

/// Brightness against the distance from the flashes, summed over frames.
struct Stack {
    /// First distance, µs.
    from_us: f64,
    steps: usize,
    /// For each kind, part and step: sums of brightness over 1-sigma up to there, and their
    /// number.
    sums: Vec<(f64, f64)>,
}

/// Best score of bands at wrong periods.
pub(super) fn elsewhere(film: View<'_>, code: &Code, expected: &Expected) -> f64 {
    let wrong = WRONG.par_iter();
    let scores = wrong.map(|&by| find(film, &code.stretched(by), expected).0);
    scores.reduce(|| 0.0, f64::max)
}

/// Score of the bands at the weaker of the two periods, in 1-sigmas, and their place.
pub(super) fn find(film: View<'_>, code: &Code, expected: &Expected) -> (f64, Place) {
    let stack = Stack::new(film, code, expected);
    let rows = film.rows() as f64;
    let middles = (2.0 * expected.within_us / MIDDLE_STEP_US).ceil() as usize;
    let readouts = ((READOUT_US.1 - READOUT_US.0) / READOUT_STEP_US).ceil() as usize;
    let places = film.places();
    let part_of = |part: usize| {
        let (from, to) = part_bounds(part, places.len());
        let members = places.get(from..to).unwrap_or_default();
        members.iter().sum::<f64>() / members.len().max(1) as f64 / rows
    };
    let parts: Vec<f64> = (0..parts(places.len())).map(part_of).collect();
    let nothing = Place {
        middle_us: expected.middle_us,
        row_time_us: READOUT_US.0 / rows.max(1.0),
        exposure_us: 0.0,
    };
    if places.is_empty() {
        return (0.0, nothing);
    }
    let mut found = (0.0, nothing);
    for step in 0..=readouts {
        let size = READOUT_US.0 + READOUT_STEP_US * step as f64;
        for readout in [size, -size] {
            for middle in 0..=middles {
                let middle_us =
                    expected.middle_us - expected.within_us + MIDDLE_STEP_US * middle as f64;
                for length_us in LENGTHS_US {
                    let length_us = length_us.max(code.length_us);
                    let score = stack.score(&parts, middle_us, readout, length_us);
                    if score > found.0 {
                        let place = Place {
                            middle_us,
                            row_time_us: readout / rows,
                            exposure_us: length_us,
                        };
                        found = (score, place);
                    }
                }
            }
        }
    }
    found
}

/// Number of parts of so many groups of lines.
fn parts(groups: usize) -> usize {
    groups.min(PARTS)
}

fn part_bounds(part: usize, groups: usize) -> (usize, usize) {
    let count = parts(groups).max(1);
    (part * groups / count, (part + 1) * groups / count)
}

impl Stack {
    fn new(film: View<'_>, code: &Code, expected: &Expected) -> Self {
        let longest = LENGTHS_US.into_iter().fold(code.length_us, f64::max);
        let reach = expected.within_us + 0.5 * (READOUT_US.1 + longest) + STEP_US;
        let from_us = expected.middle_us - reach;
        let steps = (2.0 * reach / STEP_US).ceil() as usize + 1;
        let groups = film.places().len();
        let count = parts(groups);
        let sigmas = film.sigmas();
        let mut sums = vec![(0.0, 0.0); 2 * count * steps];
        let mut of_parts = vec![0.0; count];
        for (at_us, light) in film.frames() {
            for (part, to) in of_parts.iter_mut().enumerate() {
                let (from, until) = part_bounds(part, groups);
                let light = light.get(from..until).unwrap_or_default();
                let sigmas = sigmas.get(from..until).unwrap_or_default();
                // Single groups that something bright crosses count no more than others.
                let each = light.iter().zip(sigmas);
                let each = each.map(|(&value, sigma)| (f64::from(value) / sigma).clamp(-5.0, 5.0));
                *to = each.sum::<f64>() / light.len().max(1) as f64;
            }
            for flash in code.within(at_us + from_us, at_us + from_us + 2.0 * reach) {
                let step = ((flash.middle_us - at_us - from_us) / STEP_US) as usize;
                for (part, value) in of_parts.iter().enumerate() {
                    if let Some(sum) = sums.get_mut((flash.kind * count + part) * steps + step) {
                        sum.0 += value;
                        sum.1 += 1.0;
                    }
                }
            }
        }
        // Sums up to each step.
        for row in sums.chunks_exact_mut(steps.max(1)) {
            let mut total = (0.0, 0.0);
            for sum in row {
                total = (total.0 + sum.0, total.1 + sum.1);
                *sum = total;
            }
        }
        Self {
            from_us,
            steps,
            sums,
        }
    }

    /// Score of the weaker kind for bands at a place: the mean over the parts of the picture, in
    /// 1-sigmas of noise that is the same in all lines.
    fn score(&self, parts: &[f64], middle_us: f64, readout_us: f64, length_us: f64) -> f64 {
        let count = parts.len();
        let kind = |kind: usize| {
            let mut total = 0.0;
            for (part, place) in parts.iter().enumerate() {
                let from = middle_us + place * readout_us - 0.5 * length_us - self.from_us;
                let row = (kind * count + part) * self.steps;
                let at = |us: f64| {
                    let step = ((us / STEP_US).round() as usize).min(self.steps) as isize - 1;
                    usize::try_from(step)
                        .ok()
                        .and_then(|step| self.sums.get(row + step))
                        .copied()
                        .unwrap_or_default()
                };
                let (low, high) = (at(from), at(from + length_us));
                let number = high.1 - low.1;
                if number > 0.0 {
                    total += (high.0 - low.0) / number.sqrt();
                }
            }
            total / (count.max(1) as f64).sqrt()
        };
        kind(0).min(kind(1))
    }
}
