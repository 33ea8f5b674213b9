//! Motion from a CSV file: a natural cubic spline through every column.
//!
//! Columns by position, with or without a header row: time in seconds (any
//! origin; the first row is power-on of the rig), angular rate x, y, z in
//! rad/s, and, if there are seven columns, specific force x, y, z in m/s².
//! Without the last three the rig stays level: `[0, 0, 9.80665]`. A file of
//! `smartdepthsync imu --csv` is taken too, by the names of its columns
//! ([`NAMES`]): a real motion, recorded once, can be replayed.
//!
//! Rows must be in order of time. The spline has continuous second
//! derivatives, so the motion is as smooth as an IMU can tell. Before the first
//! and after the last row the rates fade to zero within [`FADE`] seconds.

use std::path::Path;

use anyhow::{Context as _, Result, anyhow, ensure};

use super::STANDARD_GRAVITY;

/// Time in which the rates fade outside of the recording, in seconds.
pub const FADE: f64 = 0.25;

/// Names of columns that are looked for in a header row, in the order of this
/// module's own columns. A header that has the first four decides where they
/// are; any other header is skipped.
pub const NAMES: [&str; 7] = [
    "time_s",
    "gyro_x_rad_s",
    "gyro_y_rad_s",
    "gyro_z_rad_s",
    "accel_x_m_s2",
    "accel_y_m_s2",
    "accel_z_m_s2",
];

/// A recorded motion.
#[derive(Clone, Debug)]
pub struct Recording {
    /// Seconds since the first row.
    times: Vec<f64>,
    /// Rates x, y, z and then forces, each with its second derivatives.
    columns: Vec<Column>,
}

#[derive(Clone, Debug)]
struct Column {
    values: Vec<f64>,
    curvature: Vec<f64>,
}

impl Recording {
    /// Reads a file.
    ///
    /// # Errors
    /// It cannot be read, or is not as the module describes it.
    pub fn load(path: &Path) -> Result<Self> {
        let file = std::fs::File::open(path)
            .with_context(|| format!("cannot read the motion file {}", path.display()))?;
        Self::read(file, path)
    }

    /// Reads a table; `path` is what errors call it.
    ///
    /// # Errors
    /// The table is not as the module describes it.
    pub fn read(from: impl std::io::Read, path: &Path) -> Result<Self> {
        let bad = |line: u64, problem: String| {
            anyhow!("motion file {}, line {line}: {problem}", path.display())
        };
        let mut reader = csv::ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .trim(csv::Trim::All)
            .from_reader(from);
        let mut times: Vec<f64> = Vec::new();
        let mut columns: Vec<Vec<f64>> = Vec::new();
        let mut origin = 0.0;
        let mut named: Option<Vec<usize>> = None;
        let mut width = 0;
        for (i, row) in reader.records().enumerate() {
            let row = row.map_err(|e| {
                let line = e.position().map_or(i as u64 + 1, csv::Position::line);
                bad(line, format!("not CSV: {e}"))
            })?;
            let line = row.position().map_or(i as u64 + 1, csv::Position::line);
            if i == 0 {
                named = by_name(&row);
                width = row.len();
            }
            if named.is_some() && row.len() != width {
                return Err(bad(
                    line,
                    format!("{} columns where the header has {width}", row.len()),
                ));
            }
            let cells: Vec<&str> = match &named {
                Some(places) => places
                    .iter()
                    .map(|&place| row.get(place).unwrap_or_default())
                    .collect(),
                None => row.iter().collect(),
            };
            let parsed: Result<Vec<f64>, _> = cells.iter().map(|c| c.parse::<f64>()).collect();
            let numbers = match parsed {
                Ok(numbers) => numbers,
                Err(_) if i == 0 => continue, // the header
                Err(_) => {
                    let cell = cells.iter().find(|c| c.parse::<f64>().is_err());
                    return Err(bad(
                        line,
                        format!("'{}' is not a number", cell.unwrap_or(&"")),
                    ));
                }
            };
            let first_row = columns.is_empty();
            check_row(&numbers, (!first_row).then_some(columns.len() + 1))
                .map_err(|problem| bad(line, problem))?;
            if first_row {
                columns = vec![Vec::new(); numbers.len() - 1];
                origin = numbers[0];
            }
            let t = numbers[0] - origin;
            if times.last().is_some_and(|&last| t <= last) {
                let problem = format!("time {} is not after the row before", numbers[0]);
                return Err(bad(line, problem));
            }
            times.push(t);
            for (column, value) in columns.iter_mut().zip(&numbers[1..]) {
                column.push(*value);
            }
        }
        ensure!(
            times.len() >= 4,
            "motion file {} has {} rows of data: a motion needs at least 4",
            path.display(),
            times.len()
        );
        let columns = columns
            .into_iter()
            .map(|values| Column {
                curvature: natural_spline(&times, &values),
                values,
            })
            .collect();
        Ok(Self { times, columns })
    }

    /// Length in seconds.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.times.last().copied().unwrap_or(0.0)
    }

    /// Value of a column at `t`, which is held within the recording.
    fn value(&self, column: &Column, t: f64) -> f64 {
        let t = t.clamp(0.0, self.duration());
        // Index of the row after `t`, at least 1 and at most the last.
        let i = self
            .times
            .partition_point(|&x| x <= t)
            .clamp(1, self.times.len() - 1);
        let (x0, x1) = (self.times[i - 1], self.times[i]);
        let h = x1 - x0;
        let (a, b) = ((x1 - t) / h, (t - x0) / h);
        a * column.values[i - 1]
            + b * column.values[i]
            + ((a * a * a - a) * column.curvature[i - 1] + (b * b * b - b) * column.curvature[i])
                * (h * h / 6.0)
    }

    /// 1 within the recording, falling to 0 outside of it.
    fn loudness(&self, t: f64) -> f64 {
        let outside = (-t).max(t - self.duration()).max(0.0) / FADE;
        if outside >= 1.0 {
            0.0
        } else {
            1.0 - outside * outside * (3.0 - 2.0 * outside)
        }
    }

    /// See [`super::Motion::angular_rate`].
    #[must_use]
    pub fn angular_rate(&self, t: f64) -> [f64; 3] {
        let loud = self.loudness(t);
        if loud == 0.0 {
            return [0.0; 3];
        }
        [0, 1, 2].map(|axis| loud * self.value(&self.columns[axis], t))
    }

    /// See [`super::Motion::specific_force`].
    #[must_use]
    pub fn specific_force(&self, t: f64) -> [f64; 3] {
        if self.columns.len() < 6 {
            return [0.0, 0.0, STANDARD_GRAVITY];
        }
        [3, 4, 5].map(|axis| self.value(&self.columns[axis], t))
    }
}

/// Whether a row has as many columns as it should, all finite. `width` is that of the
/// first row, if this is not the first itself.
fn check_row(numbers: &[f64], width: Option<usize>) -> Result<(), String> {
    let found = numbers.len();
    match width {
        None if found != 4 && found != 7 => Err(format!(
            "{found} columns: expected 4 (time in s, rate x, y, z in rad/s) or 7 \
             (the same and specific force x, y, z in m/s²)"
        )),
        Some(width) if found != width => {
            Err(format!("{found} columns where the first row has {width}"))
        }
        _ => match numbers.iter().find(|n| !n.is_finite()) {
            Some(n) => Err(format!("{n} is not a finite number")),
            None => Ok(()),
        },
    }
}

/// Where the columns of [`NAMES`] are in a header row, if it has the first four.
fn by_name(header: &csv::StringRecord) -> Option<Vec<usize>> {
    let places: Vec<usize> = NAMES
        .iter()
        .map_while(|name| header.iter().position(|cell| cell == *name))
        .collect();
    match places.len() {
        7 => Some(places),
        4..7 => places.get(..4).map(<[usize]>::to_vec),
        _ => None,
    }
}

/// Second derivatives of the natural cubic spline through `(x, y)`, by the
/// tridiagonal system of its continuity conditions.
fn natural_spline(x: &[f64], y: &[f64]) -> Vec<f64> {
    let n = x.len();
    let mut curvature = vec![0.0; n];
    let mut upper = vec![0.0; n];
    for i in 1..n - 1 {
        let (before, after) = (x[i] - x[i - 1], x[i + 1] - x[i]);
        let slope_change = (y[i + 1] - y[i]) / after - (y[i] - y[i - 1]) / before;
        let pivot = 2.0 * (before + after) - before * upper[i - 1];
        upper[i] = after / pivot;
        curvature[i] = (6.0 * slope_change - before * curvature[i - 1]) / pivot;
    }
    for i in (1..n - 1).rev() {
        curvature[i] -= upper[i] * curvature[i + 1];
    }
    curvature
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Recording> {
        Recording::read(text.as_bytes(), Path::new("m.csv"))
    }

    #[test]
    fn a_smooth_signal_is_met_between_its_rows() {
        let mut text = String::from("t,x,y,z,fx,fy,fz\n");
        let signal = |t: f64| (5.0 * t).sin();
        for k in 0..=1000 {
            let t = f64::from(k) * 0.01;
            let (s, c) = (signal(t), (3.0 * t).cos());
            text += &format!("{},{s},{c},{},0,{s},9.8\n", 1264.25 + t, -s);
        }
        let r = read(&text).unwrap();
        assert!((r.duration() - 10.0).abs() < 1e-9);
        for k in 100..900 {
            let t = f64::from(k) * 0.010_123;
            let w = r.angular_rate(t);
            // Spline error: h⁴/384 · max |y''''| = 1.6e-8 for 5 rad/s at 10 ms.
            assert!((w[0] - signal(t)).abs() < 1e-7, "{t}");
            assert!((w[1] - (3.0 * t).cos()).abs() < 1e-7);
            assert!((r.specific_force(t)[1] - signal(t)).abs() < 1e-7);
        }
        for k in 0..=1000 {
            let t = r.times[k];
            assert!((r.angular_rate(t)[0] - signal(f64::from(k as u32) * 0.01)).abs() < 1e-12);
        }
    }

    #[test]
    fn a_recording_of_the_host_tool_is_taken_by_its_columns_names() {
        let header = "ticks,time_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,\
                      accel_x_m_s2,accel_y_m_s2,accel_z_m_s2,temperature_c,flags\n";
        let mut text = header.to_owned();
        for k in 0..5 {
            text += &format!("{},{k}.5,1,2,3,4,5,6,30,0\n", k * 96_000);
        }
        let r = read(&text).unwrap();
        assert_eq!(r.duration(), 4.0);
        assert_eq!(r.angular_rate(2.0), [1.0, 2.0, 3.0]);
        assert_eq!(r.specific_force(2.0), [4.0, 5.0, 6.0]);
        let cut = text.replace("2.5,1,2,3", "2.5,1,2");
        let error = read(&cut).unwrap_err().to_string();
        assert!(error.contains("line 4"), "{error}");
    }

    #[test]
    fn rates_fade_outside() {
        let r = read("0,1,2,3\n1,1,2,3\n2,1,2,3\n3,1,2,3\n").unwrap();
        assert_eq!(r.angular_rate(1.5), [1.0, 2.0, 3.0]);
        assert_eq!(r.angular_rate(-FADE), [0.0; 3]);
        assert_eq!(r.angular_rate(3.0 + FADE), [0.0; 3]);
        let half = r.angular_rate(3.0 + FADE / 2.0);
        assert!((half[0] - 0.5).abs() < 1e-12);
        assert_eq!(r.specific_force(1.0), [0.0, 0.0, STANDARD_GRAVITY]);
    }

    #[test]
    fn bad_files_say_which_line() {
        for (text, says) in [
            ("t,x\n1,2\n", "line 2: 2 columns: expected 4"),
            ("t,x,y,z\n1,2,3,4\n2,2,x,4\n", "line 3: 'x' is not a number"),
            ("t,x,y,z\n1,2,3,4\n1,2,3,4\n", "line 3: time 1 is not after"),
            (
                "t,x,y,z\n1,2,3,4\n2,2,3\n",
                "line 3: 3 columns where the first row has 4",
            ),
            ("t,x,y,z\n1,2,inf,4\n", "line 2: inf is not a finite"),
            ("t,x,y,z\n1,2,3,4\n", "has 1 rows"),
            ("", "has 0 rows"),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(says), "{text:?}: {error}");
        }
        let error = Recording::load(Path::new("no-such.csv")).unwrap_err();
        assert!(error.to_string().contains("no-such.csv"));
    }
}
