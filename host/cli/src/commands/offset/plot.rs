//! The plot of `offset`: both gyroscopes before and after, residual, left out. The
//! drawings of [`page::chart`], one below the other.

use page::chart::{self, Data, SIZE, Series};
use page::escape;
use twist_sync::compare::{self, Pair};
use twist_sync::{Estimate, GyroTrack, Options, Refusal, Stream};

/// Height of a line of text.
const LINE: u32 = 28;

/// Letters in a line of text.
const LETTERS: usize = 80;

type Points = Vec<(f64, f64)>;

/// Texts and drawings, one below the other.
#[derive(Default)]
struct Sheet {
    svg: String,
    height: u32,
}

impl Sheet {
    fn text(&mut self, text: &str) {
        for line in wrapped(text, LETTERS) {
            self.height += LINE;
            self.svg.push_str(&format!(
                "<text x=\"20\" y=\"{}\" font-family=\"sans-serif\" font-size=\"18\">{}</text>\n",
                self.height - 8,
                escape(&line)
            ));
        }
    }

    fn panel(&mut self, caption: &str, unit: &str, series: &[Series]) {
        self.text(caption);
        let top = self.height;
        let drawing = chart::series("s", unit, 0.0..0.0, series);
        self.svg.push_str(&format!(
            "<g transform=\"translate(0,{top})\">{drawing}</g>\n"
        ));
        self.height += SIZE.1;
    }

    fn finish(self) -> String {
        let (width, height) = (SIZE.0, self.height);
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"0 0 {width} {height}\">\n<rect width=\"100%\" height=\"100%\" \
             fill=\"white\"/>\n{}</svg>\n",
            self.svg
        )
    }
}

fn line(name: &str, points: Points) -> Series {
    Series {
        name: name.to_owned(),
        data: Data::Line(points),
    }
}

fn dots(name: &str, points: Points) -> Series {
    Series {
        name: name.to_owned(),
        data: Data::Points(points),
    }
}

/// Draws the panels as SVG text.
pub(super) fn svg(
    mcu: &GyroTrack,
    phone: &GyroTrack,
    result: &Result<Estimate, Refusal>,
    options: &Options,
) -> String {
    let mut sheet = Sheet::default();
    let before = "Before: magnitude of the rate, each from its own first sample";
    let both = [
        line("board", finite(magnitude(mcu))),
        line("phone", finite(magnitude(phone))),
    ];
    sheet.panel(before, "rad/s", &both);
    let report = match result {
        Ok(estimate) => {
            let pairs = compare::pairs(mcu, phone, estimate, options);
            after(&mut sheet, &pairs, estimate);
            residual(&mut sheet, &pairs, estimate);
            &estimate.report
        }
        Err(refusal) => {
            sheet.text(&format!("REFUSED: {}", refusal.report.failures()));
            &refusal.report
        }
    };
    let left_out = |track: &GyroTrack, stream: Stream| -> Points {
        let out = compare::left_out(&report.faults, stream, track.len());
        let points = out.iter().zip(magnitude(track));
        finite(points.filter_map(|(out, point)| out.then_some(point)))
    };
    let caption = "Left out (samples as recorded, each from its own first sample)";
    let both = [
        dots("board", left_out(mcu, Stream::Mcu)),
        dots("phone", left_out(phone, Stream::Phone)),
    ];
    sheet.panel(caption, "rad/s", &both);
    sheet.finish()
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

fn after(sheet: &mut Sheet, pairs: &[Pair], estimate: &Estimate) {
    sheet.text(&format!(
        "After: offset {:.6} s ± {:.2} µs, skew {:+.1} ± {:.1} ppm; board carried to the phone's axes",
        estimate.clock.offset,
        estimate.offset_sigma_s() * 1e6,
        estimate.clock.skew * 1e6,
        estimate.skew_sigma() * 1e6
    ));
    let start = pairs.first().map_or(0.0, |pair| pair.board_s);
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let points = |of: fn(&Pair) -> [f64; 3]| -> Points {
            let point = |pair: &Pair| (pair.board_s - start, of(pair)[axis]);
            pairs.iter().map(point).collect()
        };
        let both = [
            line("board", points(|pair| pair.mcu)),
            line("phone", points(|pair| pair.phone)),
        ];
        sheet.panel(name, "rad/s", &both);
    }
}

fn residual(sheet: &mut Sheet, pairs: &[Pair], estimate: &Estimate) {
    let start = pairs.first().map_or(0.0, |pair| pair.board_s);
    let points = |used: bool, axis: usize| -> Points {
        let pairs = pairs.iter().filter(|pair| pair.used == used);
        pairs
            .map(|pair| {
                (
                    pair.board_s - start,
                    1e3 * (pair.phone[axis] - pair.mcu[axis]),
                )
            })
            .collect()
    };
    let out = (0..3).flat_map(|axis| points(false, axis)).collect();
    let caption = format!(
        "Residual phone − board, samples as recorded; in band {:.2} mrad/s rms",
        estimate.report.residual_rms.unwrap_or(f64::NAN) * 1e3
    );
    let series = [
        line("x", points(true, 0)),
        line("y", points(true, 1)),
        line("z", points(true, 2)),
        dots("left out", out),
    ];
    sheet.panel(&caption, "mrad/s", &series);
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
