//! The app's files: names by date, one folder a recording.
//!
//! A video `VID_20210504_161730.mp4` has a folder `20210504_161730` beside it
//! with `VID_20210504_161730gyro.csv`, `…accel.csv`, `…magnetic.csv` and
//! `VID_20210504_161730_imu_timestamps.csv`. A name that is taken gets a number at its
//! end, each file for itself (`StorageUtils.java`:668 and 714).

use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use jiff::Timestamp;

use super::config::StorageAccess;
use super::java;
use super::sensors::{Kind, Sample};

/// Wall clock of the phone at power-on of the rig: 2021-05-04
/// 16:17:30, in seconds since 1970.
const WALL_CLOCK_AT_ZERO: u64 = 1_620_145_050;

/// The files of one recording, from its begin on. They are empty until they are saved.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Names {
    storage: PathBuf,
    access: StorageAccess,
    date: String,
    sensors: Vec<(Kind, PathBuf)>,
    timestamps: Option<PathBuf>,
    video: Option<PathBuf>,
}

impl Names {
    /// A recording that begins `seconds` after power-on, with no file yet.
    pub(super) fn new(storage: &Path, access: StorageAccess, seconds: u64) -> Self {
        Self {
            storage: storage.to_owned(),
            access,
            date: date(WALL_CLOCK_AT_ZERO.saturating_add(seconds)),
            sensors: Vec::new(),
            timestamps: None,
            video: None,
        }
    }

    /// The first free name of a kind of file, among those that `taken` does not hold.
    fn free(&self, folder: &Path, suffix: &str, extension: &str, taken: &[PathBuf]) -> PathBuf {
        (0u32..)
            .map(|count| {
                let index = match (count, self.access) {
                    (0, _) => String::new(),
                    (_, StorageAccess::Files) => format!("_{count}"),
                    (_, StorageAccess::Documents) => format!(" ({count})"),
                };
                folder.join(format!("VID_{}{suffix}{index}.{extension}", self.date))
            })
            .find(|path| !path.exists() && !taken.contains(path))
            .unwrap_or_default()
    }

    /// Makes an empty file in the recording's folder.
    fn make(&self, suffix: &str) -> std::io::Result<PathBuf> {
        let folder = self.storage.join(&self.date);
        std::fs::create_dir_all(&folder)?;
        let path = self.free(&folder, suffix, "csv", &[]);
        std::fs::File::create(&path)?;
        Ok(path)
    }

    /// Makes the file of a sensor.
    pub(super) fn make_sensor(&mut self, kind: Kind) -> std::io::Result<()> {
        let path = self.make(kind.suffix())?;
        self.sensors.push((kind, path));
        Ok(())
    }

    /// Takes a name for the video, which none of `taken` has, and makes the file of its
    /// frames' timestamps.
    pub(super) fn make_video(&mut self, taken: &[PathBuf]) -> std::io::Result<()> {
        self.video = Some(self.free(&self.storage, "", "mp4", taken));
        self.timestamps = Some(self.make("_imu_timestamps")?);
        Ok(())
    }

    pub(super) fn video(&self) -> PathBuf {
        self.video.clone().unwrap_or_default()
    }

    pub(super) fn timestamps(&self) -> PathBuf {
        self.timestamps.clone().unwrap_or_default()
    }

    /// The file of a sensor, if it was made.
    pub(super) fn sensor(&self, kind: Kind) -> Option<&Path> {
        let mut made = self.sensors.iter();
        made.find(|(of, _)| *of == kind)
            .map(|(_, path)| path.as_path())
    }

    /// Writes a sensor's file, if it was made.
    pub(super) fn save_sensor(&self, kind: Kind, samples: &[Sample]) -> std::io::Result<()> {
        match self.sensor(kind) {
            Some(path) => write_lines(path, samples.iter().map(csv_line)),
            None => Ok(()),
        }
    }

    /// Writes the frames' timestamps.
    pub(super) fn save_timestamps(&self, stamps: &[i64]) -> std::io::Result<()> {
        write_lines(&self.timestamps(), stamps.iter().map(i64::to_string))
    }
}

/// A file's name alone.
pub(super) fn name_of(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

fn write_lines(path: &Path, lines: impl Iterator<Item = String>) -> std::io::Result<()> {
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

/// `yyyyMMdd_HHmmss` of a Unix time, UTC.
fn date(unix: u64) -> String {
    let time = i64::try_from(unix).map(Timestamp::from_second);
    let time = time.ok().and_then(Result::ok).unwrap_or_default();
    time.strftime("%Y%m%d_%H%M%S").to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_the_app_s_and_never_taken_twice() {
        let storage = tempfile::tempdir().unwrap();
        let folder = storage.path().join("20210504_161730");
        let recording = |access, taken: &[PathBuf]| {
            let mut names = Names::new(storage.path(), access, 0);
            names.make_sensor(Kind::Gyroscope).unwrap();
            names.make_video(taken).unwrap();
            names
        };
        let first = recording(StorageAccess::Files, &[]);
        assert_eq!(name_of(&first.video()), "VID_20210504_161730.mp4");
        assert!(folder.join("VID_20210504_161730gyro.csv").exists());
        assert_eq!(first.timestamps().parent(), Some(folder.as_path()));
        assert_eq!(first.sensor(Kind::Accelerometer), None);
        let second = recording(StorageAccess::Files, &[first.video()]);
        assert_eq!(name_of(&second.video()), "VID_20210504_161730_1.mp4");
        let gyroscope = second.sensor(Kind::Gyroscope).unwrap();
        assert_eq!(name_of(gyroscope), "VID_20210504_161730gyro_1.csv");
        let third = recording(StorageAccess::Documents, &[]);
        let gyroscope = third.sensor(Kind::Gyroscope).unwrap();
        assert_eq!(name_of(gyroscope), "VID_20210504_161730gyro (1).csv");
    }
}
