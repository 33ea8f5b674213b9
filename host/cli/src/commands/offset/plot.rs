//! The plot of `offset`: both gyroscopes before and after, residual, left out. The
//! drawings of [`page::chart`], one below the other.

use page::chart::{COLOURS, Chart, Data, SIZE, stack};
use twist_sync::compare::{self, Pair};
use twist_sync::{Estimate, GyroTrack, Options, Refusal, Stream};

type Points = Vec<(f64, f64)>;

fn panel(title: &str, unit: &str) -> Chart {
    Chart::new("s", unit).title(title)
}

/// Draws the panels as SVG text.
pub(super) fn svg(
    mcu: &GyroTrack,
    phone: &GyroTrack,
    result: &Result<Estimate, Refusal>,
    options: &Options,
) -> String {
    let [board_ink, phone_ink, ..] = COLOURS;
    let before = "Before: magnitude of the rate, each from its own first sample";
    let line = |track| Data::Line(finite(magnitude(track)));
    let mut panels = vec![
        panel(before, "rad/s")
            .add("board", line(mcu), board_ink)
            .add("phone", line(phone), phone_ink),
    ];
    let report = match result {
        Ok(estimate) => {
            let pairs = compare::pairs(mcu, phone, estimate, options);
            panels.extend(after(&pairs, estimate));
            panels.push(residual(&pairs, estimate));
            &estimate.report
        }
        Err(refusal) => {
            let reasons = format!("REFUSED: {}", refusal.report.failures());
            panels.push(panel(&reasons, ""));
            &refusal.report
        }
    };
    let left_out = |track: &GyroTrack, stream: Stream| {
        let out = compare::left_out(&report.faults, stream, track.len());
        let points = out.iter().zip(magnitude(track));
        Data::Points(finite(
            points.filter_map(|(out, point)| out.then_some(point)),
        ))
    };
    let caption = "Left out (samples as recorded, each from its own first sample)";
    panels.push(
        panel(caption, "rad/s")
            .add("board", left_out(mcu, Stream::A), board_ink)
            .add("phone", left_out(phone, Stream::B), phone_ink),
    );
    stack(SIZE, &panels)
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

fn after(pairs: &[Pair], estimate: &Estimate) -> [Chart; 3] {
    let found = format!(
        "After: offset {:.6} s ± {:.2} µs, skew {:+.1} ± {:.1} ppm; board carried to the phone's axes",
        estimate.clock.offset,
        estimate.offset_sigma_s() * 1e6,
        estimate.clock.skew * 1e6,
        estimate.skew_sigma() * 1e6
    );
    let start = pairs.first().map_or(0.0, |pair| pair.a_s);
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

fn residual(pairs: &[Pair], estimate: &Estimate) -> Chart {
    let start = pairs.first().map_or(0.0, |pair| pair.a_s);
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
    let out = (0..3).flat_map(|axis| points(false, axis)).collect();
    let mut chart = panel(&caption, "mrad/s");
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        chart = chart.add(name, Data::Line(points(true, axis)), COLOURS[axis]);
    }
    chart.add("left out", Data::Points(out), COLOURS[3])
}
