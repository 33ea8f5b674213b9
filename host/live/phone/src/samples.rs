//! Samples of the phone's sensors and their CSV lines.
//!
//! A line is `x,y,z,timestamp_ns`: rad/s (gyroscope) or m/s² (accelerometer) in Android's
//! device axes, and nanoseconds of the phone's boot clock. Values must be finite and the timestamp
//! an integer; nothing else is checked. Order, repeats and jumps of the timestamps are left to the
//! estimator, which reports such faults.

use std::io::{BufWriter, IntoInnerError, Write as _};
use std::path::Path;

use clock::PhoneNanos;

use super::error::PhoneError;

/// One sample of a three-axis sensor of the phone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PhoneSample {
    /// Time by the phone's boot clock.
    pub time: PhoneNanos,
    /// Values about or along the device's x, y and z, in the sensor's unit.
    pub xyz: [f64; 3],
}

/// Form of a line of a sensor's CSV file.
pub(crate) const SAMPLE_LINE: &str = "a CSV line x,y,z,timestamp_ns";

/// Parses a line `x,y,z,timestamp_ns`. Returns `None` if it has another form.
pub(crate) fn parse_sample(line: &str) -> Option<PhoneSample> {
    let mut fields = line.split(',').map(str::trim);
    let mut xyz = [0.0; 3];
    for value in &mut xyz {
        *value = fields
            .next()?
            .parse()
            .ok()
            .filter(|v: &f64| v.is_finite())?;
    }
    let time = fields.next()?.parse().ok().map(PhoneNanos)?;
    fields.next().is_none().then_some(PhoneSample { time, xyz })
}

/// Formats a sample as the app does, except for the number of digits: each value is the shortest
/// text that parses to the same number.
fn sample_line(sample: &PhoneSample) -> String {
    let [x, y, z] = sample.xyz;
    format!("{x},{y},{z},{}", sample.time.0)
}

/// Saves samples in the app's format. The file appears only once it is complete, and its folder is
/// created if needed.
///
/// # Errors
///
/// The file exists and `overwrite` is false, or it cannot be written.
pub fn save_samples(
    path: &Path,
    samples: &[PhoneSample],
    overwrite: bool,
) -> Result<(), PhoneError> {
    let write = || {
        let folder = system::folder_of(path);
        std::fs::create_dir_all(folder)?;
        let file = system::new_file_in(folder)?;
        let mut out = BufWriter::new(file);
        for sample in samples {
            writeln!(out, "{}", sample_line(sample))?;
        }
        let file = out.into_inner().map_err(IntoInnerError::into_error)?;
        system::put_in_place(file, path, overwrite)
    };
    write().map_err(|source| PhoneError::writing(path, source))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn refuses_lines_of_another_form() {
        for line in [
            "",
            "1,2,3",
            "1,2,3,4,5",
            "1,2,x,4",
            "1,2,NaN,4",
            "1,inf,2,4",
            "1,2,3,4.5",
            "1,2,3,99999999999999999999",
            "1;2;3;4",
        ] {
            assert_eq!(parse_sample(line), None, "{line}");
        }
    }

    proptest! {
        #[test]
        fn lines_read_back_exactly(
            x in -1e6f64..1e6, y in proptest::num::f64::NORMAL, z in -1f64..1.0, t in any::<i64>(),
        ) {
            let sample = PhoneSample { time: PhoneNanos(t), xyz: [x, y, z] };
            prop_assert_eq!(parse_sample(&sample_line(&sample)), Some(sample));
        }

        #[test]
        fn no_text_causes_a_panic(line in "\\PC{0,60}") {
            let _ = parse_sample(&line);
        }
    }
}
