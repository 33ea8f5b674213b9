//! The measured bias in the rig profile.
//!
//! The profile is a TOML file that people edit. Only the three keys of the
//! measurement change; comments, order and everything else stay as they are. The
//! new file replaces the old one in one step.
//!
//! ```toml
//! [frame_sync]
//! bias_us = -1234.5          # depth centre of exposure after the phone's; subtracted by `record`
//! bias_sigma_us = 0.4        # standard uncertainty
//! bias_measured = 2024-05-17 # when
//! ```

use std::path::Path;

use jiff::civil::Date;
use recording::profile::edit::{open, set, table};
use recording::profile::{MAX_LENGTH, Profile};
use toml_edit::{Datetime, value};

use crate::EvaluateError;

/// Reads the profile that is to be calibrated.
///
/// # Errors
///
/// Fails if the profile cannot be read or is not valid.
pub fn read_profile(path: &Path) -> Result<Profile, EvaluateError> {
    Ok(Profile::load(path)?)
}

/// Writes the bias, its standard uncertainty (both in µs) and the date of the measurement into
/// the profile's table `[frame_sync]`, which is added if it is missing.
///
/// # Errors
///
/// Fails, and leaves the file as it is, if the profile is not valid before or after the change,
/// or cannot be read or written.
pub fn write_bias(
    path: &Path,
    bias_us: f64,
    sigma_us: f64,
    date: Date,
) -> Result<(), EvaluateError> {
    let measured: Datetime = date
        .to_string()
        .parse()
        .map_err(|e| EvaluateError::Setting(format!("{date} cannot be written: {e}")))?;
    let text = system::read_text(path, MAX_LENGTH).map_err(EvaluateError::io(path))?;
    let (_, mut document) = open(&text, path)?;
    let table = table(&mut document, "frame_sync", path)?;
    // Nanoseconds are enough digits.
    let rounded = |v: f64| value((v * 1e3).round() / 1e3);
    set(table, "bias_us", rounded(bias_us));
    set(table, "bias_sigma_us", rounded(sigma_us));
    set(table, "bias_measured", value(measured));
    let text = document.to_string();
    Profile::parse(&text, Some(path))?;
    system::replace(path, text.as_bytes()).map_err(EvaluateError::io(path))
}

#[cfg(test)]
mod tests {
    use jiff::civil::date;

    use super::*;

    fn read_bias(path: &Path) -> Result<f64, EvaluateError> {
        Ok(read_profile(path)?.frame_sync.bias_us)
    }

    fn profile(text: &str) -> (tempfile::TempDir, std::path::PathBuf) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("rig.toml");
        std::fs::write(&path, text).unwrap();
        (dir, path)
    }

    #[test]
    fn everything_else_in_the_profile_stays() {
        let before = "# my rig\nname = 'a'  # the one on the roof\n\n[frame_sync]\n# constants\nbias_us = 5 # by eye\n\n[imu]\nrate_hz = 500\n";
        let (_dir, path) = profile(before);
        assert_eq!(read_bias(&path).unwrap(), 5.0);
        write_bias(&path, -1234.56789, 0.4321, date(2024, 5, 17)).unwrap();
        let after = std::fs::read_to_string(&path).unwrap();
        let expected = "# my rig\nname = 'a'  # the one on the roof\n\n[frame_sync]\n# constants\nbias_us = -1234.568 # by eye\nbias_sigma_us = 0.432\nbias_measured = 2024-05-17\n\n[imu]\nrate_hz = 500\n";
        assert_eq!(after, expected);
        assert_eq!(read_bias(&path).unwrap(), -1234.568);
    }

    #[test]
    fn a_missing_table_is_added() {
        let (_dir, path) = profile("name = 'a'\n");
        assert_eq!(read_bias(&path).unwrap(), 0.0);
        write_bias(&path, 1.0, 0.5, date(2024, 5, 17)).unwrap();
        let after: toml::Table = std::fs::read_to_string(&path).unwrap().parse().unwrap();
        assert_eq!(after["frame_sync"]["bias_us"].as_float(), Some(1.0));
        assert_eq!(after["name"].as_str(), Some("a"));
    }

    #[test]
    fn an_invalid_profile_is_left_alone() {
        for text in ["frame_sync = 3\n", "[frame_sync\n"] {
            let (_dir, path) = profile(text);
            let e = write_bias(&path, 1.0, 0.5, date(2024, 5, 17)).unwrap_err();
            assert!(e.to_string().contains("rig.toml"), "{e}");
            assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
        }
        let (_dir, path) = profile("[frame_sync]\nbias_us = 'x'\n");
        assert!(read_bias(&path).is_err());
        assert!(write_bias(&path, f64::NAN, 0.5, date(2024, 5, 17)).is_err());
        let missing = path.with_file_name("none.toml");
        let e = write_bias(&missing, 1.0, 0.5, date(2024, 5, 17)).unwrap_err();
        assert!(e.to_string().contains("none.toml"), "{e}");
        assert!(!missing.exists());
    }
}
