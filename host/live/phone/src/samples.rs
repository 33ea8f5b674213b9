//! The CSV lines of the phone's sensors as typed samples.
//!
//! A line is `x,y,z,timestamp_ns`: rad/s (gyroscope) or m/s² (accelerometer) in Android's
//! device axes, and nanoseconds of the phone's boot clock. Values are kept as they came: order, repeats and jumps of the
//! timestamps are the estimator's business, which names such faults. What is
//! not a finite number or not a timestamp is refused with its line.

use std::io::{BufWriter, IntoInnerError, Write as _};
use std::path::Path;

use clock::PhoneNanos;

use super::error::PhoneError;

/// One sample of a three-axis sensor of the phone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PhoneSample {
    /// When, by the phone's boot clock.
    pub time: PhoneNanos,
    /// Values about or along the device's x, y and z, in the sensor's unit.
    pub xyz: [f64; 3],
}

/// What a line of a sensor's CSV must be.
pub(crate) const SAMPLE_LINE: &str = "a CSV line x,y,z,timestamp_ns";

/// Reads one line `x,y,z,timestamp_ns`; `None` if it is not one.
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

/// The line of `sample`, as the app writes it but for the number of digits:
/// each value is the shortest text that reads back as the same number.
fn sample_line(sample: &PhoneSample) -> String {
    let [x, y, z] = sample.xyz;
    format!("{x},{y},{z},{}", sample.time.0)
}

/// Saves samples as the app does, a line each; the file appears only when it is whole.
/// Its folder is made if there is none.
///
/// # Errors
///
/// The file is there already and is not to be overwritten, or it cannot be written.
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
    fn refuses_what_is_not_a_sample() {
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
        fn any_text_is_taken_without_panic(line in "\\PC{0,60}") {
            let _ = parse_sample(&line);
        }
    }
}
