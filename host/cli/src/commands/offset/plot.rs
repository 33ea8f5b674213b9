//! The plot of `offset`: both gyroscopes before and after, residual, left out. The
//! drawings of [`page::chart`], one below the other.

use std::ops::Range;

use super::fault_text;
use crate::sync_report::{DeviceFault, SyncReport};
use page::chart::{COLOURS, Chart, Data, SIZE, stack};
use twist_sync::compare::{self, Pair};
use twist_sync::{Action, Estimate, GyroTrack, LeftOut, Options, Refusal, Stream, Why};

type Points = Vec<(f64, f64)>;

fn panel(title: &str, unit: &str) -> Chart {
    Chart::new("s", unit).title(title)
}

/// Draws the panels as SVG text. All have one x-scale: seconds from the board's first
/// sample; before, those of each from its own.
pub(super) fn svg(
    mcu: &GyroTrack,
    phone: &GyroTrack,
    result: &Result<Estimate, Refusal>,
    options: &Options,
) -> String {
    let [board_ink, phone_ink, ..] = COLOURS;
    let report = match result {
        Ok(estimate) => &estimate.report,
        Err(refusal) => &refusal.report,
    };
    let outs = [(mcu, Stream::A), (phone, Stream::B)]
        .map(|(track, stream)| compare::left_out(&report.faults, stream, track.len()));
    let axis = |track: &GyroTrack, axis: usize| {
        let points = track.t.iter().zip(&track.w);
        Data::Line(finite(points.map(|(&t, w)| (t, w[axis]))))
    };
    let refused = result.as_ref().err();
    let refused = refused.map(|refusal| format!("REFUSED: {}. ", refusal.report.failures()));
    let refused = refused.unwrap_or_default();
    let before = ["x", "y", "z"].into_iter().enumerate().map(|(k, name)| {
        let title = format!("{refused}Before: {name} as recorded, each from its own first sample");
        panel(if k == 0 { &title } else { name }, "rad/s")
            .add("board", axis(mcu, k), board_ink)
            .add("phone", axis(phone, k), phone_ink)
    });
    let mut panels: Vec<Chart> = before.collect();
    if let Ok(estimate) = result {
        let pairs = compare::pairs(mcu, phone, estimate, options);
        panels.extend(after(&pairs, estimate, mcu.epoch_s));
        panels.push(residual(&pairs, estimate, mcu.epoch_s));
    }
    // The phone's, where a relation of the clocks is known, on the board's time.
    let starts_s = result.as_ref().map_or(0.0, |estimate| {
        let board_s = mcu.epoch_s - options.a_delay_s;
        phone.epoch_s - options.b_delay_s - estimate.clock.offset - board_s
    });
    let left_out = |track: &GyroTrack, out: &[bool], starts_s: f64| {
        let points = out.iter().zip(magnitude(track));
        let points = points.filter_map(|(out, (t, rate))| out.then_some((t + starts_s, rate)));
        Data::Points(finite(points))
    };
    let device_faults = SyncReport::from(report).faults;
    let left = |fault: &&DeviceFault| fault.action == Action::LeftOut;
    let reasons: Vec<String> = device_faults.iter().filter(left).map(fault_text).collect();
    let caption = if reasons.is_empty() {
        String::from("Left out: nothing")
    } else {
        format!("Left out (magnitude as recorded): {}", reasons.join("; "))
    };
    let words = |left_out: &LeftOut| match left_out.why {
        Why::Apart => "not one body",
        Why::Slipped { .. } => "turned",
        Why::TimeStep(_) => "step of time",
    };
    let marks = report.left_out.iter();
    let marks = marks.map(|l| (0.5 * (l.from_s + l.to_s), words(l).to_owned()));
    panels.push(
        panel(&caption, "rad/s")
            .add("board", left_out(mcu, &outs[0], 0.0), board_ink)
            .add("phone", left_out(phone, &outs[1], starts_s), phone_ink)
            .add("", Data::Marks(marks.collect()), COLOURS[3]),
    );
    let ends = report.left_out.iter().flat_map(|l| [l.from_s, l.to_s]);
    let ends: Vec<f64> = ends.collect();
    let shown = shown([(mcu, &outs[0]), (phone, &outs[1])]);
    let panels: Vec<Chart> = panels
        .into_iter()
        .map(|panel| panel.xs(shown.clone()))
        .map(|panel| panel.add("", Data::Upright(ends.clone()), COLOURS[3].pale(0.3)))
        .collect();
    stack(SIZE, &panels)
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

fn after(pairs: &[Pair], estimate: &Estimate, start: f64) -> [Chart; 3] {
    let found = format!(
        "After: offset {:.6} s ± {:.2} µs, skew {:+.1} ± {:.1} ppm; board carried to the phone's axes",
        estimate.clock.offset,
        estimate.offset_sigma_s() * 1e6,
        estimate.clock.skew * 1e6,
        estimate.skew_sigma() * 1e6
    );
    let axes = [(0, format!("{found}. x")), (1, "y".into()), (2, "z".into())];
    axes.map(|(axis, title)| {
        let line = |of: fn(&Pair) -> [f64; 3]| {
            let point = |pair: &Pair| (pair.a_s - start, of(pair)[axis]);
            Data::Line(pairs.iter().map(point).collect())
        };
        panel(&title, "rad/s")
            // Wide and pale below: the two lie on each other.
            .add("board", line(|pair| pair.a), COLOURS[0].wide(5).pale(0.5))
            .add("phone", line(|pair| pair.b), COLOURS[1])
    })
}

fn residual(pairs: &[Pair], estimate: &Estimate, start: f64) -> Chart {
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
        "Residual phone − board, samples as recorded; in band {:.2} mrad/s rms",
        estimate.report.residual_rms.unwrap_or(f64::NAN) * 1e3
    );
    let used = (0..3).flat_map(|axis| points(true, axis));
    let most = used.map(|(_, y)| y.abs()).fold(0.0, f64::max);
    // What was left out must not press the rest flat.
    let out = (0..3).flat_map(|axis| points(false, axis));
    let out = out.filter(|(_, y)| y.abs() <= 1.5 * most).collect();
    let mut chart = panel(&caption, "mrad/s");
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        chart = chart.add(name, Data::Line(points(true, axis)), COLOURS[axis]);
    }
    chart.add(
        "left out, as far as on this scale",
        Data::Points(out),
        COLOURS[3],
    )
}
