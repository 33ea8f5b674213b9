//! Pictures of a result as SVG.

use plotters::coord::Shift;
use plotters::prelude::*;

use super::EvaluateError;
use super::drift::EvaluatedDrift;
use super::paper;
use super::precision::{Evaluated, Precision, middle_row};
use super::recording::Recording;
use super::stats::quantile;
use super::track::Track;
use super::train::TrainGeometry;

/// Size of one picture, pixels.
const WIDTH: u32 = 900;
const HEIGHT: u32 = 380;
/// Size of type: to be read when the picture is shrunk to a phone's width.
const LABEL: i32 = 20;
/// Points drawn of a long series.
const MAX_POINTS: usize = 2000;

const MEASURED: RGBColor = RGBColor(60, 60, 60);
const FITTED: RGBColor = RGBColor(214, 69, 40);
const MARK: RGBColor = RGBColor(20, 110, 180);

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Panel<'p> = dyn Fn(&Area<'_>) -> Result<(), EvaluateError> + 'p;

fn plot_error(error: impl std::fmt::Display) -> EvaluateError {
    EvaluateError::Plot(error.to_string())
}

/// Draws pictures one below the other into one SVG document.
fn draw(panels: &[&Panel<'_>]) -> Result<String, EvaluateError> {
    let mut svg = String::new();
    {
        let size = (WIDTH, HEIGHT * panels.len() as u32);
        let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        root.fill(&WHITE).map_err(plot_error)?;
        for (area, panel) in root.split_evenly((panels.len(), 1)).iter().zip(panels) {
            panel(area)?;
        }
        root.present().map_err(plot_error)?;
    }
    Ok(svg)
}

/// Averaged row profile, fit, and histogram over launches (with two or more).
pub fn precision(
    precision: &Precision,
    shown: &Evaluated,
    train: &TrainGeometry,
    path_delay_us: f64,
) -> Result<String, EvaluateError> {
    let profile =
        |area: &Area<'_>| profile_panel(area, &shown.recording, &shown.track, train, path_delay_us);
    let values: Vec<f64> = precision.recordings.iter().map(|r| r.bias_us).collect();
    let histogram = |area: &Area<'_>| histogram_panel(area, &values);
    if values.len() > 1 {
        draw(&[&profile, &histogram])
    } else {
        draw(&[&profile])
    }
}

/// Averaged row profile of the first frames, and row against time with the line.
pub fn drift(
    drift: &EvaluatedDrift,
    train: &TrainGeometry,
    path_delay_us: f64,
) -> Result<String, EvaluateError> {
    draw(&[
        &|area: &Area<'_>| {
            profile_panel(area, &drift.recording, &drift.track, train, path_delay_us)
        },
        &|area: &Area<'_>| drift_panel(area, drift),
    ])
}

/// Rows, from 0, where the flashes of a track lie, with their numbers from 1.
pub fn flash_rows(
    recording: &Recording,
    track: &Track,
    train: &TrainGeometry,
    bias_us: f64,
) -> Vec<(u32, f64)> {
    let middle = middle_row(recording);
    let first = recording.reducer.first_row() as f64;
    let last = first + recording.rows.len as f64;
    (0..train.count)
        .map(|k| {
            let row = middle + train.flash_us(k, bias_us) / track.joint.row_time_us;
            (k + 1, row)
        })
        .filter(|(_, row)| (first..last).contains(row))
        .collect()
}

fn range(values: impl Iterator<Item = f64>, margin: f64) -> std::ops::Range<f64> {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for v in values.filter(|v| v.is_finite()) {
        low = low.min(v);
        high = high.max(v);
    }
    if low > high {
        return 0.0..1.0;
    }
    let extra = (margin * (high - low)).max(1e-6 * (1.0 + high.abs()));
    low - extra..high + extra
}

fn profile_panel(
    area: &Area<'_>,
    recording: &Recording,
    track: &Track,
    train: &TrainGeometry,
    path_delay_us: f64,
) -> Result<(), EvaluateError> {
    let first = recording.reducer.first_row() as f64;
    let smooth = paper::smooth(&track.mean_profile);
    let x = first..first + recording.rows.len as f64;
    let rest = head(
        area,
        "Mean brightness of rows, with the fitted train",
        &[
            ("measured", MEASURED, Sign::Dot),
            ("fitted", FITTED, Sign::Line),
            ("flashes and middle row", MARK, Sign::Line),
        ],
    )?;
    let mut y = range(smooth.iter().chain(&track.fitted_profile).copied(), 0.08);
    y.end += 0.08 * (y.end - y.start);
    let top = y.end;
    let span = y.end - y.start;
    let mut chart = ChartBuilder::on(&rest)
        .margin(10)
        .margin_top(0)
        .x_label_area_size(52)
        .y_label_area_size(76)
        .build_cartesian_2d(x, y)
        .map_err(plot_error)?;
    chart
        .configure_mesh()
        .label_style(("sans-serif", LABEL))
        .axis_desc_style(("sans-serif", LABEL))
        .x_desc("sensor row")
        .y_desc("grey level")
        .x_label_formatter(&|v| format!("{v:.0}"))
        .light_line_style(WHITE)
        .draw()
        .map_err(plot_error)?;
    let points = |values: &[f64]| -> Vec<(f64, f64)> {
        values
            .iter()
            .enumerate()
            .map(|(i, &v)| (first + i as f64, v))
            .collect()
    };
    chart
        .draw_series(
            points(&track.mean_profile)
                .into_iter()
                .map(|p| Circle::new(p, 2, MEASURED.mix(0.5).filled())),
        )
        .map_err(plot_error)?;
    chart
        .draw_series(LineSeries::new(points(&track.fitted_profile), FITTED))
        .map_err(plot_error)?;
    let bias = track.shown_bias_us + path_delay_us;
    let rows = flash_rows(recording, track, train, bias);
    chart
        .draw_series(rows.iter().map(|&(number, row)| {
            EmptyElement::at((row, top - 0.02 * span))
                + TriangleMarker::new((0, 12), 5, MARK.filled())
                + Text::new(number.to_string(), (-4, -6), ("sans-serif", LABEL))
        }))
        .map_err(plot_error)?;
    let middle = middle_row(recording);
    let bottom = top - span;
    chart
        .draw_series([PathElement::new(
            [(middle, bottom), (middle, top)],
            MARK.mix(0.6),
        )])
        .map_err(plot_error)?;
    Ok(())
}

/// How an entry of a legend looks.
#[derive(Clone, Copy)]
enum Sign {
    Line,
    Dot,
}

/// The space above a chart for its title and legend, pixels.
const HEAD: u32 = 58;

/// Writes title and legend into the head of a picture and leaves the rest for the
/// chart.
fn head<'a>(
    area: &Area<'a>,
    title: &str,
    entries: &[(&str, RGBColor, Sign)],
) -> Result<Area<'a>, EvaluateError> {
    let (top, rest) = area.split_vertically(HEAD);
    top.draw(&Text::new(
        title.to_owned(),
        (70, 12),
        ("sans-serif", 20).into_font(),
    ))
    .map_err(plot_error)?;
    let mut x = 70;
    for &(name, color, sign) in entries {
        match sign {
            Sign::Line => top.draw(&PathElement::new(
                [(x, 46), (x + 18, 46)],
                color.stroke_width(2),
            )),
            Sign::Dot => top.draw(&Circle::new((x + 9, 46), 3, color.filled())),
        }
        .map_err(plot_error)?;
        top.draw(&Text::new(
            name.to_owned(),
            (x + 24, 38),
            ("sans-serif", LABEL).into_font(),
        ))
        .map_err(plot_error)?;
        x += 48 + 10 * name.chars().count() as i32;
    }
    Ok(rest)
}

fn histogram_panel(area: &Area<'_>, values: &[f64]) -> Result<(), EvaluateError> {
    let x = range(values.iter().copied(), 0.1);
    // Freedman and Diaconis' width of bins, between 5 and 40 of them.
    let iqr = quantile(values, 0.75).unwrap_or(0.0) - quantile(values, 0.25).unwrap_or(0.0);
    let width = 2.0 * iqr / (values.len() as f64).cbrt();
    let span = x.end - x.start;
    let bins = if width > 0.0 {
        (span / width).round().clamp(5.0, 40.0) as usize
    } else {
        5
    };
    let width = span / bins as f64;
    let mut counts = vec![0u32; bins];
    for v in values {
        let at = ((v - x.start) / width) as usize;
        if let Some(c) = counts.get_mut(at.min(bins - 1)) {
            *c += 1;
        }
    }
    let highest = f64::from(counts.iter().copied().max().unwrap_or(1)) + 0.5;
    let start = x.start;
    let rest = head(
        area,
        &format!("Bias over {} launches", values.len()),
        &[
            ("median", FITTED, Sign::Line),
            ("quartiles", MEASURED, Sign::Line),
        ],
    )?;
    let mut chart = ChartBuilder::on(&rest)
        .margin(10)
        .margin_top(0)
        .x_label_area_size(52)
        .y_label_area_size(76)
        .build_cartesian_2d(x, 0.0..highest)
        .map_err(plot_error)?;
    chart
        .configure_mesh()
        .label_style(("sans-serif", LABEL))
        .axis_desc_style(("sans-serif", LABEL))
        .x_desc("bias, µs")
        .y_desc("launches")
        .y_labels((highest as usize + 1).min(10))
        .y_label_formatter(&|v| {
            if (v - v.round()).abs() < 1e-6 {
                format!("{v:.0}")
            } else {
                String::new()
            }
        })
        .light_line_style(WHITE)
        .draw()
        .map_err(plot_error)?;
    chart
        .draw_series(counts.iter().enumerate().map(|(i, &c)| {
            let left = start + i as f64 * width;
            Rectangle::new(
                [
                    (left + 0.04 * width, 0.0),
                    (left + 0.96 * width, f64::from(c)),
                ],
                MARK.mix(0.75).filled(),
            )
        }))
        .map_err(plot_error)?;
    for (q, color) in [(0.25, MEASURED), (0.5, FITTED), (0.75, MEASURED)] {
        let Some(at) = quantile(values, q) else {
            continue;
        };
        chart
            .draw_series([PathElement::new(
                [(at, 0.0), (at, highest)],
                color.stroke_width(2),
            )])
            .map_err(plot_error)?;
    }
    Ok(())
}

fn drift_panel(area: &Area<'_>, drift: &EvaluatedDrift) -> Result<(), EvaluateError> {
    let row_time = drift.track.joint.row_time_us;
    let middle = middle_row(&drift.recording);
    let row = |bias: f64| middle + bias / row_time;
    let every = drift.points.len().div_ceil(MAX_POINTS).max(1);
    let points: Vec<(f64, f64)> = drift
        .points
        .iter()
        .step_by(every)
        .map(|p| (p.time_s, row(p.bias_us)))
        .collect();
    let x = range(points.iter().map(|p| p.0), 0.02);
    let ends = [x.start, x.end].map(|t| (t, row(drift.line.at(t))));
    let y = range(points.iter().chain(&ends).map(|p| p.1), 0.1);
    let digits = (2.0 - (y.end - y.start).log10()).clamp(0.0, 6.0) as usize;
    let rest = head(
        area,
        &format!(
            "Row of the train's centre against time: {:+.3} ± {:.3} µs/min",
            drift.result.drift_us_per_min, drift.result.drift_sigma_us_per_min
        ),
        &[
            ("frames", MEASURED, Sign::Dot),
            ("regression", FITTED, Sign::Line),
        ],
    )?;
    let mut chart = ChartBuilder::on(&rest)
        .margin(10)
        .margin_top(0)
        .x_label_area_size(52)
        .y_label_area_size(92)
        .build_cartesian_2d(x, y)
        .map_err(plot_error)?;
    chart
        .configure_mesh()
        .label_style(("sans-serif", LABEL))
        .axis_desc_style(("sans-serif", LABEL))
        .x_desc("time, s")
        .y_desc("sensor row")
        .y_label_formatter(&|v| format!("{v:.digits$}"))
        .light_line_style(WHITE)
        .draw()
        .map_err(plot_error)?;
    chart
        .draw_series(
            points
                .iter()
                .map(|&p| Circle::new(p, 2, MEASURED.mix(0.5).filled())),
        )
        .map_err(plot_error)?;
    chart
        .draw_series(LineSeries::new(ends, FITTED.stroke_width(2)))
        .map_err(plot_error)?;
    Ok(())
}
