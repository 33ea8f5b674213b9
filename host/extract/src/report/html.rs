//! The report as a page, with its drawings.

use std::fmt::Write;

use page::chart::{self, Data, Series};
use page::{Level, Page};
use serde_json::json;

use super::ExtractReport;
use crate::gyro_clock::WindowResult;
use crate::strip;

impl ExtractReport {
    /// The report as a page without anything from outside. `samples` is a drawing of sample
    /// pairs.
    pub(crate) fn html(&self, samples: Option<&str>) -> String {
        let (level, verdict) = self.verdict();
        let title = format!("Extraction of {}", self.recording);
        let mut page = Page::new(&title, level, &verdict);
        page.facts(&self.lines());
        if !self.losses.is_empty() {
            page.section("Missing or damaged");
            let rows: Vec<Vec<String>> = self
                .losses
                .iter()
                .map(|loss| vec![loss.part.to_owned(), loss.what.clone()])
                .collect();
            page.table(&["part", "what is missing, and what that means"], &rows);
        }
        if !self.remarks.is_empty() {
            page.section("Remarks");
            for remark in &self.remarks {
                page.note(Level::Good, remark);
            }
        }
        if let Some(pairs) = &self.pairs {
            page.section("Time difference of the pairs");
            let histogram = &pairs.central;
            let svg = chart::histogram(
                "depth − phone, µs",
                "pairs",
                histogram.first_ns as f64 / 1000.0,
                histogram.bin_ns as f64 / 1000.0,
                &histogram.counts,
            );
            let mut caption = String::from(
                "Middle of exposure of the depth image minus that of the phone's frame it is paired \
                 with, both in board time.",
            );
            let shown: u64 = histogram.counts.iter().sum();
            let outside = (pairs.spread.count as u64).saturating_sub(shown);
            if outside > 0 {
                let [least, most] = pairs.spread.range_ns.map(|ns| ns as f64 / 1e6);
                let _ = write!(
                    caption,
                    " {outside} of {} pairs are further off than is shown ({least:.3} to {most:.3} ms \
                     in all), as pairs are before the trigger has arrived on the phone's frames.",
                    pairs.spread.count
                );
            }
            page.figure(&svg, &caption);
            page.figure(
                &pairs_svg(&pairs.course),
                "The same over time. A slope is a drift of the trigger against the phone's frames.",
            );
            if let Some(samples) = samples {
                page.figure(samples, strip::CAPTION);
            }
        }
        if let Some(clock) = self.clock.as_ref().filter(|clock| clock.course.len() > 1) {
            page.section("Clock of the phone");
            page.figure(
                &course_svg(&clock.course),
                "What the two gyroscopes say in each window against the smoothed course, with \
                 1-sigma of both.",
            );
        }
        for other in &self.phones {
            if let Some(clock) = other.clock.as_ref().filter(|clock| clock.course.len() > 1) {
                page.section(&format!("Clock of phone {}", other.name));
                page.figure(
                    &course_svg(&clock.course),
                    "As above, for this phone. The trigger does not follow its frames.",
                );
            }
        }
        if self.sequences.len() > 1 {
            page.section("Sequences");
            let rows: Vec<Vec<String>> = self
                .sequences
                .iter()
                .map(|part| {
                    vec![
                        part.folder.clone(),
                        part.color.to_string(),
                        part.depth.to_string(),
                        part.pairs.to_string(),
                    ]
                })
                .collect();
            page.table(&["folder", "phone", "depth", "pairs"], &rows);
        }
        page.settings(
            "Settings: constants that went into the times, ns",
            &json!(self.constants),
        );
        page.html()
    }
}

/// The difference of each pair over time.
fn pairs_svg(course: &[(i64, i64)]) -> String {
    let points = course
        .iter()
        .map(|&(at, difference)| (at as f64 * 1e-9, difference as f64 / 1000.0));
    let series = Series {
        name: String::from("pairs"),
        data: Data::Points(points.collect()),
    };
    chart::series("board time, s", "depth − phone, µs", -1.0..1.0, &[series])
}

/// Windows against the course, with the course's own band.
fn course_svg(course: &[WindowResult]) -> String {
    let band = |sign: f64| {
        Data::Line(
            course
                .iter()
                .map(|window| (window.board_s, sign * window.course_sigma_s * 1e6))
                .collect(),
        )
    };
    let windows = course
        .iter()
        .map(|window| {
            (
                window.board_s,
                window.residual_s * 1e6,
                window.sigma_s * 1e6,
            )
        })
        .collect();
    let series = |name: &str, data| Series {
        name: name.to_owned(),
        data,
    };
    chart::series(
        "board time, s",
        "window − course, µs",
        -1.0..1.0,
        &[
            series("windows", Data::Bars(windows)),
            series("+1-sigma of the course", band(1.0)),
            series("−1-sigma", band(-1.0)),
        ],
    )
}
