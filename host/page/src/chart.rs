//! Drawings for reports, as SVG text.
//!
//! All have the same size and type, large enough to be read when a page is shrunk
//! to a phone's width. Time series of any length are drawn as an envelope of at
//! most [`COLUMNS`] columns, so a page stays small after hours of recording.

use std::ops::Range;

use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;

/// Size of every drawing.
pub const SIZE: (u32, u32) = (800, 340);

/// Columns of an envelope.
pub const COLUMNS: usize = 400;

/// Size of axis labels.
const LABEL: i32 = 19;

/// Height of one line of the legend, as a part of the shown range of values.
const LEGEND_ROOM: f64 = 0.12;

/// Colours that differ in print and for most colour-blind readers (Okabe and Ito).
pub const COLOURS: [RGBColor; 4] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
];

/// Smallest and largest value in a column of time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Column {
    /// Middle of the column.
    pub x: f64,
    /// Smallest.
    pub low: f64,
    /// Largest.
    pub high: f64,
}

/// Gathers a series of unknown length into columns, with memory for the columns
/// only: when they are full, pairs are joined and each stands for twice the time.
#[derive(Clone, Debug)]
pub struct Envelope {
    start: Option<f64>,
    width: f64,
    columns: Vec<Option<(f64, f64)>>,
}

impl Default for Envelope {
    fn default() -> Self {
        Self {
            start: None,
            width: 0.01,
            columns: Vec::new(),
        }
    }
}

impl Envelope {
    /// A value; times before the first are left out, and so are values that are
    /// no numbers.
    pub fn add(&mut self, x: f64, value: f64) {
        if !x.is_finite() || !value.is_finite() {
            return;
        }
        let start = *self.start.get_or_insert(x);
        if x < start {
            return;
        }
        loop {
            let index = (x - start) / self.width;
            if index < (2 * COLUMNS) as f64 {
                let index = index as usize;
                if self.columns.len() <= index {
                    self.columns.resize(index + 1, None);
                }
                if let Some(column) = self.columns.get_mut(index) {
                    *column = Some(column.map_or((value, value), |(low, high)| {
                        (low.min(value), high.max(value))
                    }));
                }
                return;
            }
            self.width *= 2.0;
            self.columns = self
                .columns
                .chunks(2)
                .map(|pair| {
                    pair.iter()
                        .flatten()
                        .copied()
                        .reduce(|(low, high), (a, b)| (low.min(a), high.max(b)))
                })
                .collect();
        }
    }

    /// What was gathered.
    #[must_use]
    pub fn columns(&self) -> Vec<Column> {
        let start = self.start.unwrap_or_default();
        self.columns
            .iter()
            .enumerate()
            .filter_map(|(index, column)| {
                let (low, high) = (*column)?;
                Some(Column {
                    x: start + (index as f64 + 0.5) * self.width,
                    low,
                    high,
                })
            })
            .collect()
    }

    /// How long one column is.
    #[must_use]
    pub const fn width(&self) -> f64 {
        self.width
    }
}

/// A series of a drawing.
#[derive(Clone, Debug)]
pub struct Series {
    /// Its name.
    pub name: String,
    /// What is drawn.
    pub data: Data,
}

/// What is drawn.
#[derive(Clone, Debug)]
pub enum Data {
    /// A line through points.
    Line(Vec<(f64, f64)>),
    /// Points by themselves.
    Points(Vec<(f64, f64)>),
    /// The range of values in each column.
    Range(Vec<Column>, f64),
    /// Points with an error bar.
    Bars(Vec<(f64, f64, f64)>),
}

impl Data {
    fn bounds(&self) -> Option<(Range<f64>, Range<f64>)> {
        let points: Vec<(f64, f64, f64)> = match self {
            Self::Line(points) | Self::Points(points) => {
                points.iter().map(|&(x, y)| (x, y, y)).collect()
            }
            Self::Range(columns, _) => columns.iter().map(|c| (c.x, c.low, c.high)).collect(),
            Self::Bars(points) => points.iter().map(|&(x, y, e)| (x, y - e, y + e)).collect(),
        };
        points
            .into_iter()
            .filter(|(x, low, high)| x.is_finite() && low.is_finite() && high.is_finite())
            .fold(None, |bounds, (x, low, high)| {
                Some(match bounds {
                    None => (x..x, low..high),
                    Some((xs, ys)) => (
                        xs.start.min(x)..xs.end.max(x),
                        ys.start.min(low)..ys.end.max(high),
                    ),
                })
            })
    }
}

/// A drawing of series over one axis. `least` is the smallest range of values that
/// is shown, so that noise of a tick does not fill the picture.
///
/// The backend writes into text and cannot fail; if a drawing has nothing to show
/// it is empty.
#[must_use]
pub fn series(x_label: &str, y_label: &str, least: Range<f64>, all: &[Series]) -> String {
    let bounds = all
        .iter()
        .filter_map(|series| series.data.bounds())
        .reduce(|(x, y), (a, b)| {
            (
                x.start.min(a.start)..x.end.max(a.end),
                y.start.min(b.start)..y.end.max(b.end),
            )
        });
    let Some((xs, ys)) = bounds else {
        return String::new();
    };
    let xs = if xs.end > xs.start {
        xs
    } else {
        xs.start - 0.5..xs.end + 0.5
    };
    let ys = ys.start.min(least.start)..ys.end.max(least.end);
    let margin = ((ys.end - ys.start) * 0.06).max(f64::MIN_POSITIVE);
    // Room for the legend, so that it hides nothing.
    let legend = if all.len() > 1 { all.len() } else { 0 };
    let room = (ys.end - ys.start) * LEGEND_ROOM * legend as f64;
    let ys = ys.start - margin..ys.end + margin + room;
    // Points on the edge would be cut in half.
    let points = |series: &Series| matches!(series.data, Data::Points(_) | Data::Bars(_));
    let side = if all.iter().any(points) {
        (xs.end - xs.start) * 0.02
    } else {
        0.0
    };
    let xs = xs.start - side..xs.end + side;
    let mut svg = String::new();
    match draw(&mut svg, (x_label, y_label), xs, ys, all) {
        Ok(()) => svg,
        Err(error) => {
            tracing::warn!("a drawing is left out: {error}");
            String::new()
        }
    }
}

/// An area of the backend that writes into text.
type Area<'svg> = DrawingArea<SVGBackend<'svg>, Shift>;

/// The backend's own error type is not worth naming: it cannot fail.
type Drawn<T> = Result<T, Box<dyn std::error::Error>>;

/// Empty axes with their labels (x, y).
fn axes<'area, 'svg>(
    root: &'area Area<'svg>,
    (x_label, y_label): (&str, &str),
    xs: Range<f64>,
    ys: Range<f64>,
) -> Drawn<ChartContext<'area, SVGBackend<'svg>, Cartesian2d<RangedCoordf64, RangedCoordf64>>> {
    let mut chart = ChartBuilder::on(root)
        .margin(10)
        .margin_right(24)
        .x_label_area_size(52)
        .y_label_area_size(84)
        .build_cartesian_2d(xs, ys)?;
    chart
        .configure_mesh()
        .x_labels(8)
        .y_labels(6)
        .x_desc(x_label)
        .y_desc(y_label)
        .label_style(("sans-serif", LABEL))
        .axis_desc_style(("sans-serif", LABEL))
        .light_line_style(WHITE)
        .draw()?;
    Ok(chart)
}

fn draw(
    svg: &mut String,
    labels: (&str, &str),
    xs: Range<f64>,
    ys: Range<f64>,
    all: &[Series],
) -> Drawn<()> {
    let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    let mut chart = axes(&root, labels, xs, ys)?;
    for (number, series) in all.iter().enumerate() {
        let colour = COLOURS[number % COLOURS.len()];
        match &series.data {
            Data::Line(points) => {
                chart
                    .draw_series(LineSeries::new(
                        points.iter().copied(),
                        colour.stroke_width(2),
                    ))?
                    .label(series.name.as_str())
                    .legend(move |(x, y)| {
                        PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(2))
                    });
            }
            Data::Points(points) => {
                chart
                    .draw_series(
                        points
                            .iter()
                            .map(|&point| Circle::new(point, 2, colour.filled())),
                    )?
                    .label(series.name.as_str())
                    .legend(move |(x, y)| Circle::new((x + 9, y), 3, colour.filled()));
            }
            Data::Range(columns, width) => {
                let half = width / 2.0;
                chart
                    .draw_series(columns.iter().map(|c| {
                        Rectangle::new(
                            [(c.x - half, c.low), (c.x + half, c.high)],
                            colour.mix(0.8).filled(),
                        )
                    }))?
                    .label(series.name.as_str())
                    .legend(move |(x, y)| {
                        Rectangle::new([(x, y - 5), (x + 18, y + 5)], colour.filled())
                    });
                // A flat stretch has no height: a line keeps it visible.
                chart.draw_series(columns.iter().map(|c| {
                    PathElement::new(
                        [(c.x - half, c.high), (c.x + half, c.high)],
                        colour.stroke_width(2),
                    )
                }))?;
            }
            Data::Bars(points) => {
                chart
                    .draw_series(points.iter().map(|&(x, y, sigma)| {
                        PathElement::new([(x, y - sigma), (x, y + sigma)], colour.mix(0.5))
                    }))?
                    .label(series.name.as_str())
                    .legend(move |(x, y)| Circle::new((x + 9, y), 3, colour.filled()));
                chart.draw_series(
                    points
                        .iter()
                        .map(|&(x, y, _)| Circle::new((x, y), 3, colour.filled())),
                )?;
            }
        }
    }
    if all.len() > 1 {
        chart
            .configure_series_labels()
            .background_style(WHITE.mix(0.85))
            .border_style(BLACK.mix(0.2))
            .label_font(("sans-serif", LABEL))
            .position(SeriesLabelPosition::UpperRight)
            .draw()?;
    }
    root.present()?;
    drop(chart);
    drop(root);
    Ok(())
}

/// Bars over bins of equal width: `first` is the left end of the first bin.
#[must_use]
pub fn histogram(x_label: &str, y_label: &str, first: f64, bin: f64, counts: &[u64]) -> String {
    let mut svg = String::new();
    let top = counts.iter().copied().max().unwrap_or(0).max(1) as f64;
    let edge = |index: usize| first + index as f64 * bin;
    let mut draw = || -> Drawn<()> {
        let root = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        let xs = edge(0)..edge(counts.len().max(1));
        let mut chart = axes(&root, (x_label, y_label), xs, 0.0..top * 1.05)?;
        chart.draw_series(counts.iter().enumerate().map(|(index, &count)| {
            Rectangle::new(
                [(edge(index), 0.0), (edge(index + 1), count as f64)],
                COLOURS[0].mix(0.75).filled(),
            )
        }))?;
        root.present()?;
        Ok(())
    };
    if let Err(error) = draw() {
        tracing::warn!("a drawing is left out: {error}");
        return String::new();
    }
    svg
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_envelope_keeps_every_extreme_and_stays_small() {
        let mut envelope = Envelope::default();
        for k in 0..2_000_000_u32 {
            let value = if k == 1_234_567 {
                99.0
            } else {
                f64::from(k % 7)
            };
            envelope.add(f64::from(k) * 0.002, value);
        }
        let columns = envelope.columns();
        assert!(columns.len() <= 2 * COLUMNS, "{}", columns.len());
        let top = columns
            .iter()
            .max_by(|a, b| a.high.total_cmp(&b.high))
            .unwrap();
        assert_eq!(top.high, 99.0);
        assert!((top.x - 2_469.134).abs() <= envelope.width());
        assert!(columns.iter().all(|column| column.low == 0.0));
    }

    #[test]
    fn an_envelope_takes_any_number() {
        let mut envelope = Envelope::default();
        for x in [0.0, f64::NAN, -1.0, 1e300, f64::INFINITY, 5.0] {
            envelope.add(x, x);
        }
        assert!(envelope.columns().len() <= 2 * COLUMNS);
    }

    #[test]
    fn nothing_to_draw_gives_nothing() {
        assert_eq!(series("x", "y", 0.0..0.0, &[]), "");
        let svg = series(
            "x",
            "y",
            0.0..1.0,
            &[Series {
                name: "<a>".into(),
                data: Data::Line(vec![(1.0, 2.0)]),
            }],
        );
        assert!(svg.starts_with("<svg"), "{svg}");
    }
}
