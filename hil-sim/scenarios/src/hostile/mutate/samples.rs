//! Mutations of gyroscope samples that any reader takes, so that they get to the estimator:
//! times and rates are numbers as before, and rows stay rows.

use std::fs;
use std::path::Path;

use anyhow::Result;

use super::Draw;

/// A row: three rates in rad/s, and its time as it is written.
struct Row {
    rates: [f64; 3],
    time: f64,
}

/// How the columns of a file lie.
struct Form {
    header: Option<String>,
    /// Time first, in seconds; otherwise last, in nanoseconds.
    time_first: bool,
}

impl Form {
    /// Of a text that has a header, or not.
    fn parse(text: &str) -> (Self, Vec<Row>) {
        let header = text.lines().next().filter(|line| line.contains("time"));
        let form = Self {
            header: header.map(str::to_owned),
            time_first: header.is_some(),
        };
        let rows = text.lines().filter_map(|line| form.row(line)).collect();
        (form, rows)
    }

    fn row(&self, line: &str) -> Option<Row> {
        let cells: Vec<f64> = line
            .split(',')
            .filter_map(|cell| cell.parse().ok())
            .collect();
        let cells: [f64; 4] = cells.try_into().ok()?;
        Some(if self.time_first {
            let [time, x, y, z] = cells;
            Row {
                rates: [x, y, z],
                time,
            }
        } else {
            let [x, y, z, time] = cells;
            Row {
                rates: [x, y, z],
                time,
            }
        })
    }

    fn write(&self, rows: &[Row]) -> String {
        let mut lines: Vec<String> = self.header.iter().cloned().collect();
        lines.extend(rows.iter().map(
            |Row {
                 rates: [x, y, z],
                 time,
             }| {
                if self.time_first {
                    format!("{time:.9},{x},{y},{z}")
                } else {
                    format!("{x},{y},{z},{time:.0}")
                }
            },
        ));
        lines.join("\n")
    }

    /// One second of this file's time.
    const fn second(&self) -> f64 {
        if self.time_first { 1.0 } else { 1e9 }
    }
}

/// Factors of rates, and rates themselves.
const RATES: [f64; 9] = [0.0, -1.0, 1e-300, 1e-9, 35.0, 1e3, 1e6, 1e30, 1e300];
/// Distances in time, s.
const STEPS: [f64; 9] = [0.0, 1e-9, -1e-9, 0.002, -0.002, 0.5, -0.5, 3_600.0, 5e5];

pub(super) fn mutate(draw: &mut Draw<'_>, file: &Path) -> Result<String> {
    let (form, mut rows) = Form::parse(&fs::read_to_string(file)?);
    if rows.len() < 2 {
        return Ok(String::from("no samples are left"));
    }
    let from = draw.below(rows.len() - 1);
    let count = [1, 1, 20, 500, rows.len()][draw.below(5)].min(rows.len() - from);
    let those = from..from + count;
    let what = match draw.below(8) {
        0 => {
            let (axis, value) = (draw.below(3), *draw.one_of(&RATES));
            rows[those]
                .iter_mut()
                .for_each(|row| row.rates[axis] = value);
            format!("rate {axis} = {value:e}")
        }
        1 => {
            let (axis, value) = (draw.below(3), *draw.one_of(&RATES));
            rows[those]
                .iter_mut()
                .for_each(|row| row.rates[axis] *= value);
            format!("rate {axis} times {value:e}")
        }
        2 => {
            let step = *draw.one_of(&STEPS);
            rows[those]
                .iter_mut()
                .for_each(|row| row.time += step * form.second());
            format!("times {step:+} s")
        }
        3 => {
            // A clock that is fast or slow, or stands.
            let (begin, scale) = (rows[from].time, [0.0, 0.5, 0.999, 1.001, 2.0, 100.0]);
            let scale = *draw.one_of(&scale);
            for row in &mut rows[those] {
                row.time = begin + (row.time - begin) * scale;
            }
            format!("clock times {scale}")
        }
        4 => {
            rows.drain(those);
            String::from("rows are gone")
        }
        5 => {
            rows[those].reverse();
            String::from("rows reversed")
        }
        6 => {
            let (rates, time) = (rows[from].rates, rows[from].time);
            let times = [2, 50, 5_000][draw.below(3)];
            rows.splice(from..from, (0..times).map(|_| Row { rates, time }));
            format!("the first {times} times more")
        }
        _ => {
            let (a, b) = (draw.below(3), draw.below(3));
            rows[those].iter_mut().for_each(|row| row.rates.swap(a, b));
            format!("axes {a} and {b} swapped")
        }
    };
    fs::write(file, form.write(&rows))?;
    Ok(format!(
        "{}: rows {from}, {count} of them: {what}",
        file.display()
    ))
}
