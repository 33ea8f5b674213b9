//! Least squares of the bands in all rows of all frames.
//!
//! Each group of lines has a height and a level of its own, which are eliminated; what is left
//! are the middle, the row time and the exposure. Parts of the recording are kept apart, so that
//! results without one of them give the 1-sigmas: errors that neighbouring rows or frames share
//! (an encoder's, a timestamp's, a moving hand's) are in them.

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::film::{View, subtract_neighbours};
use super::{Code, Place};

/// Parts of the recording that are left out in turn.
const BLOCKS: usize = 12;

/// Iterations with bands of wide slopes, which reach a coarse place, and with their own slopes.
const ROUNDS: [usize; 2] = [8, 120];

/// Shortest exposure of the former, µs.
const WIDE_US: f64 = 1_000.0;

/// Largest step of the last round, µs.
const SETTLED_US: f64 = 0.01;

/// Residuals beyond this many 1-sigmas have no weight (Tukey's biweight).
const OUTLIER: f64 = 6.0;

/// Errors of the model that have weight, as parts of a band's height, in the rounds with wide
/// slopes and with their own: a tone curve bends the slopes by up to 0.15.
const MODEL_ERROR: [f64; 2] = [0.5, 0.05];

/// Largest step of the middle and of the exposure in a round, µs.
const MOST_STEP_US: f64 = 400.0;

/// Result of the fit.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fitted {
    pub(super) place: Place,
    /// 1-sigmas of the middle and of the row time, µs.
    pub(super) sigmas: [f64; 2],
    /// Difference of the middle at the longer and at the shorter period, and its 1-sigma, µs.
    pub(super) disagreement_us: [f64; 2],
}

/// Normal equations of a part of the recording.
#[derive(Clone, Copy, Default)]
struct Normal {
    matrix: Matrix3<f64>,
    vector: Vector3<f64>,
}

impl Normal {
    fn plus(self, other: Self) -> Self {
        Self {
            matrix: self.matrix + other.matrix,
            vector: self.vector + other.vector,
        }
    }

    fn minus(self, other: Self) -> Self {
        Self {
            matrix: self.matrix - other.matrix,
            vector: self.vector - other.vector,
        }
    }

    /// The same with the exposure held.
    fn without_exposure(mut self) -> Self {
        self.matrix.fill_row(2, 0.0);
        self.matrix.fill_column(2, 0.0);
        self.matrix[(2, 2)] = 1.0;
        self.vector[2] = 0.0;
        self
    }

    /// The step that the equations ask for; `None` if they do not determine it.
    fn step(self) -> Option<Vector3<f64>> {
        let step = self.matrix.cholesky()?.solve(&self.vector);
        step.iter().all(|value| value.is_finite()).then_some(step)
    }
}

/// The film, with what does not change between rounds.
struct Data<'a> {
    film: View<'a>,
    code: &'a Code,
    /// Part of the recording to which each frame belongs, the two kinds of runs in turn.
    blocks: Vec<usize>,
}

/// Fits the place of the bands from a coarse one on.
pub(super) fn fit(film: View<'_>, code: &Code, mut place: Place) -> Fitted {
    let data = Data::new(film, code);
    let mut sigmas = film.sigmas().to_vec();
    let mut blocks = Vec::new();
    place.exposure_us = place.exposure_us.max(WIDE_US);
    for round in 0..ROUNDS.iter().sum() {
        let is_wide = round < ROUNDS[0];
        blocks = data.normals(&place, &mut sigmas, MODEL_ERROR[usize::from(!is_wide)]);
        let mut all = blocks.iter().copied().fold(Normal::default(), Normal::plus);
        if is_wide {
            all = all.without_exposure();
        }
        let Some(step) = all.step() else { break };
        let limited = step[0].abs().max(step[2].abs()) / MOST_STEP_US;
        place = place.moved(step / limited.max(1.0));
        let of_rows = 0.5 * film.rows() as f64 * step[1].abs();
        if !is_wide && of_rows.max(limited * MOST_STEP_US) < SETTLED_US {
            break;
        }
    }
    let all = blocks.iter().copied().fold(Normal::default(), Normal::plus);
    let rest = |place: usize| blocks.get(place).map(|&block| all.minus(block));
    let steps: Vec<Vector3<f64>> = (0..blocks.len())
        .filter_map(|place| rest(place)?.step())
        .collect();
    let count = steps.len() as f64;
    let mean = steps.iter().sum::<Vector3<f64>>() / count.max(1.0);
    let spread = steps
        .iter()
        .map(|step| (step - mean).component_mul(&(step - mean)));
    let spread = spread.sum::<Vector3<f64>>() * ((count - 1.0) / count);
    let kind = |kind: usize| {
        let of_kind = blocks.iter().skip(kind).step_by(2).copied();
        let of_kind: Vec<Normal> = of_kind.collect();
        let sum = of_kind
            .iter()
            .copied()
            .fold(Normal::default(), Normal::plus);
        let middle = sum.step().map(|step| step[0])?;
        let steps: Vec<f64> = of_kind
            .iter()
            .filter_map(|&block| Some(sum.minus(block).step()?[0]))
            .collect();
        let count = steps.len() as f64;
        let mean = steps.iter().sum::<f64>() / count;
        let squares: f64 = steps.iter().map(|step| (step - mean).powi(2)).sum();
        Some((middle, squares * (count - 1.0) / count))
    };
    let disagreement_us = match (kind(0), kind(1)) {
        (Some((short, of_short)), Some((long, of_long))) => {
            [long - short, (of_short + of_long).sqrt()]
        }
        _ => [f64::INFINITY, 0.0],
    };
    let sigma = |place: usize| {
        let variance = if count > 2.0 { spread[place] } else { f64::NAN };
        variance.sqrt()
    };
    Fitted {
        place,
        sigmas: [sigma(0), sigma(1)],
        disagreement_us,
    }
}

impl Place {
    /// Moves by a step of middle, row time and exposure; an exposure stays positive.
    fn moved(self, step: Vector3<f64>) -> Self {
        Self {
            middle_us: self.middle_us + step[0],
            row_time_us: self.row_time_us + step[1],
            exposure_us: (self.exposure_us + step[2])
                .max(0.5 * self.exposure_us)
                .max(10.0),
        }
    }

    /// Shape of a band at a distance from its middle, 1 at its height, and its derivatives by
    /// that distance and by the exposure.
    fn shape(self, distance_us: f64, length_us: f64) -> [f64; 3] {
        let (least, exposure) = (self.exposure_us.min(length_us), self.exposure_us);
        let ramp = 0.5 * (exposure + length_us) - distance_us.abs();
        if ramp >= least {
            return [1.0, 0.0, 0.0];
        }
        if ramp <= 0.0 {
            return [0.0; 3];
        }
        let by_exposure = if exposure < length_us {
            0.5 / least - ramp / (least * least)
        } else {
            0.5 / least
        };
        [ramp / least, -distance_us.signum() / least, by_exposure]
    }
}

impl<'a> Data<'a> {
    fn new(film: View<'a>, code: &'a Code) -> Self {
        let times = film.times_us();
        let first = times.first().copied().unwrap_or_default();
        let length = times.last().copied().unwrap_or_default() - first;
        let block = |&at: &f64| {
            let part = (at - first) / length.max(1.0) * BLOCKS as f64;
            let kind = code.last_before(at).map_or(0, |flash| flash.kind);
            2 * (part as usize).min(BLOCKS - 1) + kind
        };
        Self {
            film,
            code,
            blocks: times.iter().map(block).collect(),
        }
    }

    /// Normal equations of each part of the recording, the two kinds in turn; renews the
    /// 1-sigmas of the groups.
    fn normals(&self, place: &Place, sigmas: &mut [f64], model: f64) -> Vec<Normal> {
        let rows = self.film.places().par_iter();
        let groups = rows.zip(sigmas.par_iter_mut()).enumerate();
        let each =
            groups.map(|(group, (&row, sigma))| self.of_group(group, row, place, sigma, model));
        each.reduce(
            || vec![Normal::default(); 2 * BLOCKS],
            |mut sum, blocks| {
                for (sum, block) in sum.iter_mut().zip(blocks) {
                    *sum = sum.plus(block);
                }
                sum
            },
        )
    }

    /// The same of one group of lines.
    fn of_group(
        &self,
        group: usize,
        row: f64,
        place: &Place,
        sigma: &mut f64,
        model: f64,
    ) -> Vec<Normal> {
        // The bands as the film has them: less the mean of the neighbouring frames.
        let times = self.film.times_us();
        let mut columns: [Vec<f64>; 4] = std::array::from_fn(|_| Vec::with_capacity(times.len()));
        for at in times {
            let exposed = at + place.middle_us + row * place.row_time_us;
            let shape = self.code.nearest(exposed).map_or([0.0; 3], |flash| {
                place.shape(flash.middle_us - exposed, self.code.length_us)
            });
            let [value, by_distance, by_exposure] = shape;
            let values = [value, -by_distance, -by_distance * row, by_exposure];
            for (column, value) in columns.iter_mut().zip(values) {
                column.push(value);
            }
        }
        columns
            .iter_mut()
            .for_each(|column| subtract_neighbours(column));
        let [shape, by_middle, by_row_time, by_exposure] = columns;
        let light: Vec<f64> = self.film.group(group).collect();
        let plain = Line::fitted(&shape, &light, |_| 1.0);
        let scale = sigma.hypot(model * plain.height);
        let of_plain = |frame: usize| weight(plain.rest(&shape, &light, frame), scale);
        let line = Line::fitted(&shape, &light, of_plain);
        let slopes: Vec<Vector3<f64>> = (0..shape.len())
            .map(|frame| Vector3::new(by_middle[frame], by_row_time[frame], by_exposure[frame]))
            .collect();
        let mut blocks = vec![Normal::default(); 2 * BLOCKS];
        if line.height <= 0.0 {
            return blocks;
        }
        let weights: Vec<f64> = (0..shape.len())
            .map(|frame| weight(line.rest(&shape, &light, frame), scale))
            .collect();
        // Without what height and level take up.
        let total: f64 = weights.iter().sum();
        let weighted = weights.iter().zip(&slopes);
        let mean = weighted
            .map(|(&weight, slopes)| slopes * weight)
            .sum::<Vector3<f64>>()
            / total;
        let along = (0..shape.len())
            .map(|frame| slopes[frame] * (weights[frame] * (shape[frame] - line.mean)))
            .sum::<Vector3<f64>>()
            / line.variance;
        let mut squares = 0.0;
        for (frame, &weight) in weights.iter().enumerate() {
            let rest = line.rest(&shape, &light, frame);
            squares += weight * rest * rest;
            let free = slopes[frame] - mean - along * (shape[frame] - line.mean);
            let free = free * line.height;
            let certainty = weight / (*sigma * *sigma);
            if let Some(block) = self.blocks.get(frame).and_then(|&at| blocks.get_mut(at)) {
                block.matrix += free * free.transpose() * certainty;
                block.vector += free * (rest * certainty);
            }
        }
        *sigma = (squares / total).sqrt().max(1e-6);
        blocks
    }
}

/// Height and level of the bands in a group of lines.
struct Line {
    height: f64,
    level: f64,
    /// Weighted mean of the shape.
    mean: f64,
    /// Its variance about that, times the weight.
    variance: f64,
}

impl Line {
    fn fitted(shape: &[f64], light: &[f64], weight: impl Fn(usize) -> f64) -> Self {
        let (mut total, mut of_shape, mut of_light) = (0.0, 0.0, 0.0);
        let (mut squares, mut both) = (0.0, 0.0);
        for (frame, (&shape, &light)) in shape.iter().zip(light).enumerate() {
            let weight = weight(frame);
            total += weight;
            of_shape += weight * shape;
            of_light += weight * light;
            squares += weight * shape * shape;
            both += weight * shape * light;
        }
        let mean = of_shape / total.max(1e-9);
        let variance = squares - of_shape * mean;
        // A band is brighter than the rest.
        let height = if variance > 1e-6 * total && total > 4.0 {
            ((both - of_light * mean) / variance).max(0.0)
        } else {
            0.0
        };
        Self {
            height,
            level: (of_light - height * of_shape) / total.max(1e-9),
            mean,
            variance,
        }
    }

    /// Brightness that the bands leave unexplained in a frame.
    fn rest(&self, shape: &[f64], light: &[f64], frame: usize) -> f64 {
        light[frame] - self.level - self.height * shape[frame]
    }
}

/// Tukey's biweight of a residual.
fn weight(residual: f64, sigma: f64) -> f64 {
    let size = residual / (OUTLIER * sigma.max(1e-9));
    (1.0 - size * size).max(0.0).powi(2)
}
