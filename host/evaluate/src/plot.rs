//! Plots of a result as SVG.

use page::chart::{Chart, Data, Ink, stack};

use super::Settings;
use super::drift::EvaluatedDrift;
use super::footage::Footage;
use super::precision::{Evaluated, Precision, middle_row};
use super::stats::quantile;
use super::track::Track;

/// Size of one chart, pixels.
const SIZE: (u32, u32) = (900, 380);
/// Points drawn of a long series.
const MAX_POINTS: usize = 2000;

const MEASURED: Ink = Ink::rgb(60, 60, 60);
const FITTED: Ink = Ink::rgb(214, 69, 40);
const MARK: Ink = Ink::rgb(20, 110, 180);

/// Averaged row profile, fit, and histogram over launches (with two or more).
#[must_use]
pub fn precision(precision: &Precision, shown: &Evaluated, settings: &Settings) -> String {
    let profile = profile(&shown.footage, &shown.track, settings);
    let values: Vec<f64> = precision.recordings.iter().map(|r| r.bias_us).collect();
    if values.len() > 1 {
        stack(SIZE, &[profile, launches(&values)])
    } else {
        stack(SIZE, &[profile])
    }
}

/// Averaged row profile of the shown frames, and row against time with the line.
#[must_use]
pub fn drift(drift: &EvaluatedDrift, settings: &Settings) -> String {
    let profile = profile(&drift.footage, &drift.track, settings);
    stack(SIZE, &[profile, course(drift)])
}

/// Rows, from 0, where the flashes lie of a train with this bias, with their numbers from 1.
pub(crate) fn flash_rows(
    footage: &Footage,
    track: &Track,
    settings: &Settings,
    bias_us: f64,
) -> Vec<(u32, f64)> {
    let train = settings.train;
    let bias_us = bias_us + settings.path_delay_us;
    let middle = middle_row(footage);
    let first = footage.reducer.first_row() as f64;
    let last = first + footage.rows.len as f64;
    (0..train.count)
        .map(|k| {
            let row = middle + train.flash_us(k, bias_us) / track.joint.row_time_us;
            (k + 1, row)
        })
        .filter(|(_, row)| (first..last).contains(row))
        .collect()
}

fn profile(footage: &Footage, track: &Track, settings: &Settings) -> Chart {
    let first = footage.reducer.first_row() as f64;
    let points = |values: &[f64]| -> Vec<(f64, f64)> {
        let rows = values.iter().enumerate();
        rows.map(|(i, &v)| (first + i as f64, v)).collect()
    };
    let flashes = flash_rows(footage, track, settings, track.shown_bias_us);
    let flashes = flashes.into_iter().map(|(k, row)| (row, k.to_string()));
    Chart::new("sensor row", "grey level")
        .title("Mean brightness of rows, with the fitted train")
        .xs(first..first + footage.rows.len as f64)
        .add(
            "measured",
            Data::Points(points(&track.mean_profile)),
            MEASURED.pale(0.5),
        )
        .add(
            "fitted",
            Data::Line(points(&track.fitted_profile)),
            FITTED.wide(1),
        )
        .add(
            "flashes and middle row",
            Data::Marks(flashes.collect()),
            MARK,
        )
        .add(
            "",
            Data::Upright(vec![middle_row(footage)]),
            MARK.pale(0.4).wide(1),
        )
}

fn launches(values: &[f64]) -> Chart {
    let low = values.iter().copied().fold(f64::INFINITY, f64::min);
    let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let side = (0.1 * (high - low)).max(1e-6 * (1.0 + high.abs()));
    let (first, span) = (low - side, high - low + 2.0 * side);
    // Freedman and Diaconis' width of bins, between 5 and 40 of them.
    let quartile = |q| quantile(values, q).unwrap_or(0.0);
    let width = 2.0 * (quartile(0.75) - quartile(0.25)) / (values.len() as f64).cbrt();
    let bins = if width > 0.0 {
        (span / width).round().clamp(5.0, 40.0) as usize
    } else {
        5
    };
    let width = span / bins as f64;
    let mut counts = vec![0; bins];
    for v in values {
        let at = ((v - first) / width) as usize;
        if let Some(count) = counts.get_mut(at.min(bins - 1)) {
            *count += 1;
        }
    }
    let bins = Data::Bins {
        first,
        width,
        counts,
    };
    let quartiles = vec![quartile(0.25), quartile(0.75)];
    Chart::new("bias, µs", "launches")
        .title(&format!("Bias over {} launches", values.len()))
        .add("", bins, MARK.pale(0.25))
        .add("median", Data::Upright(vec![quartile(0.5)]), FITTED)
        .add("quartiles", Data::Upright(quartiles), MEASURED)
}

fn course(drift: &EvaluatedDrift) -> Chart {
    let row_time = drift.track.joint.row_time_us;
    let middle = middle_row(&drift.footage);
    let row = |bias: f64| middle + bias / row_time;
    let every = drift.points.len().div_ceil(MAX_POINTS).max(1);
    let points = drift.points.iter().step_by(every);
    let points = points.map(|p| (p.time_s, row(p.bias_us))).collect();
    let ends = drift.points.first().into_iter().chain(drift.points.last());
    let line = ends.map(|p| (p.time_s, row(drift.line.at(p.time_s))));
    Chart::new("time, s", "sensor row")
        .title(&format!(
            "Row of the train's centre, depth minus phone: {:+.3} ± {:.3} µs/min",
            drift.result.drift_us_per_min, drift.result.drift_sigma_us_per_min
        ))
        .add("frames", Data::Points(points), MEASURED.pale(0.5))
        .add("regression", Data::Line(line.collect()), FITTED)
}
