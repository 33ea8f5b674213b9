//! The app's files: names by date, one folder a recording.
//!
//! A video `VID_20210504_161730.mp4` has a folder `20210504_161730` beside it
//! with `VID_20210504_161730gyro.csv`, `…accel.csv` and
//! `VID_20210504_161730_imu_timestamps.csv`.

use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use super::java;
use super::sensors::{Kind, Sample};

/// What the phone's wall clock says at power-on of the rig: 2021-05-04
/// 16:17:30, in seconds since 1970.
const WALL_CLOCK_AT_ZERO: u64 = 1_620_145_050;

/// The names of one recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Names {
    storage: PathBuf,
    date: String,
    stem: String,
}

impl Names {
    /// Names for a recording that begins `seconds` after power-on, which
    /// nothing in `storage` has yet.
    pub(super) fn free(storage: &Path, seconds: u64) -> Self {
        let date = date(WALL_CLOCK_AT_ZERO.saturating_add(seconds));
        let mut names = Self {
            storage: storage.to_owned(),
            stem: format!("VID_{date}"),
            date,
        };
        let mut index = 0u32;
        while names.video().exists() || names.sensor(Kind::Gyroscope).exists() {
            index += 1;
            names.stem = format!("VID_{}_{index}", names.date);
        }
        names
    }

    pub(super) fn video(&self) -> PathBuf {
        self.storage.join(self.video_name())
    }

    pub(super) fn video_name(&self) -> String {
        format!("{}.mp4", self.stem)
    }

    pub(super) fn sensor_name(&self, kind: Kind) -> String {
        format!("{}{}.csv", self.stem, kind.suffix())
    }

    pub(super) fn sensor(&self, kind: Kind) -> PathBuf {
        self.storage.join(&self.date).join(self.sensor_name(kind))
    }

    pub(super) fn timestamps(&self) -> PathBuf {
        self.storage
            .join(&self.date)
            .join(format!("{}_imu_timestamps.csv", self.stem))
    }

    /// Writes a sensor's file.
    pub(super) fn save_sensor(&self, kind: Kind, samples: &[Sample]) -> std::io::Result<()> {
        write_lines(&self.sensor(kind), samples.iter().map(csv_line))
    }

    /// Writes the frames' timestamps.
    pub(super) fn save_timestamps(&self, stamps: &[i64]) -> std::io::Result<()> {
        write_lines(&self.timestamps(), stamps.iter().map(i64::to_string))
    }
}

fn write_lines(path: &Path, lines: impl Iterator<Item = String>) -> std::io::Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)?;
    }
    let mut file = BufWriter::new(std::fs::File::create(path)?);
    for line in lines {
        writeln!(file, "{line}")?;
    }
    file.flush()
}

/// A sample as a line of the app's files, without its end.
pub(super) fn csv_line(sample: &Sample) -> String {
    let [x, y, z] = sample.values.map(java::float);
    format!("{x},{y},{z},{}", sample.time_ns)
}

/// `yyyyMMdd_HHmmss` of a Unix time, UTC. The calendar is that of
/// H. Hinnant's "chrono-compatible low-level date algorithms" (public domain).
fn date(unix: u64) -> String {
    let (days, second) = (unix / 86_400, unix % 86_400);
    let days = days + 719_468;
    let era = days / 146_097;
    let day_of_era = days % 146_097;
    let year_of_era =
        (day_of_era - day_of_era / 1_460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * shifted + 2) / 5 + 1;
    let month = if shifted < 10 {
        shifted + 3
    } else {
        shifted - 9
    };
    let year = year_of_era + era * 400 + u64::from(month <= 2);
    format!(
        "{year:04}{month:02}{day:02}_{:02}{:02}{:02}",
        second / 3600,
        second / 60 % 60,
        second % 60
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_right() {
        for (unix, text) in [
            (0, "19700101_000000"),
            (WALL_CLOCK_AT_ZERO, "20210504_161730"),
            (951_782_400, "20000229_000000"),
            (1_709_251_199, "20240229_235959"),
            (1_735_689_599, "20241231_235959"),
        ] {
            assert_eq!(date(unix), text);
        }
    }

    #[test]
    fn names_are_the_app_s_and_never_taken_twice() {
        let storage = tempfile::tempdir().unwrap();
        let names = Names::free(storage.path(), 0);
        assert_eq!(names.video_name(), "VID_20210504_161730.mp4");
        names.save_sensor(Kind::Gyroscope, &[]).unwrap();
        let folder = storage.path().join("20210504_161730");
        assert!(folder.join("VID_20210504_161730gyro.csv").exists());
        let again = Names::free(storage.path(), 0);
        assert_eq!(again.video_name(), "VID_20210504_161730_1.mp4");
        assert_eq!(again.timestamps().parent(), Some(folder.as_path()));
    }
}
