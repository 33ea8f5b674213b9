//! Drawings for reports, as SVG text.
//!
//! The legend stands above the axes, where it hides nothing, in type that can be read
//! when a page is shrunk to a phone's width. Time series of any length are drawn as an
//! envelope of a bounded number of columns, so a page stays small after hours of
//! recording.

mod envelope;

use std::ops::Range;

use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

pub use envelope::{Column, Envelope};

/// Size of a drawing, pixels; each further line of the legend makes it higher.
const SIZE: (u32, u32) = (800, 340);

/// Size of all type, pixels: as a narrow page shows it. A wide one has smaller type, by its style.
const LABEL: i32 = 27;
/// Height of a line of the legend, pixels.
const LINE: i32 = 35;
/// Width of a letter on average, pixels.
const LETTER: i32 = 13;
/// Left end of the legend, pixels.
const LEFT: i32 = 70;

/// Largest number that is drawn: above any time in seconds and any count of this
/// program, and far below numbers at which the steps of an axis are lost to rounding.
const MOST: f64 = 1e12;

/// Least width of a chart, relative to the position on the x-axis.
const NARROWEST: f64 = 1e-9;

/// Colours that differ in print and for most colour-blind readers (Okabe and Ito).
const COLOURS: [RGBColor; 4] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
];

/// Data of one series in a chart.
#[derive(Clone, Debug)]
pub enum Data {
    /// A line through points (x, y).
    Line(Vec<(f64, f64)>),
    /// Separate points (x, y).
    Points(Vec<(f64, f64)>),
    /// Range of the values in each column, and width of the columns.
    Range(Vec<Column>, f64),
    /// Points with error bars: (x, y, half the length of the bar).
    Bars(Vec<(f64, f64, f64)>),
    /// A band about a line: (x, y, half the height of the band).
    Band(Vec<(f64, f64, f64)>),
}

type Bounds = (Range<f64>, Range<f64>);

fn is_drawn(value: f64) -> bool {
    value.is_finite() && value.abs() <= MOST
}

impl Data {
    /// Removes values that cannot be drawn; returns their number.
    fn leave_out_wild(&mut self) -> usize {
        fn retain<T>(all: &mut Vec<T>, is_drawn: impl FnMut(&T) -> bool) -> usize {
            let before = all.len();
            all.retain(is_drawn);
            before - all.len()
        }
        match self {
            Self::Line(points) | Self::Points(points) => {
                retain(points, |&(x, y)| is_drawn(x) && is_drawn(y))
            }
            Self::Range(columns, width) => {
                let width = *width;
                retain(columns, |c| {
                    [c.x, c.low, c.high, width].into_iter().all(is_drawn)
                })
            }
            Self::Bars(points) | Self::Band(points) => {
                retain(points, |&(x, y, e)| [x, y, e].into_iter().all(is_drawn))
            }
        }
    }

    /// Returns the opacity of its areas, 0 to 1.
    const fn opacity(&self) -> f64 {
        match self {
            Self::Range(..) => 0.8,
            Self::Band(_) => 0.25,
            Self::Line(_) | Self::Points(_) | Self::Bars(_) => 1.0,
        }
    }

    fn bounds(&self) -> Option<Bounds> {
        let points: Vec<(f64, f64, f64, f64)> = match self {
            Self::Line(points) | Self::Points(points) => {
                points.iter().map(|&(x, y)| (x, 0.0, y, y)).collect()
            }
            Self::Range(columns, width) => {
                let columns = columns.iter();
                columns.map(|c| (c.x, width / 2.0, c.low, c.high)).collect()
            }
            Self::Bars(points) | Self::Band(points) => {
                let points = points.iter();
                points.map(|&(x, y, e)| (x, 0.0, y - e, y + e)).collect()
            }
        };
        points
            .into_iter()
            .map(|(x, side, low, high)| (x - side..x + side, low..high))
            .reduce(both)
    }
}

fn both((xs, ys): Bounds, (a, b): Bounds) -> Bounds {
    (
        xs.start.min(a.start)..xs.end.max(a.end),
        ys.start.min(b.start)..ys.end.max(b.end),
    )
}

/// Named series over one pair of axes.
struct Chart<'a> {
    labels: [&'a str; 2],
    series: Vec<(String, Data)>,
    xs: Range<f64>,
    ys: Range<f64>,
    /// True for an axis of whole numbers, x and y.
    counts: [bool; 2],
}

/// Least range for [`series`] that adds nothing to the range of the values.
pub const AS_IT_IS: Range<f64> = f64::NAN..f64::NAN;

/// Draws named series over one pair of axes, as SVG. `least` is a range of values that is shown
/// in any case, so that noise of a tick does not fill the picture. Returns an empty string if
/// there is nothing to draw.
#[must_use]
pub fn series(x_label: &str, y_label: &str, least: Range<f64>, all: Vec<(&str, Data)>) -> String {
    chart([x_label, y_label], least, all, [false; 2])
}

/// Draws as [`series`] does, over axes of whole numbers where `counts` says so.
#[must_use]
pub fn counted(
    labels: [&str; 2],
    counts: [bool; 2],
    least: Range<f64>,
    all: Vec<(&str, Data)>,
) -> String {
    chart(labels, least, all, counts)
}

/// Draws a histogram of counts in bins of width `bin`, the first of which begins at `first`, as
/// SVG. `labels` are those of the axes.
#[must_use]
pub fn histogram(labels: [&str; 2], (first, bin): (f64, f64), counts: &[u64]) -> String {
    let counts = counts.iter().enumerate();
    let columns = counts.map(|(place, &count)| Column {
        x: first + (place as f64 + 0.5) * bin,
        low: 0.0,
        high: count as f64,
    });
    let data = Data::Range(columns.collect(), 0.92 * bin);
    chart(labels, 0.0..1.0, vec![("", data)], [false, true])
}

fn chart(
    labels: [&str; 2],
    least: Range<f64>,
    all: Vec<(&str, Data)>,
    counts: [bool; 2],
) -> String {
    let has_legend = all.len() > 1;
    let mut all_wild = 0;
    let series = all.into_iter().map(|(name, mut data)| {
        let wild = data.leave_out_wild();
        all_wild += wild;
        let name = match (wild, has_legend) {
            (0, true) => name.to_owned(),
            (0, false) => String::new(),
            _ => format!("{name} ({wild} too large to be drawn)"),
        };
        (name, data)
    });
    let series: Vec<_> = series.collect();
    let bounds = series.iter().filter_map(|(_, data)| data.bounds());
    let nothing = (all_wild > 0).then_some((0.0..0.0, 0.0..0.0));
    let Some((mut xs, ys)) = bounds.reduce(both).or(nothing) else {
        return String::new();
    };
    let mut ys = ys.start.min(least.start)..ys.end.max(least.end);
    let height = (ys.end - ys.start).max(1e-6 * (1.0 + ys.end.abs()));
    // Values that begin at zero stand on the axis.
    if ys.start != 0.0 {
        ys.start -= 0.06 * height;
    }
    ys.end += 0.06 * height;
    let has_dots = |(_, data): &(String, Data)| matches!(data, Data::Points(_) | Data::Bars(_));
    if xs.end - xs.start <= NARROWEST * xs.end.abs() {
        let side = 0.5 + NARROWEST * xs.end.abs();
        xs = xs.start - side..xs.end + side;
    } else if series.iter().any(has_dots) {
        // Points on the edge would be cut in half.
        let side = 0.02 * (xs.end - xs.start);
        xs = xs.start - side..xs.end + side;
    }
    let chart = Chart {
        labels,
        series,
        xs,
        ys,
        counts,
    };
    // The backend writes into text and cannot fail.
    let mut svg = String::new();
    if let Err(error) = chart.draw(&mut svg) {
        tracing::warn!("a drawing is left out: {error}");
        svg.clear();
    }
    svg
}

/// Draws named values as horizontal bars, each with its value in words, as SVG.
#[must_use]
pub fn bars(values: &[(&str, f64)], words: impl Fn(f64) -> String) -> String {
    const ROW: i32 = 64;
    let drawn = values.iter().filter(|(_, value)| is_drawn(*value));
    let most = drawn
        .clone()
        .map(|(_, value)| value.abs())
        .fold(0.0, f64::max);
    let (width, height) = (SIZE.0, ROW * drawn.clone().count() as i32);
    let mut svg = format!(
        "<svg viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" font-size=\"{LABEL}\" \
         xmlns=\"http://www.w3.org/2000/svg\">"
    );
    let RGBColor(red, green, blue) = COLOURS[0];
    for (row, (name, value)) in (0..).zip(drawn) {
        let length = if most > 0.0 {
            f64::from(width) * value.abs() / most
        } else {
            0.0
        };
        let top = row * ROW;
        svg += &format!(
            "<text x=\"0\" y=\"{}\">{name}: {}</text><rect x=\"0\" y=\"{}\" width=\"{length:.1}\" \
             height=\"18\" fill=\"rgb({red},{green},{blue})\"/>",
            top + 30,
            words(*value),
            top + 38,
        );
    }
    svg + "</svg>"
}

type Area<'svg> = DrawingArea<SVGBackend<'svg>, Shift>;
type Axes<'area, 'svg> =
    ChartContext<'area, SVGBackend<'svg>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// Result of drawing; the error type is boxed, because the backend writes text and cannot fail.
type Drawn<T> = Result<T, Box<dyn std::error::Error>>;

impl Chart<'_> {
    /// Returns left end and line of each name in the legend, and the number of its lines.
    fn legend(&self) -> (Vec<(i32, i32)>, i32) {
        let (mut x, mut line) = (LEFT, 0);
        let places = self.series.iter().map(|(name, _)| {
            let long = 48 + LETTER * name.chars().count() as i32;
            if x > LEFT && x + long > SIZE.0 as i32 {
                (x, line) = (LEFT, line + 1);
            }
            x += long;
            (x - long, line)
        });
        let places = places.collect();
        let has_names = self.series.iter().any(|(name, _)| !name.is_empty());
        (places, if has_names { line + 1 } else { 0 })
    }

    fn draw(&self, svg: &mut String) -> Drawn<()> {
        let (places, lines) = self.legend();
        let more = (lines - 2).max(0) * LINE;
        let size = (SIZE.0, SIZE.1 + more as u32);
        let area = SVGBackend::with_string(svg, size).into_drawing_area();
        area.fill(&WHITE)?;
        let all = self.series.iter().zip(places);
        for (((name, data), (x, line)), colour) in all.zip(COLOURS.into_iter().cycle()) {
            if name.is_empty() {
                continue;
            }
            let top = 10 + line * LINE;
            swatch(&area, data, colour, (x, top + LABEL / 2))?;
            // Beside the swatch in type of any size.
            let style = TextStyle::from(("sans-serif", LABEL).into_font());
            let style = style.pos(Pos::new(HPos::Left, VPos::Center));
            let place = (x + 24, top + LABEL / 2);
            area.draw(&Text::new(name.clone(), place, style))?;
        }
        let head = (10 + lines * LINE).max(LINE / 2);
        self.draw_axes(&area.split_vertically(head).1)?;
        area.present()?;
        Ok(())
    }

    fn draw_axes(&self, area: &Area<'_>) -> Drawn<()> {
        let (xs, ys) = (&self.xs, &self.ys);
        let text = |v: f64, shown: &Range<f64>, counts: bool| {
            if !counts {
                tick(v, shown)
            } else if (v - v.round()).abs() < 1e-6 {
                format!("{v:.0}")
            } else {
                String::new()
            }
        };
        let x_text = |v: &f64| text(*v, xs, self.counts[0]);
        let y_text = |v: &f64| text(*v, ys, self.counts[1]);
        // The axis' name stands beside its longest number.
        let longest = [ys.start, ys.end].map(|end| {
            y_text(&end.round())
                .chars()
                .count()
                .max(tick(end, ys).chars().count())
        });
        let longest = longest.into_iter().max().unwrap_or_default() as i32;
        let mut axes = ChartBuilder::on(area)
            .margin(10)
            .margin_right(24)
            .x_label_area_size(70)
            .y_label_area_size((LABEL + 22 + LETTER * longest).max(114))
            .build_cartesian_2d(xs.clone(), ys.clone())?;
        axes.configure_mesh()
            .x_labels(8)
            .y_labels(6)
            .x_desc(self.labels[0])
            .y_desc(self.labels[1])
            .x_label_formatter(&x_text)
            .y_label_formatter(&y_text)
            .label_style(("sans-serif", LABEL))
            .axis_desc_style(("sans-serif", LABEL))
            .light_line_style(WHITE)
            .draw()?;
        for ((_, data), colour) in self.series.iter().zip(COLOURS.into_iter().cycle()) {
            paint(&mut axes, data, colour)?;
        }
        Ok(())
    }
}

/// Draws a sample of a series beside its name in the legend.
fn swatch(area: &Area<'_>, data: &Data, colour: RGBColor, (x, middle): (i32, i32)) -> Drawn<()> {
    match data {
        Data::Line(_) => {
            let ends = [(x, middle), (x + 18, middle)];
            area.draw(&PathElement::new(ends, colour.stroke_width(2)))?;
        }
        Data::Points(_) | Data::Bars(_) => {
            area.draw(&Circle::new((x + 9, middle), 3, colour.filled()))?;
        }
        Data::Range(..) | Data::Band(_) => {
            let corners = [(x, middle - 5), (x + 18, middle + 5)];
            area.draw(&Rectangle::new(
                corners,
                colour.mix(data.opacity()).filled(),
            ))?;
        }
    }
    Ok(())
}

/// Formats the number at a tick with as many digits as the axis needs.
fn tick(value: f64, shown: &Range<f64>) -> String {
    let digits = (2.0 - (shown.end - shown.start).log10()).clamp(0.0, 9.0);
    let text = format!("{value:.0$}", digits as usize);
    if text
        .trim_start_matches('-')
        .chars()
        .all(|c| "0.".contains(c))
    {
        return String::from("0");
    }
    text
}

fn paint(axes: &mut Axes<'_, '_>, data: &Data, colour: RGBColor) -> Drawn<()> {
    match data {
        Data::Line(points) => {
            let line = colour.stroke_width(2);
            axes.draw_series(LineSeries::new(points.iter().copied(), line))?;
        }
        Data::Points(points) => {
            let dots = points.iter();
            axes.draw_series(dots.map(|&point| Circle::new(point, 2, colour.filled())))?;
        }
        Data::Range(columns, width) => {
            let half = width / 2.0;
            axes.draw_series(columns.iter().map(|c| {
                let corners = [(c.x - half, c.low), (c.x + half, c.high)];
                Rectangle::new(corners, colour.mix(data.opacity()).filled())
            }))?;
            // A flat stretch has no height: a line keeps it visible.
            axes.draw_series(columns.iter().map(|c| {
                let ends = [(c.x - half, c.high), (c.x + half, c.high)];
                PathElement::new(ends, colour.stroke_width(2))
            }))?;
        }
        Data::Band(points) => {
            let above = points.iter().map(|&(x, y, sigma)| (x, y + sigma));
            let below = points.iter().rev().map(|&(x, y, sigma)| (x, y - sigma));
            let edge: Vec<_> = above.chain(below).collect();
            axes.draw_series([Polygon::new(edge, colour.mix(data.opacity()).filled())])?;
        }
        Data::Bars(points) => {
            axes.draw_series(points.iter().map(|&(x, y, sigma)| {
                let ends = [(x, y - sigma), (x, y + sigma)];
                PathElement::new(ends, colour.mix(0.5).stroke_width(1))
            }))?;
            let dots = points.iter();
            axes.draw_series(dots.map(|&(x, y, _)| Circle::new((x, y), 3, colour.filled())))?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_to_draw_gives_nothing() {
        assert_eq!(series("x", "y", 0.0..0.0, vec![]), "");
        let line = Data::Line(vec![(1.0, 2.0)]);
        let svg = series("x", "y", 0.0..1.0, vec![("<a>", line)]);
        assert!(svg.starts_with("<svg"), "{svg}");
        // Values that cannot be drawn are reported.
        let wild = Data::Points(vec![(1.0, f64::NAN)]);
        let svg = series("x", "y", 0.0..1.0, vec![("", wild)]);
        assert!(svg.contains("1 too large to be drawn"), "{svg}");
    }

    #[test]
    fn a_legend_stands_above_all_that_is_drawn() {
        // Error bars over the whole height, where a legend inside the axes would be.
        let bars = Data::Bars(vec![(0.02, 0.5, 0.5), (0.98, 0.5, 0.5)]);
        let all = vec![("windows", bars.clone()), ("others", bars)];
        let svg = series("x", "y", 0.0..1.0, all);
        let numbers = |from: &str| -> Vec<f64> {
            let parts = svg.split(from).skip(1);
            let texts = parts.map(|part| part.split('"').next().unwrap_or_default());
            texts
                .flat_map(|text| text.split_whitespace())
                .filter_map(|pair| pair.rsplit(',').next()?.parse().ok())
                .collect()
        };
        let drawn = [numbers(" points=\""), numbers(" y1=\"")].concat();
        let top = drawn.iter().copied().fold(f64::MAX, f64::min);
        let (before, _) = svg.split_once("\nwindows\n").unwrap();
        let tag = &before[before.rfind("<text").unwrap()..];
        let (_, y) = tag.split_once(" y=\"").unwrap();
        let legend: f64 = y.split('"').next().unwrap().parse().unwrap();
        assert!(
            drawn.len() > 4 && legend + f64::from(LABEL) <= top,
            "{legend} {top}"
        );
    }

    #[test]
    fn ticks_have_the_digits_they_need() {
        assert_eq!(tick(540.0, &(0.0..1080.0)), "540");
        assert_eq!(tick(0.1, &(0.0..0.5)), "0.10");
        assert_eq!(tick(-1e-12, &(-1.0..1.0)), "0");
        assert_eq!(tick(2.5, &(0.0..9.0)), "2.5");
    }
}
