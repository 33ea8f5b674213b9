//! Title and legend above the axes of a chart.

use plotters::prelude::*;

use super::{Area, Chart, Data, Drawn, Ink, LABEL, LEFT, LETTER, LINE};

/// Lines of title and legend that the size of a drawing has room for.
pub(super) const USUAL_LINES: i32 = 2;

/// Title and legend, laid out.
pub(super) struct Head<'chart> {
    title: Vec<String>,
    /// Each with its left end and its line of the legend.
    legend: Vec<(i32, i32, &'chart (String, Data, Ink))>,
}

impl<'chart> Head<'chart> {
    pub(super) fn of(chart: &'chart Chart, width: i32) -> Self {
        let (mut x, mut line) = (LEFT, 0);
        let named = chart.series.iter().filter(|(name, ..)| !name.is_empty());
        let legend = named.map(|entry| {
            let long = 48 + LETTER * entry.0.chars().count() as i32;
            if x > LEFT && x + long > width {
                (x, line) = (LEFT, line + 1);
            }
            x += long;
            (x - long, line, entry)
        });
        Self {
            legend: legend.collect(),
            title: wrapped(&chart.heading(), (width - 2 * LEFT) / LETTER),
        }
    }

    pub(super) fn lines(&self) -> i32 {
        let of_legend = self.legend.last().map_or(0, |(_, line, _)| line + 1);
        self.title.len() as i32 + of_legend
    }
}

/// Writes title and legend; returns what is left for the axes.
pub(super) fn head<'svg>(chart: &Chart, area: &Area<'svg>) -> Drawn<Area<'svg>> {
    let head = Head::of(chart, area.dim_in_pixel().0 as i32);
    let text =
        |words: &str, x, y| Text::new(words.to_owned(), (x, y), ("sans-serif", LABEL).into_font());
    let mut top = 10;
    for line in &head.title {
        area.draw(&text(line, LEFT, top))?;
        top += LINE;
    }
    for &(x, line, (name, data, ink)) in &head.legend {
        let y = top + line * LINE;
        let middle = y + LABEL / 2;
        match data {
            Data::Line(_) | Data::Upright(_) | Data::Marks(_) => {
                area.draw(&PathElement::new(
                    [(x, middle), (x + 18, middle)],
                    ink.line(),
                ))?;
            }
            Data::Points(_) | Data::Bars(_) => {
                area.draw(&Circle::new((x + 9, middle), 3, ink.fill()))?;
            }
            Data::Range(..) | Data::Bins { .. } => {
                let corners = [(x, middle - 5), (x + 18, middle + 5)];
                area.draw(&Rectangle::new(corners, ink.fill()))?;
            }
        }
        area.draw(&text(name, x + 24, y))?;
    }
    let used = 10 + head.lines() * LINE;
    Ok(area.split_vertically(used.max(LINE / 2)).1)
}

/// Lines of at most so many letters.
fn wrapped(words: &str, width: i32) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in words.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + word.chars().count() < width as usize => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}
