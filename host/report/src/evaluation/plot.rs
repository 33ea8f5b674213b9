//! Plots of a result as SVG.

use evaluate::drift::EvaluatedDrift;
use evaluate::precision::Precision;
use evaluate::shown::Shown;
use evaluate::stats::quantile;

use crate::chart::{Chart, Data, Ink, stack};

/// Size of one chart, pixels.
const SIZE: (u32, u32) = (900, 380);
/// Points drawn of a long series.
const MAX_POINTS: usize = 2000;

const MEASURED: Ink = Ink::rgb(60, 60, 60);
const FITTED: Ink = Ink::rgb(214, 69, 40);
const MARK: Ink = Ink::rgb(20, 110, 180);

/// Averaged row profile, fit, and histogram over launches (with two or more).
#[must_use]
pub fn precision(precision: &Precision, shown: &Shown) -> String {
    let profile = profile(shown);
    let values: Vec<f64> = precision.recordings.iter().map(|r| r.bias_us).collect();
    if values.len() > 1 {
        stack(SIZE, &[profile, launches(&values)])
    } else {
        stack(SIZE, &[profile])
    }
}

/// Averaged row profile of the shown frames, and row against time with the line.
#[must_use]
pub fn drift(drift: &EvaluatedDrift) -> String {
    stack(SIZE, &[profile(&drift.shown), course(drift)])
}

fn profile(shown: &Shown) -> Chart {
    let points = |values: &[f64]| -> Vec<(f64, f64)> {
        let rows = values.iter().enumerate();
        rows.map(|(i, &v)| (shown.first_row + i as f64, v))
            .collect()
    };
    let flashes = shown.flashes.iter().map(|(k, row)| (*row, k.to_string()));
    Chart::new("sensor row", "grey level")
        .title("Mean brightness of rows, with the fitted train")
        .xs(shown.first_row..shown.first_row + shown.mean_profile.len() as f64)
        .add(
            "measured",
            Data::Points(points(&shown.mean_profile)),
            MEASURED.pale(0.5),
        )
        .add(
            "fitted",
            Data::Line(points(&shown.fitted_profile)),
            FITTED.wide(1),
        )
        .add(
            "flashes and middle row",
            Data::Marks(flashes.collect()),
            MARK,
        )
        .add(
            "",
            Data::Upright(vec![shown.middle_row]),
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
    let result = &drift.result;
    let place = |(time_s, bias_us): (f64, f64)| {
        let row = drift.shown.middle_row + bias_us / result.row_time_us;
        (time_s, row)
    };
    let every = drift.points.len().div_ceil(MAX_POINTS).max(1);
    let points = drift.points.iter().step_by(every).copied().map(place);
    let ends = drift.points.first().into_iter().chain(drift.points.last());
    let line = ends.zip(drift.line_us);
    let line = line.map(|(&(time_s, _), bias_us)| place((time_s, bias_us)));
    Chart::new("time, s", "sensor row")
        .title(&format!(
            "Row of the train's centre, depth minus phone: {:+.3} ± {:.3} µs/min",
            result.drift_us_per_min, result.drift_sigma_us_per_min
        ))
        .add("frames", Data::Points(points.collect()), MEASURED.pale(0.5))
        .add("regression", Data::Line(line.collect()), FITTED)
}
