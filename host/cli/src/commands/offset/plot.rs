//! The plot of `offset`: both gyroscopes before and after, residual, left out. The
//! drawings of [`report::chart`], one below the other.

use std::ops::Range;
use std::path::Path;

use super::fault_found;
use crate::context::Context;
use crate::outcome::Failure;
use report::chart::{COLOURS, Chart, Data, SIZE, stack};
use session::twist_report::report_of;
use twist_sync::compare::{self, Pair};
use twist_sync::{
    Action, Estimate, FaultKind, GyroTrack, LeftOut, Options, Refusal, Report, Stream, Why,
};

/// Samples this far apart are not joined by a line, seconds.
const LONGEST_STEP_S: f64 = 0.05;

type Points = Vec<(f64, f64)>;

fn panel(title: &str, unit: &str) -> Chart {
    Chart::new("s", unit).title(title)
}

/// Draws the panels as SVG text. All have one x-scale: seconds from the first one's first
/// sample; before, those of each from its own.
pub(in crate::commands) fn svg(
    names: [&str; 2],
    [a, b]: [&GyroTrack; 2],
    result: &Result<Estimate, Refusal>,
    options: &Options,
) -> String {
    let [a_ink, b_ink, ..] = COLOURS;
    let report = report_of(result);
    let outs = [(a, Stream::A), (b, Stream::B)]
        .map(|(track, stream)| compare::left_out(&report.faults, stream, track.len()));
    let axis = |track: &GyroTrack, axis: usize| {
        let points = track.t.iter().zip(&track.w);
        Data::Line(finite(points.map(|(&t, w)| (t, w[axis]))))
    };
    let refused = result.as_ref().err();
    let refused = refused.map(|refusal| format!("REFUSED: {}. ", refusal.report.failures()));
    let refused = refused.unwrap_or_default();
    let before = ["x", "y", "z"].into_iter().enumerate().map(|(k, name)| {
        let title = format!("{refused}Before: as recorded, each from its own first sample. x");
        panel(if k == 0 { &title } else { name }, "rad/s")
            .add(names[0], axis(a, k), a_ink)
            .add(names[1], axis(b, k), b_ink)
    });
    let before: Vec<Chart> = before.collect();
    let mut panels = Vec::new();
    if let Ok(estimate) = result {
        let pairs = compare::pairs(a, b, estimate, options);
        panels.extend(after(names, &pairs, estimate, a.epoch_s));
        panels.push(residual(names, &pairs, estimate, a.epoch_s));
    }
    // Those of b, where a relation of the clocks is known, on the time of a.
    let starts_s = result.as_ref().map_or(0.0, |estimate| {
        let a_s = a.epoch_s - options.a_delay_s;
        b.epoch_s - options.b_delay_s - estimate.clock.offset - a_s
    });
    let left_out = |track: &GyroTrack, out: &[bool], starts_s: f64| {
        let points = out.iter().zip(magnitude(track));
        let points = points.filter_map(|(out, (t, rate))| out.then_some((t + starts_s, rate)));
        Data::Points(finite(points))
    };
    let words = |left_out: &LeftOut| match left_out.why {
        Why::Apart => "not one body",
        Why::Slipped { .. } => "turned",
        Why::TimeStep(_) => "step of time",
    };
    let marks = report.left_out.iter();
    let marks = marks.map(|l| (0.5 * (l.from_s + l.to_s), words(l).to_owned()));
    let reasons = reasons(report, names);
    if !reasons.is_empty() {
        panels.push(
            panel(&format!("{reasons}; magnitude as recorded"), "rad/s")
                .add(names[0], left_out(a, &outs[0], 0.0), a_ink)
                .add(names[1], left_out(b, &outs[1], starts_s), b_ink)
                .add("", Data::Marks(marks.collect()), COLOURS[3]),
        );
    }
    let ends = report.left_out.iter().flat_map(|l| [l.from_s, l.to_s]);
    let ends: Vec<f64> = ends.collect();
    let shown = shown([(a, &outs[0]), (b, &outs[1])]);
    // On the first one's time only: before, each recording has its own.
    let marked = |panel: Chart| panel.add("", Data::Upright(ends.clone()), COLOURS[3].pale(0.3));
    let panels: Vec<Chart> = before
        .into_iter()
        .chain(panels.into_iter().map(marked))
        .map(|panel| panel.xs(shown.clone()))
        .collect();
    stack(SIZE, &panels)
}

/// Writes a plot, and says where it is.
pub(in crate::commands) fn write(path: &Path, svg: &str, context: &Context) -> Result<(), Failure> {
    std::fs::write(path, svg).map_err(|error| Failure::file("write", path, &error))?;
    context.say(format!("plot: {}", path.display()));
    Ok(())
}

/// What was left out and why, in words; empty where nothing was.
fn reasons(report: &Report, names: [&str; 2]) -> String {
    let is_stretch = |kind| {
        matches!(
            kind,
            FaultKind::NotOneBody | FaultKind::Slipped | FaultKind::TimestampStep
        )
    };
    let of_samples = report.faults.iter().filter(|fault| {
        fault.action == Action::LeftOut && (report.left_out.is_empty() || !is_stretch(fault.kind))
    });
    let of_samples: Vec<String> = of_samples.map(|fault| fault_found(fault, names)).collect();
    let stretches = report.left_out.iter().map(LeftOut::to_string);
    let mut all: Vec<String> = stretches.collect();
    if !of_samples.is_empty() {
        all.push(format!("left out: {}", of_samples.join("; ")));
    }
    let all = all.join("; ");
    all.replacen("left", "Left", 1)
}

/// The time of both recordings, without timestamps that were left out.
fn shown(recordings: [(&GyroTrack, &Vec<bool>); 2]) -> Range<f64> {
    let used = |(track, out): (&'_ GyroTrack, &'_ Vec<bool>)| -> Vec<f64> {
        let times = track.t.iter().zip(out);
        let used = times.filter(|(t, out)| !**out && t.is_finite());
        used.map(|(t, _)| *t).collect()
    };
    let times: Vec<f64> = recordings.into_iter().flat_map(used).collect();
    let last = times.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let first = times.iter().copied().fold(f64::INFINITY, f64::min);
    if first < last { first..last } else { 0.0..1.0 }
}

fn magnitude(track: &GyroTrack) -> impl Iterator<Item = (f64, f64)> {
    let norm = |w: &[f64; 3]| w.iter().map(|axis| axis * axis).sum::<f64>().sqrt();
    track
        .t
        .iter()
        .zip(&track.w)
        .map(move |(&t, w)| (t, norm(w)))
}

fn finite(points: impl Iterator<Item = (f64, f64)>) -> Points {
    points
        .filter(|(x, y)| x.is_finite() && y.is_finite())
        .collect()
}

fn after(names: [&str; 2], pairs: &[Pair], estimate: &Estimate, start: f64) -> [Chart; 3] {
    let found = format!(
        "After: offset {:.6} s ± {:.2} µs, skew {:+.1} ± {:.1} ppm; {} turned to {}'s axes",
        estimate.clock.offset,
        estimate.offset_sigma_s() * 1e6,
        estimate.clock.skew * 1e6,
        estimate.skew_sigma() * 1e6,
        names[0],
        names[1]
    );
    let axes = [(0, format!("{found}. x")), (1, "y".into()), (2, "z".into())];
    axes.map(|(axis, title)| {
        let line = |of: fn(&Pair) -> [f64; 3]| {
            let point = |pair: &Pair| (pair.a_s - start, of(pair)[axis]);
            Data::Line(pairs.iter().map(point).collect())
        };
        panel(&title, "rad/s")
            // Wide and pale below: the two lie on each other.
            .add(names[0], line(|pair| pair.a), COLOURS[0].wide(5).pale(0.5))
            .add(names[1], line(|pair| pair.b), COLOURS[1])
    })
}

fn residual(names: [&str; 2], pairs: &[Pair], estimate: &Estimate, start: f64) -> Chart {
    let points = |used: bool, axis: usize| -> Points {
        let pairs = pairs.iter().filter(|pair| pair.used == used);
        pairs
            .map(|pair| {
                let residual = pair.b[axis] - pair.a[axis];
                (pair.a_s - start, 1e3 * residual)
            })
            .collect()
    };
    let caption = format!(
        "Residual {} − {}, samples as recorded; in band {:.2} mrad/s rms",
        names[1],
        names[0],
        estimate.report.residual_rms.unwrap_or(f64::NAN) * 1e3
    );
    let used = (0..3).flat_map(|axis| points(true, axis));
    let most = used.map(|(_, y)| y.abs()).fold(0.0, f64::max);
    // What was left out must not press the rest flat.
    let out = (0..3).flat_map(|axis| points(false, axis));
    let out = out.filter(|(_, y)| y.abs() <= 1.5 * most).collect();
    let mut chart = panel(&caption, "mrad/s");
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let points = points(true, axis);
        // No line over a stretch that was left out.
        let runs = points.chunk_by(|(t, _), (next, _)| next - t <= LONGEST_STEP_S);
        for (k, run) in runs.enumerate() {
            let name = if k == 0 { name } else { "" };
            chart = chart.add(name, Data::Line(run.to_vec()), COLOURS[axis]);
        }
    }
    chart.add(
        "left out, as far as on this scale",
        Data::Points(out),
        COLOURS[3],
    )
}
