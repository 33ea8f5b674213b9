//! The coarse search for the position and the shape of the train in a frame.
//!
//! It is a matched filter. The brightness without its smooth part is correlated with
//! one flash's trapezoid on a grid of times; the comb of all flashes is then a sum
//! of as many grid values. The part of the frame's variance that the template explains,
//! `(T·y)² / |T|²` with the smooth part subtracted from both, measures the fit.
//! `|T|²` comes from correlations of the trapezoid with itself on the same
//! grid, so a whole search takes less than a millisecond for each frame.

use nalgebra::DVector;
use rayon::prelude::*;

use crate::train::linear::Basis;
use crate::train::{Shape, TrainGeometry, overlap};

/// Positions of the used rows, counted from the middle row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RowGrid {
    /// Position of the first used row, in rows.
    pub first: f64,
    /// Rows from one sample to the next: 1, or more for binned rows.
    pub step: f64,
    /// Number of samples.
    pub len: usize,
}

impl RowGrid {
    /// Returns the position of sample `i`.
    pub(crate) fn position(&self, i: usize) -> f64 {
        self.first + i as f64 * self.step
    }

    /// Returns the grid of means of `factor` neighbouring rows; remaining rows at the end
    /// are dropped.
    pub(crate) fn binned(&self, factor: usize) -> Self {
        Self {
            first: self.first + 0.5 * (factor as f64 - 1.0) * self.step,
            step: self.step * factor as f64,
            len: self.len / factor,
        }
    }
}

/// Means of `factor` neighbouring values.
fn bin(values: &[f64], factor: usize) -> Vec<f64> {
    values
        .chunks_exact(factor)
        .map(|c| c.iter().sum::<f64>() / factor as f64)
        .collect()
}

/// Result of a search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Found {
    /// The shape, on the search's grid.
    pub(crate) shape: Shape,
    /// Part of the sum of squares that the template explains.
    pub(crate) explained: f64,
}

/// A matched filter for one row time and exposure.
#[derive(Debug, Clone)]
pub(crate) struct CombSearch {
    rows: RowGrid,
    train: TrainGeometry,
    row_time_us: f64,
    exposure_us: f64,
    start_us: f64,
    step_us: f64,
    /// First row that each grid time reaches, and the trapezoid from there.
    reach: Vec<(usize, Vec<f64>)>,
    /// Candidates: (grid index of the first flash, may be negative; |T|²).
    candidates: Vec<(isize, f64)>,
    per_pitch: usize,
}

impl CombSearch {
    /// Prepares the search; times on a grid of about `step_us`.
    pub(crate) fn new(
        rows: RowGrid,
        train: &TrainGeometry,
        row_time_us: f64,
        exposure_us: f64,
        smooth: &Basis,
        step_us: f64,
    ) -> Self {
        let per_pitch = (train.pitch_us / step_us).ceil().max(2.0) as usize;
        let step_us = train.pitch_us / per_pitch as f64;
        let reach_us = 0.5 * (exposure_us + train.duration_us);
        let start_us = rows.first * row_time_us - reach_us;
        let span = (rows.len as f64 * rows.step) * row_time_us + 2.0 * reach_us;
        let steps = (span / step_us).ceil().max(1.0) as usize;
        let row_us = rows.step * row_time_us;
        let reach: Vec<(usize, Vec<f64>)> = (0..steps)
            .map(|i| {
                let u = start_us + i as f64 * step_us;
                let from = ((u - reach_us) / row_us - rows.first / rows.step)
                    .ceil()
                    .max(0.0) as usize;
                let until = ((u + reach_us) / row_us - rows.first / rows.step).floor();
                let until = (until + 1.0).clamp(0.0, rows.len as f64) as usize;
                let light = (from..until)
                    .map(|r| {
                        let distance = rows.position(r) * row_time_us - u;
                        overlap(distance, exposure_us, train.duration_us)
                    })
                    .collect();
                (from, light)
            })
            .collect();

        // Products of one flash with another `j` pitches later, and with the
        // smooth part.
        let neighbours = (2.0 * reach_us / train.pitch_us).floor() as usize;
        let products: Vec<Vec<f64>> = (0..=neighbours)
            .map(|j| {
                (0..steps)
                    .map(|i| match (reach.get(i), reach.get(i + j * per_pitch)) {
                        (Some(a), Some(b)) => shared(a, b),
                        _ => 0.0,
                    })
                    .collect()
            })
            .collect();
        let on_smooth: Vec<Vec<f64>> = smooth
            .columns()
            .column_iter()
            .map(|q| reach.iter().map(|r| on_rows(r, q.as_slice())).collect())
            .collect();

        let own = products.first().map(Vec::as_slice).unwrap_or_default();
        let whole = own.iter().copied().fold(0.0, f64::max);
        let count = train.count as usize;
        let sum = |values: &[f64], first: isize, flashes: usize| -> f64 {
            comb(values, first, per_pitch, flashes).sum()
        };
        let lowest = -((count.saturating_sub(2) * per_pitch) as isize);
        let candidates = (lowest..steps as isize)
            .filter_map(|first| {
                // At least two flashes in view, each with half of its light.
                let flashes = comb(own, first, per_pitch, count);
                if flashes.filter(|&&e| e >= 0.5 * whole).count() < 2 {
                    return None;
                }
                let mut energy = sum(own, first, count);
                for (j, values) in products.iter().enumerate().skip(1) {
                    energy += 2.0 * sum(values, first, count.saturating_sub(j));
                }
                for values in &on_smooth {
                    energy -= sum(values, first, count).powi(2);
                }
                (energy > 1e-3 * whole).then_some((first, energy))
            })
            .collect();
        Self {
            rows,
            train: *train,
            row_time_us,
            exposure_us,
            start_us,
            step_us,
            reach,
            candidates,
            per_pitch,
        }
    }

    /// Finds the best position of the train in `y`, a profile without its smooth part.
    ///
    /// If positions whole pitches away fit equally well, the one nearest to `near_us` is
    /// returned; `None` if no bright comb fits at all.
    pub(crate) fn best(&self, y: &[f64], near_us: f64) -> Option<Found> {
        debug_assert_eq!(y.len(), self.rows.len);
        let count = self.train.count as usize;
        let single: Vec<f64> = self.reach.iter().map(|r| on_rows(r, y)).collect();
        let scored: Vec<(f64, f64)> = self
            .candidates
            .iter()
            .map(|&(first, energy)| {
                let sum: f64 = comb(&single, first, self.per_pitch, count).sum();
                let bias = self.start_us
                    + first as f64 * self.step_us
                    + self.train.center_index() * self.train.pitch_us;
                (bias, if sum > 0.0 { sum * sum / energy } else { 0.0 })
            })
            .collect();
        let (best_bias, best) = scored
            .iter()
            .copied()
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .filter(|b| b.1 > 0.0)?;
        let whole_pitches = |bias: f64| {
            let pitches = (bias - best_bias) / self.train.pitch_us;
            (pitches - pitches.round()).abs() * self.train.pitch_us < 0.5 * self.step_us
        };
        let (bias_us, explained) = scored
            .into_iter()
            .filter(|&(bias, score)| score >= 0.99 * best && whole_pitches(bias))
            .min_by(|a, b| (a.0 - near_us).abs().total_cmp(&(b.0 - near_us).abs()))?;
        Some(Found {
            shape: Shape {
                bias_us,
                row_time_us: self.row_time_us,
                exposure_us: self.exposure_us,
            },
            explained,
        })
    }
}

/// Returns the grid's values at a comb's flashes; flashes outside of the grid are left out.
fn comb(
    values: &[f64],
    first: isize,
    per_pitch: usize,
    flashes: usize,
) -> impl Iterator<Item = &f64> {
    let before = first.min(0).unsigned_abs().div_ceil(per_pitch);
    let from = first + (before * per_pitch) as isize;
    let on_grid = values.get(from as usize..).unwrap_or_default();
    let flashes = flashes.saturating_sub(before);
    on_grid.iter().step_by(per_pitch).take(flashes)
}

fn on_rows((from, light): &(usize, Vec<f64>), y: &[f64]) -> f64 {
    y.get(*from..*from + light.len())
        .map_or(0.0, |rows| light.iter().zip(rows).map(|(l, y)| l * y).sum())
}

fn shared(a: &(usize, Vec<f64>), b: &(usize, Vec<f64>)) -> f64 {
    let from = a.0.max(b.0);
    let others = b.1.iter().skip(from - b.0);
    let both = a.1.iter().skip(from - a.0).zip(others);
    both.map(|(a, b)| a * b).sum()
}

/// Most shapes that a wide search returns.
const MOST_SHAPES: usize = 4;

/// Shapes that a wide search tries.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct WideSearch {
    /// Row times, µs.
    pub(crate) row_times_us: Vec<f64>,
    /// Exposures, µs.
    pub(crate) exposures_us: Vec<f64>,
    /// Expected position of the train, µs.
    pub(crate) near_us: f64,
}

impl WideSearch {
    /// Creates a search over all row times with which `sensor_rows` take 4 to 40 ms, and over
    /// exposures from 60 µs to 4.5 ms; a known value replaces the range.
    pub(crate) fn new(
        sensor_rows: usize,
        row_time_us: Option<f64>,
        exposure_us: Option<f64>,
        near_us: f64,
    ) -> Self {
        // A step of 0.9 % leaves a train's ends within a fifth of a flash.
        const STEP: f64 = 1.009;
        let ladder = |from: f64, to: f64, step: f64| {
            std::iter::successors(Some(from), move |v| Some(v * step))
                .take_while(move |&v| v <= to)
                .collect::<Vec<f64>>()
        };
        let rows = sensor_rows as f64;
        Self {
            row_times_us: row_time_us
                .map_or_else(|| ladder(4e3 / rows, 40e3 / rows, STEP), |t| vec![t]),
            exposures_us: exposure_us.map_or_else(|| ladder(60.0, 4.5e3, 1.6), |e| vec![e]),
            near_us,
        }
    }

    /// Returns the best few distinct shapes for each profile, best first. Profiles are on `rows`
    /// and without their smooth part.
    pub(crate) fn run(
        &self,
        rows: RowGrid,
        train: &TrainGeometry,
        profiles: &[DVector<f64>],
        smooth: &Basis,
    ) -> Vec<Vec<Found>> {
        // Bins of about a fifth of a flash at the usual row times.
        let factor = (rows.len / 270).max(1);
        let coarse = rows.binned(factor);
        let smooth = smooth.binned(factor);
        let binned = profiles.iter().map(|profile| {
            let mut y = DVector::from_vec(bin(profile.as_slice(), factor));
            smooth.remove_from(&mut y);
            y
        });
        let binned: Vec<DVector<f64>> = binned.collect();
        let step_us = 0.5 * train.duration_us.max(40.0);
        let of_each: Vec<Vec<Option<Found>>> = self
            .row_times_us
            .par_iter()
            .flat_map_iter(|&row_time| {
                let (smooth, binned) = (&smooth, &binned);
                self.exposures_us.iter().map(move |&exposure| {
                    let search =
                        CombSearch::new(coarse, train, row_time, exposure, smooth, step_us);
                    let best = |y: &DVector<f64>| search.best(y.as_slice(), self.near_us);
                    binned.iter().map(best).collect()
                })
            })
            .collect();
        (0..profiles.len())
            .map(|number| distinct(of_each.iter().filter_map(|all| *all.get(number)?).collect()))
            .collect()
    }
}

/// Returns the best few of distinct shapes.
fn distinct(mut found: Vec<Found>) -> Vec<Found> {
    found.sort_by(|a, b| b.explained.total_cmp(&a.explained));
    let mut kept: Vec<Found> = Vec::new();
    for f in found {
        let known = kept.iter().any(|k| {
            (k.shape.row_time_us / f.shape.row_time_us - 1.0).abs() < 0.03
                && (k.shape.exposure_us / f.shape.exposure_us).ln().abs() < 0.6
        });
        if !known {
            kept.push(f);
        }
        if kept.len() == MOST_SHAPES {
            break;
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::row_light;

    const ROWS: RowGrid = RowGrid {
        first: -539.5,
        step: 1.0,
        len: 1080,
    };

    #[test]
    fn energies_agree_with_templates_built_row_by_row() {
        for exposure in [80.0, 700.0, 3900.0] {
            let smooth = Basis::polynomials(ROWS.len, 5);
            let search = CombSearch::new(ROWS, &TrainGeometry::NFOV, 10.2, exposure, &smooth, 31.0);
            assert!(search.candidates.len() > 200);
            for &(first, energy) in search.candidates.iter().step_by(17) {
                let shape = Shape {
                    bias_us: search.start_us + first as f64 * search.step_us + 4.0 * 1575.0,
                    row_time_us: 10.2,
                    exposure_us: exposure,
                };
                let mut t = DVector::from_fn(ROWS.len, |i, _| {
                    row_light(&TrainGeometry::NFOV, &shape, ROWS.position(i)).value
                });
                smooth.remove_from(&mut t);
                let direct = t.norm_squared();
                assert!(
                    (energy - direct).abs() < 1e-6 * (1.0 + direct),
                    "{exposure}: {energy} and {direct}"
                );
            }
        }
    }
}
