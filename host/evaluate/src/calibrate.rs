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
use std::str::FromStr;

use jiff::civil::Date;
use toml_edit::{Datetime, DocumentMut, Item, Table, value};

use super::EvaluateError;

const TABLE: &str = "frame_sync";

fn profile_error(path: &Path, message: String) -> EvaluateError {
    EvaluateError::Profile {
        path: path.to_owned(),
        message,
    }
}

fn load(path: &Path) -> Result<DocumentMut, EvaluateError> {
    let text = files::read_text(path, recording::profile::MAX_LENGTH).map_err(|e| {
        profile_error(
            path,
            format!("the rig profile cannot be read: {e}; give an existing profile"),
        )
    })?;
    DocumentMut::from_str(&text)
        .map_err(|e| profile_error(path, format!("the rig profile is not valid TOML: {e}")))
}

/// Bias that the profile holds now; zero when it holds none.
pub fn read_bias(path: &Path) -> Result<f64, EvaluateError> {
    let document = load(path)?;
    let Some(item) = document.get(TABLE).and_then(|t| t.get("bias_us")) else {
        return Ok(0.0);
    };
    item.as_float()
        .or_else(|| item.as_integer().map(|i| i as f64))
        .filter(|v| v.is_finite())
        .ok_or_else(|| {
            profile_error(
                path,
                format!("{TABLE}.bias_us is not a number of microseconds"),
            )
        })
}

/// Writes bias, its standard uncertainty and the date of the measurement into the
/// profile's table `[frame_sync]`, which is added when it is missing.
pub fn write_bias(
    path: &Path,
    bias_us: f64,
    sigma_us: f64,
    date: Date,
) -> Result<(), EvaluateError> {
    if !bias_us.is_finite() || !sigma_us.is_finite() || sigma_us < 0.0 {
        return Err(profile_error(
            path,
            format!("a bias of {bias_us} ± {sigma_us} µs cannot be written"),
        ));
    }
    let measured: Datetime = date
        .to_string()
        .parse()
        .map_err(|e| profile_error(path, format!("{date} cannot be written: {e}")))?;
    let mut document = load(path)?;
    let table = document
        .entry(TABLE)
        .or_insert_with(|| Item::Table(Table::new()))
        .as_table_like_mut()
        .ok_or_else(|| profile_error(path, format!("`{TABLE}` is not a table")))?;
    // Nanoseconds are enough digits.
    let rounded = |v: f64| (v * 1e3).round() / 1e3;
    for (key, new) in [
        ("bias_us", value(rounded(bias_us))),
        ("bias_sigma_us", value(rounded(sigma_us))),
        ("bias_measured", value(measured)),
    ] {
        // Comments belong to the old value: move them to the new one.
        let decor = table
            .get(key)
            .and_then(Item::as_value)
            .map(|v| v.decor().clone());
        let mut new = new;
        if let (Some(decor), Some(v)) = (decor, new.as_value_mut()) {
            *v.decor_mut() = decor;
        }
        table.insert(key, new);
    }
    files::replace(path, document.to_string().as_bytes()).map_err(EvaluateError::io(path))
}

#[cfg(test)]
mod tests {
    use jiff::civil::date;

    use super::*;

    fn profile(text: &str) -> (tempfile::TempDir, std::path::PathBuf) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("rig.toml");
        std::fs::write(&path, text).unwrap();
        (dir, path)
    }

    #[test]
    fn everything_else_in_the_profile_stays() {
        let before = "# my rig\nname = 'a'  # the one on the roof\n\n[frame_sync]\n# constants\nreadout_us = 11_016.0\nbias_us = 5 # by eye\n\n[imu]\nrate = 500\n";
        let (_dir, path) = profile(before);
        assert_eq!(read_bias(&path).unwrap(), 5.0);
        write_bias(&path, -1234.56789, 0.4321, date(2024, 5, 17)).unwrap();
        let after = std::fs::read_to_string(&path).unwrap();
        let expected = "# my rig\nname = 'a'  # the one on the roof\n\n[frame_sync]\n# constants\nreadout_us = 11_016.0\nbias_us = -1234.568 # by eye\nbias_sigma_us = 0.432\nbias_measured = 2024-05-17\n\n[imu]\nrate = 500\n";
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
    fn what_is_not_a_profile_is_left_alone() {
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
        assert!(e.to_string().contains("existing profile"), "{e}");
        assert!(!missing.exists());
    }
}
