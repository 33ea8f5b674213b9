//! The plot of `offset`: both gyroscopes before and after, residual, left out.

use std::ops::Range;

use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;

use crate::outcome::{ExitStatus, Failure};
use twist_sync::compare::{self, Pair};
use twist_sync::{Estimate, GyroTrack, Options, Refusal, Stream};

const SIZE: (u32, u32) = (1400, 1500);
const BOARD: RGBColor = RGBColor(0, 90, 160);
const PHONE: RGBColor = RGBColor(220, 110, 0);
const AXES: [RGBColor; 3] = [
    RGBColor(190, 30, 45),
    RGBColor(40, 140, 60),
    RGBColor(0, 90, 160),
];
/// The axes of the board, under the phone's.
const PALE_AXES: [RGBColor; 3] = [
    RGBColor(245, 175, 180),
    RGBColor(170, 225, 180),
    RGBColor(165, 205, 240),
];
const LEFT_OUT: RGBColor = RGBColor(150, 0, 170);
/// Width of the panel right of the data, for the legend, as a share of the data's.
const LEGEND: f64 = 0.13;
/// Sizes of the letters: a page shows the plot at two thirds of its width.
const CAPTION: i32 = 24;
const LABEL: i32 = 20;

/// What is drawn in a panel under one name.
struct Series {
    name: &'static str,
    color: RGBColor,
    style: Style,
    points: Points,
}

enum Style {
    /// A line of this width.
    Line(u32),
    Dots,
}

impl Series {
    const fn line(name: &'static str, color: RGBColor, points: Points) -> Self {
        Self {
            name,
            color,
            style: Style::Line(1),
            points,
        }
    }

    const fn dots(name: &'static str, color: RGBColor, points: Points) -> Self {
        Self {
            name,
            color,
            style: Style::Dots,
            points,
        }
    }
}

/// Draws the panels as SVG text.
///
/// # Errors
///
/// The drawing library's, as text.
pub(super) fn svg(
    mcu: &GyroTrack,
    phone: &GyroTrack,
    result: &Result<Estimate, Refusal>,
    options: &Options,
) -> Result<String, Failure> {
    let mut out = String::new();
    {
        let root = SVGBackend::with_string(&mut out, SIZE).into_drawing_area();
        root.fill(&WHITE).map_err(text)?;
        let faults = match result {
            Ok(estimate) => &estimate.report.faults,
            Err(refusal) => &refusal.report.faults,
        };
        let panels = root.split_evenly((4, 1));
        let norm = |track: &GyroTrack| -> Vec<(f64, f64)> {
            track
                .t
                .iter()
                .zip(&track.w)
                .filter(|(t, _)| t.is_finite())
                .map(|(&t, w)| (t, (w[0] * w[0] + w[1] * w[1] + w[2] * w[2]).sqrt()))
                .filter(|p| p.1.is_finite())
                .collect()
        };
        panel(
            &panels[0],
            "Before: magnitude of the rate, each from its own first sample",
            "rad/s",
            &[
                Series::line("board", BOARD, norm(mcu)),
                Series::line("phone", PHONE, norm(phone)),
            ],
        )?;
        let out_of = |track: &GyroTrack, stream: Stream| -> Vec<(f64, f64)> {
            compare::left_out(faults, stream, track.len())
                .iter()
                .zip(norm(track))
                .filter(|(out, _)| **out)
                .map(|(_, point)| point)
                .collect()
        };
        match result {
            Ok(estimate) => {
                let pairs = compare::pairs(mcu, phone, estimate, options);
                after(&panels[1], &pairs, estimate)?;
                residual(&panels[2], &pairs, estimate)?;
            }
            Err(refusal) => {
                let words = format!("REFUSED: {}", refusal.report.failures());
                for (line, chunk) in wrapped(&words, 130).iter().enumerate() {
                    panels[1]
                        .draw(&Text::new(
                            chunk.clone(),
                            (40, 40 + 24 * line as i32),
                            ("sans-serif", 18).into_font(),
                        ))
                        .map_err(text)?;
                }
            }
        }
        panel(
            &panels[3],
            "Left out (samples as recorded, each from its own first sample)",
            "rad/s",
            &[
                Series::dots("board", BOARD, out_of(mcu, Stream::A)),
                Series::dots("phone", PHONE, out_of(phone, Stream::B)),
            ],
        )?;
        root.present().map_err(text)?;
    }
    Ok(out)
}

type Area<'a, 'b> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;
type Points = Vec<(f64, f64)>;

fn text(error: impl std::fmt::Display) -> Failure {
    Failure::new(ExitStatus::Error, format!("cannot draw the plot: {error}"))
}

fn wrapped(words: &str, width: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in words.split_whitespace() {
        if let Some(line) = lines.last_mut()
            && line.len() + word.len() < width
        {
            line.push_str(word);
            line.push(' ');
            continue;
        }
        lines.push(format!("{word} "));
    }
    lines
}

fn after(area: &Area<'_, '_>, pairs: &[Pair], estimate: &Estimate) -> Result<(), Failure> {
    let start = pairs.first().map_or(0.0, |p| p.a_s);
    let lines = |of: fn(&Pair) -> [f64; 3], axis: usize| -> Points {
        pairs.iter().map(|p| (p.a_s - start, of(p)[axis])).collect()
    };
    let board = ["board x", "board y", "board z"];
    let phone = ["phone x", "phone y", "phone z"];
    // The board wide and pale below, the phone thin on top of it.
    let series: Vec<Series> = (0..3)
        .map(|axis| Series {
            style: Style::Line(5),
            ..Series::line(board[axis], PALE_AXES[axis], lines(|p| p.a, axis))
        })
        .chain((0..3).map(|axis| Series::line(phone[axis], AXES[axis], lines(|p| p.b, axis))))
        .collect();
    panel(
        area,
        &format!(
            "After: offset {:.6} s ± {:.2} µs, skew {:+.1} ± {:.1} ppm; board carried to the phone's axes",
            estimate.clock.offset,
            estimate.offset_sigma_s() * 1e6,
            estimate.clock.skew * 1e6,
            estimate.skew_sigma() * 1e6
        ),
        "rad/s",
        &series,
    )
}

fn residual(area: &Area<'_, '_>, pairs: &[Pair], estimate: &Estimate) -> Result<(), Failure> {
    let start = pairs.first().map_or(0.0, |p| p.a_s);
    let points = |used: bool, axis: usize| -> Points {
        pairs
            .iter()
            .filter(|p| p.used == used)
            .map(|p| (p.a_s - start, 1e3 * (p.b[axis] - p.a[axis])))
            .collect()
    };
    let mut series: Vec<Series> = ["x", "y", "z"]
        .into_iter()
        .enumerate()
        .map(|(axis, name)| Series::line(name, AXES[axis], points(true, axis)))
        .collect();
    let out = (0..3).flat_map(|axis| points(false, axis)).collect();
    series.push(Series::dots("left out", LEFT_OUT, out));
    panel(
        area,
        &format!(
            "Residual phone − board, samples as recorded; in band {:.2} mrad/s rms",
            estimate.report.residual_rms.unwrap_or(f64::NAN) * 1e3
        ),
        "mrad/s",
        &series,
    )
}

fn range(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
        (low.min(v), high.max(v))
    });
    if low.is_finite() && high.is_finite() {
        let margin = 0.05 * (high - low) + 1e-6;
        low - margin..high + margin
    } else {
        0.0..1.0
    }
}

fn panel(area: &Area<'_, '_>, caption: &str, unit: &str, series: &[Series]) -> Result<(), Failure> {
    let all = || series.iter().flat_map(|s| &s.points);
    let (mut x, y) = (range(all().map(|p| p.0)), range(all().map(|p| p.1)));
    x.end += LEGEND * (x.end - x.start);
    let mut chart: ChartContext<'_, SVGBackend<'_>, Cartesian2d<RangedCoordf64, RangedCoordf64>> =
        ChartBuilder::on(area)
            .caption(caption, ("sans-serif", CAPTION))
            .margin(10)
            .x_label_area_size(54)
            .y_label_area_size(86)
            .build_cartesian_2d(x, y)
            .map_err(text)?;
    chart
        .configure_mesh()
        .light_line_style(WHITE)
        .y_labels(6)
        .x_desc("s")
        .y_desc(unit)
        .label_style(("sans-serif", LABEL))
        .axis_desc_style(("sans-serif", LABEL))
        .draw()
        .map_err(text)?;
    for one in series {
        let color = one.color;
        match one.style {
            Style::Line(width) => {
                let points = one.points.iter().copied();
                chart
                    .draw_series(LineSeries::new(points, color.stroke_width(width)))
                    .map_err(text)?
                    .label(one.name)
                    .legend(move |(x, y)| {
                        PathElement::new([(x, y), (x + 18, y)], color.stroke_width(width))
                    });
            }
            Style::Dots => {
                let dots = one.points.iter();
                chart
                    .draw_series(dots.map(|&p| Circle::new(p, 2, color.filled())))
                    .map_err(text)?
                    .label(one.name)
                    .legend(move |(x, y)| Circle::new((x + 9, y), 3, color.filled()));
            }
        }
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .border_style(BLACK)
        .background_style(WHITE.mix(0.8))
        .label_font(("sans-serif", LABEL))
        .draw()
        .map_err(text)?;
    Ok(())
}
