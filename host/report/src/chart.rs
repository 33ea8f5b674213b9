//! Drawings for reports, as SVG text.
//!
//! A [`Chart`] has one pair of axes; [`stack`] draws several one below the other. Title
//! and legend stand above the axes, where they hide nothing, in type that can be read
//! when a page is shrunk to a phone's width. Time series of any length are drawn as an
//! envelope of a bounded number of columns, so a page stays small after hours of
//! recording.

mod envelope;
mod head;

use std::ops::Range;

use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;

pub use envelope::{Column, Envelope};
use head::{Head, USUAL_LINES, head};

/// Size of a drawing of one chart, pixels.
const SIZE: (u32, u32) = (800, 340);

/// Size of all type, pixels.
const LABEL: i32 = 27;
/// Height of a line of title or legend, pixels.
const LINE: i32 = 35;
/// Width of a letter on average, pixels.
const LETTER: i32 = 13;
/// Left end of title and legend, pixels.
const LEFT: i32 = 70;

/// The largest number that is drawn: above any time in seconds and any count of this
/// program, and far below where the steps of an axis are lost to rounding.
const MOST: f64 = 1e12;

/// The smallest part of a place on the x-axis that a chart is wide.
const NARROWEST: f64 = 1e-9;

/// Colours that differ in print and for most colour-blind readers (Okabe and Ito).
const COLOURS: [Ink; 4] = [
    Ink::rgb(0, 114, 178),
    Ink::rgb(213, 94, 0),
    Ink::rgb(0, 158, 115),
    Ink::rgb(204, 121, 167),
];

/// Colour and width of what is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ink {
    colour: RGBAColor,
    width: u32,
}

impl Ink {
    /// An opaque colour, and lines of 2 pixels.
    #[must_use]
    pub const fn rgb(red: u8, green: u8, blue: u8) -> Self {
        Self {
            colour: RGBAColor(red, green, blue, 1.0),
            width: 2,
        }
    }

    /// Lines of this width, pixels.
    #[must_use]
    pub const fn wide(self, width: u32) -> Self {
        Self { width, ..self }
    }

    /// Transparent to this share, 0 to 1.
    #[must_use]
    pub fn pale(self, share: f64) -> Self {
        Self {
            colour: self.colour.mix(1.0 - share),
            ..self
        }
    }

    fn line(self) -> ShapeStyle {
        self.colour.stroke_width(self.width)
    }

    fn fill(self) -> ShapeStyle {
        self.colour.filled()
    }
}

/// What is drawn.
#[derive(Clone, Debug)]
pub enum Data {
    /// A line through points.
    Line(Vec<(f64, f64)>),
    /// Points by themselves.
    Points(Vec<(f64, f64)>),
    /// The range of values in each column, and the columns' width.
    Range(Vec<Column>, f64),
    /// Points with an error bar.
    Bars(Vec<(f64, f64, f64)>),
    /// Counts in bins of equal width.
    Bins {
        /// Left end of the first bin.
        first: f64,
        /// Width of a bin.
        width: f64,
        /// Counts, one a bin.
        counts: Vec<u64>,
    },
    /// Lines from bottom to top at these places.
    Upright(Vec<f64>),
    /// Words at the upper edge, with an arrow at their places.
    Marks(Vec<(f64, String)>),
}

type Bounds = (Range<f64>, Range<f64>);

fn is_drawn(value: f64) -> bool {
    value.is_finite() && value.abs() <= MOST
}

impl Data {
    /// Takes out what cannot be drawn, and says how much that was.
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
            Self::Bars(points) => retain(points, |&(x, y, e)| [x, y, e].into_iter().all(is_drawn)),
            Self::Bins {
                first,
                width,
                counts,
            } => {
                let end = *first + *width * counts.len() as f64;
                if is_drawn(*first) && is_drawn(end) {
                    return retain(counts, |&count| is_drawn(count as f64));
                }
                (*first, *width) = (0.0, 1.0);
                retain(counts, |_| false)
            }
            Self::Upright(places) => retain(places, |&x| is_drawn(x)),
            Self::Marks(marks) => retain(marks, |&(x, _)| is_drawn(x)),
        }
    }

    fn bounds(&self) -> Option<Bounds> {
        let points: Vec<(f64, f64, f64)> = match self {
            Self::Line(points) | Self::Points(points) => {
                points.iter().map(|&(x, y)| (x, y, y)).collect()
            }
            Self::Range(columns, _) => columns.iter().map(|c| (c.x, c.low, c.high)).collect(),
            Self::Bars(points) => points.iter().map(|&(x, y, e)| (x, y - e, y + e)).collect(),
            Self::Bins {
                first,
                width,
                counts,
            } => {
                let highest = counts.iter().copied().max().unwrap_or(0) as f64;
                let end = first + width * counts.len() as f64;
                vec![(*first, 0.0, highest), (end, 0.0, highest)]
            }
            Self::Upright(_) | Self::Marks(_) => Vec::new(),
        };
        points
            .into_iter()
            .map(|(x, low, high)| (x..x, low..high))
            .reduce(both)
    }
}

fn both((xs, ys): Bounds, (a, b): Bounds) -> Bounds {
    (
        xs.start.min(a.start)..xs.end.max(a.end),
        ys.start.min(b.start)..ys.end.max(b.end),
    )
}

/// Series over one pair of axes, with title and legend above.
#[derive(Clone, Debug, Default)]
pub struct Chart {
    title: String,
    labels: [String; 2],
    xs: Option<Range<f64>>,
    least: Option<Range<f64>>,
    /// Names in the legend, where one without a name is not, and what is drawn.
    series: Vec<(String, Data, Ink)>,
    /// Values that cannot be drawn.
    left_out: usize,
}

impl Chart {
    /// A chart with the labels of its axes.
    #[must_use]
    pub fn new(x_label: &str, y_label: &str) -> Self {
        Self {
            labels: [x_label.to_owned(), y_label.to_owned()],
            ..Self::default()
        }
    }

    /// What it is, above it. Long titles are wrapped, so that a chart without series
    /// can hold an explanation in its place.
    #[must_use]
    pub fn title(mut self, title: &str) -> Self {
        title.clone_into(&mut self.title);
        self
    }

    /// Shows just this part of the x-axis, and axes if there is nothing to be drawn.
    /// Several charts of one range have one scale.
    #[must_use]
    pub fn xs(mut self, xs: Range<f64>) -> Self {
        self.xs = Some(xs).filter(|xs| is_drawn(xs.start) && is_drawn(xs.end));
        self
    }

    /// Shows at least this range of values, so that noise of a tick does not fill the
    /// picture.
    #[must_use]
    pub fn least(mut self, ys: Range<f64>) -> Self {
        self.least = Some(ys);
        self
    }

    /// Adds a series with its name in the legend, over those before.
    #[must_use]
    pub fn add(mut self, name: &str, mut data: Data, ink: Ink) -> Self {
        self.left_out += data.leave_out_wild();
        self.series.push((name.to_owned(), data, ink));
        self
    }

    /// Whether it has data of this kind.
    fn has(&self, kind: impl Fn(&Data) -> bool) -> bool {
        self.series.iter().any(|(_, data, _)| kind(data))
    }

    /// What stands above it: the title, and how much could not be drawn.
    fn heading(&self) -> String {
        let note = match self.left_out {
            0 => return self.title.clone(),
            1 => String::from("1 value is too large to be drawn and left out."),
            many => format!("{many} values are too large to be drawn and left out."),
        };
        format!("{} {note}", self.title).trim_start().to_owned()
    }

    /// What the axes show; `None` if there is nothing.
    fn ranges(&self) -> Option<Bounds> {
        let bounds = self.series.iter().filter_map(|(_, data, _)| data.bounds());
        let shown = self.xs.clone().map(|xs| (xs, 0.0..1.0));
        let (mut xs, mut ys) = bounds.reduce(both).or(shown)?;
        if let Some(least) = &self.least {
            ys = ys.start.min(least.start)..ys.end.max(least.end);
        }
        let height = (ys.end - ys.start).max(1e-6 * (1.0 + ys.end.abs()));
        // Bins stand on the axis; marks need room.
        let bins = self.has(|data| matches!(data, Data::Bins { .. }));
        let marks = self.has(|data| matches!(data, Data::Marks(_)));
        ys.start -= if bins { 0.0 } else { 0.06 * height };
        ys.end += if marks { 0.4 } else { 0.06 } * height;
        if let Some(shown) = &self.xs {
            xs = shown.clone();
        } else if xs.end - xs.start <= NARROWEST * xs.end.abs() {
            let side = 0.5 + NARROWEST * xs.end.abs();
            xs = xs.start - side..xs.end + side;
        } else if self.has(|data| matches!(data, Data::Points(_) | Data::Bars(_))) {
            // Points on the edge would be cut in half.
            let side = 0.02 * (xs.end - xs.start);
            xs = xs.start - side..xs.end + side;
        }
        Some((xs, ys))
    }
}

/// A drawing of named series over one pair of axes. `least` is the smallest range of values
/// that is shown; if a drawing has nothing to show it is empty.
#[must_use]
pub fn series(x_label: &str, y_label: &str, least: Range<f64>, all: Vec<(&str, Data)>) -> String {
    let has_legend = all.len() > 1;
    let mut chart = Chart::new(x_label, y_label).least(least);
    for ((name, data), ink) in all.into_iter().zip(COLOURS.into_iter().cycle()) {
        chart = chart.add(if has_legend { name } else { "" }, data, ink);
    }
    if chart.ranges().is_none() && chart.left_out == 0 {
        return String::new();
    }
    stack(SIZE, &[chart])
}

/// A drawing of bars over bins of equal width: `first` is the left end of the first.
#[must_use]
pub fn histogram(labels: [&str; 2], (first, bin): (f64, f64), counts: &[u64]) -> String {
    let data = Data::Bins {
        first,
        width: bin,
        counts: counts.to_vec(),
    };
    let [x, y] = labels;
    let chart = Chart::new(x, y).add("", data, COLOURS[0].pale(0.25));
    stack(SIZE, &[chart.least(0.0..1.0)])
}

/// Named values as bars beside each other's length, each with its value in words.
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
    let RGBAColor(red, green, blue, _) = COLOURS[0].colour;
    for (row, (name, value)) in (0..).zip(drawn) {
        let length = match most > 0.0 {
            true => f64::from(width) * value.abs() / most,
            false => 0.0,
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

/// Draws charts one below the other, each of `size` pixels; one with axes and more than two
/// lines of title and legend is so much higher.
///
/// The backend writes into text and cannot fail; if it does, the drawing is empty.
#[must_use]
pub fn stack(size: (u32, u32), charts: &[Chart]) -> String {
    let mut svg = String::new();
    let mut below = 0;
    let ends: Vec<i32> = charts
        .iter()
        .map(|chart| {
            let more = if chart.ranges().is_some() {
                (Head::of(chart, size.0 as i32).lines() - USUAL_LINES).max(0) * LINE
            } else {
                0
            };
            below += size.1 as i32 + more;
            below
        })
        .collect();
    let draw = |svg: &mut String| -> Drawn<()> {
        let root = SVGBackend::with_string(svg, (size.0, below as u32)).into_drawing_area();
        root.fill(&WHITE)?;
        let areas = root.split_by_breakpoints([0; 0], &ends[..ends.len().saturating_sub(1)]);
        for (area, chart) in areas.iter().zip(charts) {
            draw(chart, area)?;
        }
        root.present()?;
        Ok(())
    };
    if let Err(error) = draw(&mut svg) {
        tracing::warn!("a drawing is left out: {error}");
        svg.clear();
    }
    svg
}

/// An area of the backend that writes into text.
type Area<'svg> = DrawingArea<SVGBackend<'svg>, Shift>;
type Axes<'area, 'svg> =
    ChartContext<'area, SVGBackend<'svg>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// The backend's own error type is not worth naming: it cannot fail.
type Drawn<T> = Result<T, Box<dyn std::error::Error>>;

fn draw(chart: &Chart, area: &Area<'_>) -> Drawn<()> {
    let rest = head(chart, area)?;
    let Some((xs, ys)) = chart.ranges() else {
        return Ok(());
    };
    // Counts are whole numbers.
    let whole = chart.has(|data| matches!(data, Data::Bins { .. }));
    let x_text = |v: &f64| tick(*v, &xs);
    let y_text = |v: &f64| match whole {
        false => tick(*v, &ys),
        true if (v - v.round()).abs() < 1e-6 => format!("{v:.0}"),
        true => String::new(),
    };
    let mut axes = ChartBuilder::on(&rest)
        .margin(10)
        .margin_right(24)
        .x_label_area_size(70)
        .y_label_area_size(114)
        .build_cartesian_2d(xs.clone(), ys.clone())?;
    axes.configure_mesh()
        .x_labels(8)
        .y_labels(6)
        .x_desc(&chart.labels[0])
        .y_desc(&chart.labels[1])
        .x_label_formatter(&x_text)
        .y_label_formatter(&y_text)
        .label_style(("sans-serif", LABEL))
        .axis_desc_style(("sans-serif", LABEL))
        .light_line_style(WHITE)
        .draw()?;
    for (_, data, ink) in &chart.series {
        paint(&mut axes, data, *ink, &ys)?;
    }
    Ok(())
}

/// A tick's number with as many digits as the axis needs.
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

fn paint(axes: &mut Axes<'_, '_>, data: &Data, ink: Ink, ys: &Range<f64>) -> Drawn<()> {
    match data {
        Data::Line(points) => {
            axes.draw_series(LineSeries::new(points.iter().copied(), ink.line()))?;
        }
        Data::Points(points) => {
            let dots = points.iter();
            axes.draw_series(dots.map(|&point| Circle::new(point, 2, ink.fill())))?;
        }
        Data::Range(columns, width) => {
            let half = width / 2.0;
            axes.draw_series(columns.iter().map(|c| {
                let corners = [(c.x - half, c.low), (c.x + half, c.high)];
                Rectangle::new(corners, ink.pale(0.2).fill())
            }))?;
            // A flat stretch has no height: a line keeps it visible.
            axes.draw_series(columns.iter().map(|c| {
                PathElement::new([(c.x - half, c.high), (c.x + half, c.high)], ink.line())
            }))?;
        }
        Data::Bars(points) => {
            axes.draw_series(points.iter().map(|&(x, y, sigma)| {
                let ends = [(x, y - sigma), (x, y + sigma)];
                PathElement::new(ends, ink.pale(0.5).wide(1).line())
            }))?;
            let dots = points.iter();
            axes.draw_series(dots.map(|&(x, y, _)| Circle::new((x, y), 3, ink.fill())))?;
        }
        Data::Bins {
            first,
            width,
            counts,
        } => {
            axes.draw_series(counts.iter().enumerate().map(|(bin, &count)| {
                let edge = |place: f64| first + (bin as f64 + place) * width;
                let corners = [(edge(0.04), 0.0), (edge(0.96), count as f64)];
                Rectangle::new(corners, ink.fill())
            }))?;
        }
        Data::Upright(places) => {
            axes.draw_series(
                places
                    .iter()
                    .map(|&x| PathElement::new([(x, ys.start), (x, ys.end)], ink.line())),
            )?;
        }
        Data::Marks(marks) => {
            let top = ys.end - 0.02 * (ys.end - ys.start);
            axes.draw_series(marks.iter().map(|(x, words)| {
                EmptyElement::at((*x, top))
                    + TriangleMarker::new((0, 22), 5, ink.fill())
                    + Text::new(words.clone(), (-4, 0), ("sans-serif", LABEL))
            }))?;
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
    }

    #[test]
    fn a_stack_has_every_kind_of_data_and_its_legend() {
        let ink = Ink::rgb(1, 2, 3);
        let bins = Data::Bins {
            first: -1.0,
            width: 0.5,
            counts: vec![1, 0, 3],
        };
        let svg = stack(
            (900, 380),
            &[
                Chart::new("x", "y")
                    .title("both")
                    .xs(0.0..10.0)
                    .add(
                        "line",
                        Data::Line(vec![(0.0, 1.0), (9.0, 2.0)]),
                        ink.wide(5),
                    )
                    .add("points", Data::Points(vec![(3.0, 1.5)]), ink.pale(0.5))
                    .add("here", Data::Marks(vec![(4.0, "7".into())]), ink)
                    .add("", Data::Bars(vec![(5.0, 1.0, 0.5)]), ink),
                Chart::new("x", "y").add("bins", bins, ink).add(
                    "median",
                    Data::Upright(vec![0.0]),
                    ink,
                ),
                Chart::default().title(&"word ".repeat(60)),
                Chart::new("x", "y").xs(0.0..10.0).title("nothing"),
            ],
        );
        assert!(svg.starts_with("<svg") && svg.contains("height=\"1520\""));
        for name in [
            "both", "line", "points", "here", "bins", "median", "nothing",
        ] {
            assert!(svg.contains(&format!("\n{name}\n")), "{name}");
        }
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
