//! The estimates of each pair over time, about the straight line through the ends of its
//! course.

use report::chart::{COLOURS, Chart, Data, SIZE, stack};

use super::related::Related;

/// Points of a course.
const POINTS: u32 = 300;

pub(super) fn svg(pairs: &[Related]) -> String {
    let charts: Vec<Chart> = pairs.iter().map(chart).collect();
    stack(SIZE, &charts)
}

fn chart(related: &Related) -> Chart {
    let [a, b] = related.of.map(|k| k + 1);
    let course = match &related.course {
        Ok(course) => course,
        Err(why) => {
            return Chart::default().title(&format!("Recordings {a} and {b}: REFUSED: {why}"));
        }
    };
    let (from, to) = course.span();
    let (first, last) = (course.at(from), course.at(to));
    let slope = if to > from {
        (last.offset - first.offset) / (to - from)
    } else {
        first.skew
    };
    let line = |t: f64| first.offset + slope * (t - from);
    let bar = |estimate: &twist_sync::ClockRelation| {
        let t = estimate.reference;
        let sigma = estimate.offset_at(t).sigma;
        (t, (estimate.offset - line(t)) * 1e6, sigma * 1e6)
    };
    let points = (0..=POINTS).map(|k| from + (to - from) * f64::from(k) / f64::from(POINTS));
    let curve = points.map(|t| (t, (course.at(t).offset - line(t)) * 1e6));
    let middle_s = 0.5 * (from + to);
    let title = format!(
        "Clock {b} − clock {a}, less a line of {:+.3} ppm: ± {:.2} µs in the middle, {} of {} windows",
        slope * 1e6,
        course.at(middle_s).offset_at(middle_s).sigma * 1e6,
        course.used,
        related.windows
    );
    Chart::new(&format!("s from the first sample of {a}"), "µs")
        .title(&title)
        .least(-1.0..1.0)
        .add(
            "windows",
            Data::Bars(related.estimates.iter().map(bar).collect()),
            COLOURS[0],
        )
        .add("smoothed", Data::Line(curve.collect()), COLOURS[1])
}
