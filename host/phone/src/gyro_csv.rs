//! Gyroscope recordings as CSV, in the two forms that exist.
//!
//! * **With a header**: a time column and three columns x, y, z, in any order, found
//!   by name (`mcu_time,mcu_x,mcu_y,mcu_z`; `sm_time,…`; `timestamp,wx,wy,wz`;
//!   `t,gyro_x,…`). A name that carries a unit (`timestamp_ns`, `time [us]`,
//!   `gyro_x_dps`) is believed. Without one, times are in the unit in which the samples
//!   are [`LONGEST_STEP_S`] apart at most, and rates in rad/s. More columns are ignored,
//!   those of an accelerometer or a magnetometer too.
//! * **The phone app's form**: no header, `x,y,z,timestamp` with the timestamp
//!   in integer nanoseconds.
//!
//! The first line that is not as expected stops the reading, with its number
//! and what was expected; nothing is skipped in silence. Empty lines are.

use std::fmt;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use timebase::PhoneNanos;
use timebase::phone_track;
use twist_sync::GyroTrack;

/// Which form a file had.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Form {
    /// A header, with the names of the columns that were taken and the time's unit.
    Header {
        /// Names of time, x, y, z.
        columns: [String; 4],
        /// Unit of the time column.
        unit: TimeUnit,
        /// The unit is not in the name: it is the one that is plausible.
        unit_by_step: bool,
        /// Unit of the rates.
        rates: RateUnit,
    },
    /// The phone app's `x,y,z,nanoseconds`.
    PhoneApp,
}

/// Unit of the rates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RateUnit {
    /// rad/s.
    RadPerSecond,
    /// Degrees a second; they are converted.
    DegPerSecond,
}

/// Unit of a time column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TimeUnit {
    /// Seconds.
    Seconds,
    /// Milliseconds.
    Milliseconds,
    /// Microseconds.
    Microseconds,
    /// Nanoseconds.
    Nanoseconds,
}

impl TimeUnit {
    fn nanos(self) -> i64 {
        match self {
            Self::Seconds => 1_000_000_000,
            Self::Milliseconds => 1_000_000,
            Self::Microseconds => 1_000,
            Self::Nanoseconds => 1,
        }
    }

    /// The unit in which samples this far apart are those of a gyroscope.
    fn plausible(step: f64) -> Self {
        match step {
            step if step > 1e6 * LONGEST_STEP_S => Self::Nanoseconds,
            step if step > 1e3 * LONGEST_STEP_S => Self::Microseconds,
            step if step > LONGEST_STEP_S => Self::Milliseconds,
            _ => Self::Seconds,
        }
    }
}

impl fmt::Display for Form {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Header {
                columns,
                unit,
                unit_by_step,
                rates,
            } => {
                let unit = match unit {
                    TimeUnit::Seconds => "seconds",
                    TimeUnit::Milliseconds => "milliseconds",
                    TimeUnit::Microseconds => "microseconds",
                    TimeUnit::Nanoseconds => "nanoseconds",
                };
                let by = if *unit_by_step {
                    " (by the distance of the samples)"
                } else {
                    ""
                };
                let rates = match rates {
                    RateUnit::RadPerSecond => "rad/s",
                    RateUnit::DegPerSecond => "°/s, converted to rad/s",
                };
                let axes = columns[1..].join(", ");
                write!(f, "header: {} in {unit}{by}, {axes} in {rates}", columns[0])
            }
            Self::PhoneApp => f.write_str("phone app: x, y, z in rad/s, integer nanoseconds"),
        }
    }
}

/// A recording and the form its file had.
#[derive(Debug, Clone)]
pub struct GyroFile {
    /// The recording.
    pub track: GyroTrack,
    /// The times of its samples in nanoseconds; exact where the file has integers.
    pub times: Vec<i64>,
    /// The form.
    pub form: Form,
}

/// What is wrong with a file.
#[derive(Debug, thiserror::Error)]
pub enum CsvError {
    /// It cannot be read at all.
    #[error("cannot read it: {0}")]
    Io(#[from] std::io::Error),
    /// No line with data.
    #[error("no samples: expected a header line (time, x, y, z) or lines x,y,z,nanoseconds")]
    Empty,
    /// A line that is not as expected.
    #[error("line {line}: expected {expected}, found {found}")]
    Line {
        /// Its number, from 1.
        line: u64,
        /// What was expected.
        expected: String,
        /// What was there.
        found: String,
    },
}

fn damaged(line: u64, expected: impl Into<String>, found: impl Into<String>) -> CsvError {
    let mut found: String = found.into();
    if found.chars().count() > 60 {
        found = found.chars().take(60).collect::<String>() + "…";
    }
    CsvError::Line {
        line,
        expected: expected.into(),
        found,
    }
}

/// Reads a file.
///
/// # Errors
///
/// It cannot be opened, or [`read`] refuses it.
pub fn read_file(path: &Path) -> Result<GyroFile, CsvError> {
    read(File::open(path)?)
}

/// Reads CSV.
///
/// # Errors
///
/// The first line that is not as expected, with its number.
pub fn read(input: impl Read) -> Result<GyroFile, CsvError> {
    let mut reader = BufReader::new(input);
    let mut bytes = Vec::new();
    let mut layout: Option<Layout> = None;
    let mut rows = Rows::default();
    for line in 1.. {
        bytes.clear();
        let mut limited = reader.by_ref().take(LONGEST_LINE);
        if limited.read_until(b'\n', &mut bytes)? == 0 {
            break;
        }
        if bytes.len() as u64 == LONGEST_LINE {
            return Err(damaged(line, "lines of text", "a line without end"));
        }
        let text = std::str::from_utf8(&bytes)
            .map_err(|_| damaged(line, "text", "bytes that are no text"))?
            .trim_start_matches('\u{feff}')
            .trim();
        if text.is_empty() {
            continue;
        }
        // Numbers and names hold no commas, so quotes are decoration.
        let fields: Vec<&str> = text
            .split(',')
            .map(|field| field.trim().trim_matches('"').trim())
            .collect();
        match &layout {
            None if number(fields[0]).is_some() => {
                let phone = Layout {
                    columns: [3, 0, 1, 2],
                    width: 4,
                    form: Form::PhoneApp,
                };
                rows.add(&phone, &fields, line)?;
                layout = Some(phone);
            }
            None => layout = Some(header(&fields, line)?),
            Some(layout) => rows.add(layout, &fields, line)?,
        }
    }
    let layout = layout.ok_or(CsvError::Empty)?;
    if rows.rates.is_empty() {
        return Err(CsvError::Empty);
    }
    Ok(rows.finish(layout.form))
}

/// Longest distance of a gyroscope's samples, seconds.
const LONGEST_STEP_S: f64 = 0.2;

/// Longest line that is read; a sample has some 60 characters.
const LONGEST_LINE: u64 = 65_536;

/// A finite decimal number.
fn number(text: &str) -> Option<f64> {
    text.parse::<f64>().ok().filter(|x| x.is_finite())
}

struct Layout {
    /// Columns of time, x, y, z.
    columns: [usize; 4],
    /// Number of columns.
    width: usize,
    form: Form,
}

/// Finds the columns by their names.
fn header(fields: &[&str], line: u64) -> Result<Layout, CsvError> {
    let names: Vec<String> = fields
        .iter()
        .map(|f| f.trim_start_matches('#').trim().to_lowercase())
        .collect();
    let wrong = |expected: &str| damaged(line, expected, fields.join(","));
    let expected =
        "a header with a time column and columns x, y, z, or the phone app's x,y,z,nanoseconds";
    // The words of a name, units taken off the end.
    let words = |name: &str| -> Vec<String> {
        name.split(|c: char| !c.is_alphanumeric())
            .filter(|w| !w.is_empty())
            .map(str::to_owned)
            .collect()
    };
    let is_time = |name: &str| {
        words(name).iter().any(|w| {
            w.contains("time")
                || w.contains("stamp")
                || matches!(
                    w.as_str(),
                    "t" | "ts" | "sec" | "seconds" | "ns" | "nanoseconds"
                )
        })
    };
    let time = names
        .iter()
        .position(|n| is_time(n))
        .ok_or_else(|| wrong(expected))?;
    let axis = |letter: char| {
        let is_axis = |name: &str| {
            words(name).iter().any(|w| {
                // x, wx, gx, gyrox, omegax, rotx
                w.len() == 1 && w.starts_with(letter)
                    || w.ends_with(letter)
                        && [
                            "w", "g", "gyro", "gyr", "omega", "rot", "rate", "av", "angvel",
                        ]
                        .contains(&&w[..w.len() - letter.len_utf8()])
            })
        };
        let of_other = |name: &str| {
            let of_other = |w: &String| w.starts_with("acc") || w.starts_with("mag");
            // EuRoC: a_RS_S_x [m s^-2].
            let words = words(name);
            words.iter().any(of_other) || words.first().is_some_and(|w| w == "a")
        };
        let mut found =
            (0..names.len()).filter(|&i| i != time && is_axis(&names[i]) && !of_other(&names[i]));
        match (found.next(), found.next()) {
            (Some(i), None) => Ok(i),
            (None, _) => Err(wrong(&format!("{expected} (no column for {letter})"))),
            (Some(_), Some(_)) => {
                let one = format!("one column for {letter} of the gyroscope only");
                Err(wrong(&one))
            }
        }
    };
    let columns = [time, axis('x')?, axis('y')?, axis('z')?];
    let in_degrees = |&c: &usize| {
        let mut words = words(&names[c]).into_iter();
        words.any(|w| w.contains("deg") || w == "dps") || names[c].contains('°')
    };
    let rates = match columns[1..].iter().filter(|c| in_degrees(c)).count() {
        0 => RateUnit::RadPerSecond,
        3 => RateUnit::DegPerSecond,
        _ => return Err(wrong("rates of one unit")),
    };
    let named = match words(&names[time]).last().map(String::as_str) {
        Some("ns" | "nanos" | "nsec" | "nanoseconds") => Some(TimeUnit::Nanoseconds),
        Some("us" | "µs" | "usec" | "micros" | "microseconds") => Some(TimeUnit::Microseconds),
        Some("ms" | "msec" | "millis" | "milliseconds") => Some(TimeUnit::Milliseconds),
        Some("s" | "sec" | "secs" | "seconds") => Some(TimeUnit::Seconds),
        _ => None,
    };
    Ok(Layout {
        columns,
        width: names.len(),
        form: Form::Header {
            columns: columns.map(|c| names[c].clone()),
            unit: named.unwrap_or(TimeUnit::Seconds),
            unit_by_step: named.is_none(),
            rates,
        },
    })
}

#[derive(Default)]
struct Rows {
    times: Vec<f64>,
    /// The same times, as long as all of them are integers.
    integers: Vec<i64>,
    rates: Vec<[f64; 3]>,
}

impl Rows {
    fn add(&mut self, layout: &Layout, fields: &[&str], line: u64) -> Result<(), CsvError> {
        if fields.len() != layout.width {
            return Err(damaged(
                line,
                format!("{} columns ({})", layout.width, layout.form),
                format!("{}: {}", fields.len(), fields.join(",")),
            ));
        }
        let [time, x, y, z] = layout.columns;
        let wrong = |expected: &str, column: usize, more: &str| {
            let expected = format!("{expected} in column {}{more}", column + 1);
            damaged(line, expected, format!("\"{}\"", fields[column]))
        };
        let value = |what: &str, column: usize| {
            number(fields[column]).ok_or_else(|| wrong(what, column, ""))
        };
        let rate = |column: usize| value("a number (rate)", column);
        let rates = [rate(x)?, rate(y)?, rate(z)?];
        let integer = match layout.form {
            Form::PhoneApp => true,
            Form::Header { unit, .. } => unit == TimeUnit::Nanoseconds,
        };
        let whole = fields[time].parse::<i64>();
        if integer && whole.is_err() {
            let form = format!(" ({})", layout.form);
            return Err(wrong("integer nanoseconds", time, &form));
        }
        let time = value("a number (time)", time)?;
        self.integers.extend(whole);
        self.times.push(time);
        self.rates.push(rates);
        Ok(())
    }

    fn finish(self, mut form: Form) -> GyroFile {
        if let Form::Header {
            unit,
            unit_by_step: true,
            ..
        } = &mut form
        {
            *unit = typical_step(&self.times).map_or(*unit, TimeUnit::plausible);
        }
        let (unit, rates) = match form {
            Form::Header { unit, rates, .. } => (unit, rates),
            Form::PhoneApp => (TimeUnit::Nanoseconds, RateUnit::RadPerSecond),
        };
        let scaled = |time: &i64| time.checked_mul(unit.nanos()).map(PhoneNanos);
        let nanos: Option<Vec<PhoneNanos>> = self.integers.iter().map(scaled).collect();
        let all_whole = self.integers.len() == self.times.len();
        let (mut track, times) = match nanos.filter(|_| all_whole) {
            Some(nanos) => {
                let times = nanos.iter().map(|time| time.0).collect();
                (phone_track(&nanos, self.rates), times)
            }
            None => {
                let per_second = 1e9 / unit.nanos() as f64;
                let times: Vec<f64> = self.times.iter().map(|t| t / per_second).collect();
                let nanos = self
                    .times
                    .iter()
                    .map(|t| (t * unit.nanos() as f64).round() as i64);
                (GyroTrack::from_seconds(&times, self.rates), nanos.collect())
            }
        };
        if rates == RateUnit::DegPerSecond {
            track
                .w
                .iter_mut()
                .flatten()
                .for_each(|rate| *rate = rate.to_radians());
        }
        GyroFile { track, times, form }
    }
}

/// Median distance of neighbours; `None` with fewer than two.
fn typical_step(times: &[f64]) -> Option<f64> {
    let mut steps: Vec<f64> = times.windows(2).map(|p| p[1] - p[0]).collect();
    twist_sync::robust::median_in_place(&mut steps)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn parse(text: &str) -> Result<GyroFile, CsvError> {
        read(text.as_bytes())
    }

    #[test]
    fn both_forms_give_the_same() {
        let header = parse("mcu_time,mcu_x,mcu_y,mcu_z\n10.5,1,2,3\n10.502,4,5,6\n").unwrap();
        let phone = parse("1,2,3,10500000000\n4,5,6,10502000000\n").unwrap();
        assert_eq!(phone.form, Form::PhoneApp);
        assert_eq!(header.track.w, phone.track.w);
        assert_eq!(header.track.epoch_s, phone.track.epoch_s);
        assert!((header.track.t[1] - phone.track.t[1]).abs() < 1e-9);
    }

    #[test]
    fn header_spellings() {
        for header in [
            "sm_time,sm_x,sm_y,sm_z",
            "time,x,y,z",
            "timestamp,wx,wy,wz",
            "t,gyro_x,gyro_y,gyro_z",
            "Time (s), X (rad/s), Y (rad/s), Z (rad/s)",
            "#time_s,w_x,w_y,w_z",
            "\u{feff}timestamp_s;x;y;z".replace(';', ",").as_str(),
        ] {
            let file = parse(&format!("{header}\n1.5,1,2,3\n1.6,1,2,4\n")).unwrap();
            assert_eq!(file.track.epoch_s, 1.5, "{header}");
            assert_eq!(file.track.w[1], [1.0, 2.0, 4.0], "{header}");
        }
        let file = parse("x,y,z,timestamp_ns\n1,2,3,5000000000\n").unwrap();
        assert_eq!(file.track.epoch_s, 5.0);
        let file =
            parse("timestamp,x,y,z\n949113215987860,1,2,3\n949113217987860,1,2,3\n").unwrap();
        assert!((file.track.epoch_s - 949_113.215_987_86).abs() < 1e-9);
        assert!((file.track.t[1] - 0.002).abs() < 1e-9);
        // EuRoC.
        let file = parse("#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n1403636579758555392,1,2,3,0,0,0\n").unwrap();
        assert_eq!(file.track.w[0], [1.0, 2.0, 3.0]);
        assert_eq!(file.times, [1_403_636_579_758_555_392]);
        // Sensor Logger.
        let file = parse("time,seconds_elapsed,z,y,x\n1698501144401909000,0.1,3,2,1\n1698501144411909000,0.11,3,2,1\n").unwrap();
        assert_eq!(file.track.w[0], [1.0, 2.0, 3.0]);
        assert_eq!(file.times[0], 1_698_501_144_401_909_000);
    }

    #[test]
    fn degrees_are_converted_and_said() {
        for header in [
            "time,x_deg,y_deg,z_deg",
            "t,gx_dps,gy_dps,gz_dps",
            "t,x °/s,y °/s,z °/s",
        ] {
            let file = parse(&format!("{header}\n1.5,90,0,-180\n")).unwrap();
            assert_eq!(file.track.w[0][0], 90_f64.to_radians(), "{header}");
            assert!(file.form.to_string().contains("°/s, converted"), "{header}");
        }
    }

    #[test]
    fn times_are_in_the_unit_that_is_named_or_plausible() {
        for (header, step, word) in [
            ("t", "0.002", "in seconds (by"),
            ("t", "2", "milliseconds (by"),
            ("t", "2000", "microseconds (by"),
            ("t", "2000000", "nanoseconds (by"),
            ("t_ms", "2", "milliseconds,"),
            ("t_us", "2000", "microseconds,"),
            ("time_s", "0.002", "in seconds,"),
        ] {
            let step: f64 = step.parse().unwrap();
            let mut text = format!("{header},x,y,z\n");
            for k in 0..5 {
                text += &format!("{},1,2,3\n", 1000.0 * step + step * f64::from(k));
            }
            let file = parse(&text).unwrap();
            assert!(file.form.to_string().contains(word), "{}", file.form);
            assert!((file.track.t[4] - 0.008).abs() < 1e-12, "{header} {step}");
            assert!((file.track.epoch_s - 2.0).abs() < 1e-9, "{header} {step}");
        }
        // Nanoseconds since 1970 keep their digits.
        let file = parse("time,x,y,z\n1700000000000000001,1,2,3\n1700000000002000002,1,2,3\n");
        assert_eq!(file.unwrap().track.t[1], 2.000_001e-3);
    }

    #[test]
    fn the_columns_of_the_gyroscope_are_taken() {
        let own = "ticks,time_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,\
                   accel_y_m_s2,accel_z_m_s2,temperature_c,flags\n\
                   48000000,1.000000000,0.1,0.2,0.3,9.0,9.1,9.2,25.000,0\n";
        let file = parse(own).unwrap();
        assert_eq!(file.track.w, [[0.1, 0.2, 0.3]]);
        assert_eq!(file.track.epoch_s, 1.0);
    }

    #[test]
    fn damage_is_named_with_its_line() {
        let message = |text: &str| parse(text).unwrap_err().to_string();
        assert!(message("time,x,y,z\n1,2,3,4\n1.1,2,three,4\n").contains("line 3"));
        assert!(message("time,x,y,z\n1,2,3,4\n\n1.1,2,3\n").contains("line 4: expected 4 columns"));
        assert!(message("1,2,3,100\n1,2,3,1.5\n").contains("line 2: expected integer nanoseconds"));
        assert!(message("time,x,y,z\n1,2,nan,4\n").contains("line 2"));
        assert!(message("a,b,c,d\n1,2,3,4\n").contains("expected a header"));
        assert!(message("time,x,y,z\n1,2,3,\u{1}\n").contains("line 2"));
        assert!(message("").contains("no samples"));
        assert!(message("time,x,y,z\n").contains("no samples"));
        assert!(message("time,x_deg,y_deg,z\n1,2,3,4\n").contains("one unit"));
        assert!(
            read(&b"time,x,y,z\n1,2,\xff\xfe,4\n"[..])
                .unwrap_err()
                .to_string()
                .contains("line 2")
        );
    }

    proptest! {
        #[test]
        fn no_bytes_make_it_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
            let _ = read(bytes.as_slice());
        }

        #[test]
        fn no_csv_like_text_makes_it_panic(text in "(time,x,y,z\n)?([-0-9.e,nxyz]{0,20}\n){0,8}") {
            let _ = read(text.as_bytes());
        }
    }
}
