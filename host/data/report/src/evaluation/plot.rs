//! Plots of a result as SVG.

use evaluate::drift::EvaluatedDrift;
use evaluate::precision::RecordingResult;
use evaluate::shown::Shown;

use crate::chart::{AS_IT_IS, Data, counted, series};

/// Most points of a series.
const MAX_POINTS: usize = 2000;

/// Draws the mean row profile of some frames, with the fitted train.
#[must_use]
pub(super) fn profile(shown: &Shown) -> String {
    let points = |values: &[f64]| -> Vec<(f64, f64)> {
        let rows = values.iter().enumerate();
        rows.map(|(i, &v)| (shown.first_row + i as f64, v))
            .collect()
    };
    let all = shown.mean_profile.iter().chain(&shown.fitted_profile);
    let (low, high) = all.fold((f64::MAX, f64::MIN), |(low, high), &value| {
        (low.min(value), high.max(value))
    });
    let flashes = shown.flashes.iter().map(|&(_, row)| (row, high));
    let middle = [low, high].map(|level| (shown.middle_row, level));
    let all = vec![
        ("measured", Data::Points(points(&shown.mean_profile))),
        ("fitted", Data::Line(points(&shown.fitted_profile))),
        ("flashes", Data::Points(flashes.collect())),
        ("middle row", Data::Line(middle.to_vec())),
    ];
    series("sensor row", "grey level", AS_IT_IS, all)
}

/// Draws the bias of each recording with its 1-sigma.
#[must_use]
pub(super) fn launches(recordings: &[RecordingResult]) -> String {
    let biases = (1..).map(f64::from).zip(recordings);
    let biases = biases.map(|(number, of)| (number, of.unshifted_us(), of.sigma_us));
    let biases = Data::Bars(biases.collect());
    let labels = ["recording", "bias, µs"];
    counted(labels, [true, false], AS_IT_IS, vec![("", biases)])
}

/// Draws the train's position over time, with the fitted line.
#[must_use]
pub(super) fn course(drift: &EvaluatedDrift) -> String {
    let every = drift.points.len().div_ceil(MAX_POINTS).max(1);
    let points = drift.points.iter().step_by(every).copied();
    let ends = drift.points.first().into_iter().chain(drift.points.last());
    let line = ends.zip(drift.line_us);
    let line = line.map(|(&(time_s, _), bias_us)| (time_s, bias_us));
    let all = vec![
        ("frames", Data::Points(points.collect())),
        ("regression", Data::Line(line.collect())),
    ];
    series("time, s", "depth − phone, µs", AS_IT_IS, all)
}
