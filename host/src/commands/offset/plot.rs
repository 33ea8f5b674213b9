//! The plot of `offset`: both gyroscopes before and after, residual, left out.

use std::ops::Range;

use anyhow::{Result, anyhow};
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;

use crate::sync::compare::{self, Pair};
use crate::sync::{Estimate, GyroTrack, Options, Refusal, Stream};

const SIZE: (u32, u32) = (1400, 1500);
const BOARD: RGBColor = RGBColor(0, 90, 160);
const PHONE: RGBColor = RGBColor(220, 110, 0);
const AXES: [RGBColor; 3] = [
    RGBColor(190, 30, 45),
    RGBColor(40, 140, 60),
    RGBColor(0, 90, 160),
];
const LEFT_OUT: RGBColor = RGBColor(150, 0, 170);

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
) -> Result<String> {
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
            &[("board", BOARD, norm(mcu)), ("phone", PHONE, norm(phone))],
            &[],
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
            &[("board", BOARD, Vec::new()), ("phone", PHONE, Vec::new())],
            &[
                (BOARD, out_of(mcu, Stream::Mcu)),
                (LEFT_OUT, out_of(phone, Stream::Phone)),
            ],
        )?;
        root.present().map_err(text)?;
    }
    Ok(out)
}

type Area<'a, 'b> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;
type Points = Vec<(f64, f64)>;

fn text(error: impl std::fmt::Display) -> anyhow::Error {
    anyhow!("{error}")
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

fn after(area: &Area<'_, '_>, pairs: &[Pair], estimate: &Estimate) -> Result<()> {
    let start = pairs.first().map_or(0.0, |p| p.board_s);
    let lines = |of: fn(&Pair) -> [f64; 3], axis: usize| -> Points {
        pairs
            .iter()
            .map(|p| (p.board_s - start, of(p)[axis]))
            .collect()
    };
    let mut series = Vec::new();
    for (axis, name) in ["board x", "board y", "board z"].into_iter().enumerate() {
        series.push((name, BOARD.mix(1.0), lines(|p| p.mcu, axis)));
    }
    for (axis, name) in ["phone x", "phone y", "phone z"].into_iter().enumerate() {
        series.push((name, AXES[axis].mix(0.9), lines(|p| p.phone, axis)));
    }
    let series: Vec<(&str, RGBColor, Points)> = series
        .into_iter()
        .map(|(name, color, points)| (name, RGBColor(color.0, color.1, color.2), points))
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
        &[],
    )
}

fn residual(area: &Area<'_, '_>, pairs: &[Pair], estimate: &Estimate) -> Result<()> {
    let start = pairs.first().map_or(0.0, |p| p.board_s);
    let points = |used: bool, axis: usize| -> Points {
        pairs
            .iter()
            .filter(|p| p.used == used)
            .map(|p| (p.board_s - start, 1e3 * (p.phone[axis] - p.mcu[axis])))
            .collect()
    };
    let series: Vec<(&str, RGBColor, Points)> = ["x", "y", "z"]
        .into_iter()
        .enumerate()
        .map(|(axis, name)| (name, AXES[axis], points(true, axis)))
        .collect();
    let marks: Vec<(RGBColor, Points)> =
        (0..3).map(|axis| (LEFT_OUT, points(false, axis))).collect();
    panel(
        area,
        &format!(
            "Residual phone − board, samples as recorded; in band {:.2} mrad/s rms; dots: left out",
            estimate.report.residual_rms.unwrap_or(f64::NAN) * 1e3
        ),
        "mrad/s",
        &series,
        &marks,
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

fn panel(
    area: &Area<'_, '_>,
    caption: &str,
    unit: &str,
    series: &[(&str, RGBColor, Points)],
    marks: &[(RGBColor, Points)],
) -> Result<()> {
    let all = || {
        series
            .iter()
            .flat_map(|s| &s.2)
            .chain(marks.iter().flat_map(|m| &m.1))
    };
    let (x, y) = (range(all().map(|p| p.0)), range(all().map(|p| p.1)));
    let mut chart: ChartContext<'_, SVGBackend<'_>, Cartesian2d<RangedCoordf64, RangedCoordf64>> =
        ChartBuilder::on(area)
            .caption(caption, ("sans-serif", 20))
            .margin(10)
            .x_label_area_size(35)
            .y_label_area_size(60)
            .build_cartesian_2d(x, y)
            .map_err(text)?;
    chart
        .configure_mesh()
        .light_line_style(WHITE)
        .x_desc("s")
        .y_desc(unit)
        .draw()
        .map_err(text)?;
    for (name, color, points) in series {
        let color = *color;
        chart
            .draw_series(LineSeries::new(
                points.iter().copied(),
                color.stroke_width(1),
            ))
            .map_err(text)?
            .label(*name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], color));
    }
    for (color, points) in marks {
        chart
            .draw_series(points.iter().map(|&p| Circle::new(p, 2, color.filled())))
            .map_err(text)?;
    }
    chart
        .configure_series_labels()
        .border_style(BLACK)
        .background_style(WHITE.mix(0.8))
        .draw()
        .map_err(text)?;
    Ok(())
}
