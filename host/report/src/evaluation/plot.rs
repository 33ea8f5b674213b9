//! Plots of a result as SVG.

use evaluate::drift::EvaluatedDrift;
use evaluate::precision::{Precision, RecordingResult};
use evaluate::shown::Shown;

use crate::chart::{Chart, Data, Ink, stack};

/// Size of one chart, pixels.
const SIZE: (u32, u32) = (900, 380);
/// Points drawn of a long series.
const MAX_POINTS: usize = 2000;

const MEASURED: Ink = Ink::rgb(60, 60, 60);
const FITTED: Ink = Ink::rgb(214, 69, 40);
const MARK: Ink = Ink::rgb(20, 110, 180);

/// Averaged row profile, fit, and the biases of launches (of two or more).
#[must_use]
pub(super) fn precision(precision: &Precision, shown: &Shown) -> String {
    let profile = profile(shown);
    match precision.recordings.as_slice() {
        [] | [_] => stack(SIZE, &[profile]),
        several => stack(SIZE, &[profile, launches(several)]),
    }
}

/// Averaged row profile of the shown frames, and row against time with the line.
#[must_use]
pub(super) fn drift(drift: &EvaluatedDrift) -> String {
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

/// The bias of each launch with its 1-sigma.
fn launches(recordings: &[RecordingResult]) -> Chart {
    let biases = (1..).map(f64::from).zip(recordings);
    let biases = biases.map(|(number, of)| (number, of.bias_us, of.sigma_us));
    Chart::new("recording", "bias, µs")
        .title(&format!("Bias of {} launches", recordings.len()))
        .add("", Data::Bars(biases.collect()), MEASURED)
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
