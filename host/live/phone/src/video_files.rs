//! Finds the files of one phone video.
//!
//! The app saves `{VIDEO}.mp4`, and in a folder named by the video's date
//! `{VIDEO}gyro.csv`, `{VIDEO}accel.csv`, and `{VIDEO}_imu_timestamps.csv` (older
//! versions: `{VIDEO}_timestamps.csv`). The folder may contain the video or be next to it, so
//! three levels are searched. If there are two files of a kind, the one at the upper level is
//! used, and at the same level the one of the newer app. Only names are compared; no file is
//! opened.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::file_name::without_number;

/// Most directory entries that are searched.
const MAX_ENTRIES: usize = 100_000;

/// Levels of folders that are searched: the recording's folder, the phone's in it, and the date's
/// in that.
const LEVELS: u32 = 3;

/// Endings of the names of frame timestamps. The longer one is first, as it contains the other.
const FRAME_ENDINGS: [&str; 2] = ["_imu_timestamps", "_timestamps"];

/// The files of one video. Any of them may be missing.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct VideoFiles {
    /// Common beginning of the names.
    pub name: String,
    /// The video.
    pub video: Option<PathBuf>,
    /// Frame timestamps.
    pub frames: Option<PathBuf>,
    /// Gyroscope.
    pub gyro: Option<PathBuf>,
    /// Accelerometer.
    pub accel: Option<PathBuf>,
}

impl VideoFiles {
    /// Returns descriptions of the files that are missing.
    #[must_use]
    pub fn missing(&self) -> Vec<&'static str> {
        let parts = [
            (&self.video, "video (.mp4)"),
            (
                &self.frames,
                "frame timestamps (_imu_timestamps.csv or _timestamps.csv)",
            ),
            (&self.gyro, "gyroscope (gyro.csv)"),
            (&self.accel, "accelerometer (accel.csv)"),
        ];
        parts
            .into_iter()
            .filter(|(file, _)| file.is_none())
            .map(|(_, description)| description)
            .collect()
    }
}

/// Failure to find the files of a video.
#[derive(Debug, thiserror::Error)]
pub enum FilesError {
    /// A folder cannot be read.
    #[error("reading {path}: {error}")]
    Io {
        /// The file or folder that was searched.
        path: PathBuf,
        /// The operating system's reason.
        error: io::Error,
    },
    /// A folder has the files of several videos.
    #[error(
        "{place} holds the files of {} recordings ({}); name the video itself with --phone",
        names.len(),
        names.join(", ")
    )]
    Several {
        /// The folder.
        place: PathBuf,
        /// Names of the videos.
        names: Vec<String>,
    },
}

/// Kind of a file of a video.
#[derive(Clone, Copy)]
pub(crate) enum Part {
    Video,
    Frames,
    Gyro,
    Accel,
}

/// Returns the kind of a file, by its name, and the name of its video.
pub(crate) fn classify(name: &str) -> Option<(Part, String)> {
    // The gyroscope of a twist is saved in a recording's folder and belongs to no video.
    if name.starts_with("twist_") && name.ends_with("_phone_gyro.csv") {
        return None;
    }
    let (stem, extension) = name.rsplit_once('.')?;
    if extension.eq_ignore_ascii_case("mp4") {
        return Some((Part::Video, stem.to_owned()));
    }
    // All names of a second video within one second end in the same number.
    let bare = (extension == "csv").then(|| without_number(stem))?;
    let number = stem.get(bare.len()..).unwrap_or_default();
    let sensors = [("gyro", Part::Gyro), ("accel", Part::Accel)];
    let endings = FRAME_ENDINGS.map(|ending| (ending, Part::Frames));
    let (video, part) = endings
        .into_iter()
        .chain(sensors)
        .find_map(|(ending, part)| Some((bare.strip_suffix(ending)?, part)))?;
    Some((part, format!("{video}{number}")))
}

/// Finds the files of the only video in a folder (three levels deep), or of the video `place` if
/// that is a file, or that of a table. If a folder has several videos, the one called `wanted` is chosen. Returns
/// `None` if there is no file of a phone.
///
/// # Errors
///
/// `place` cannot be read, or there are several videos and none of them is `wanted`.
pub fn find(place: &Path, wanted: Option<&str>) -> Result<Option<VideoFiles>, FilesError> {
    let fail = |error| FilesError::Io {
        path: place.to_owned(),
        error,
    };
    if fs::metadata(place).map_err(fail)?.is_file() {
        // A table of a video stands for the folder that it is in.
        let name = place.file_name().and_then(|name| name.to_str());
        if let Some((Part::Frames | Part::Gyro | Part::Accel, video)) = name.and_then(classify) {
            return find(system::folder_of(place), Some(&video));
        }
        let group = of_video(place).map_err(fail)?;
        return Ok(group.map(|group| VideoFiles {
            video: Some(place.to_owned()),
            ..group
        }));
    }
    let mut groups = collect(place).map_err(fail)?;
    if groups.len() <= 1 {
        return Ok(groups.into_values().next());
    }
    if let Some(group) = wanted.and_then(|wanted| groups.remove(wanted)) {
        return Ok(Some(group));
    }
    if let Some(joined) = join_renamed(&groups) {
        return Ok(Some(joined));
    }
    // Sensors without frames belong to a twist, not to a video.
    groups.retain(|_, group| group.video.is_some() || group.frames.is_some());
    if groups.len() == 1 {
        return Ok(groups.into_values().next());
    }
    if let Some(joined) = join_renamed(&groups) {
        return Ok(Some(joined));
    }
    Err(FilesError::Several {
        place: place.to_owned(),
        names: groups.into_keys().collect(),
    })
}

/// Finds the files that are named after a video, in its folder and below. The video itself need not
/// exist.
///
/// # Errors
///
/// The folder cannot be read.
pub fn of_video(video: &Path) -> io::Result<Option<VideoFiles>> {
    let mut groups = collect(system::folder_of(video))?;
    let stem = video.file_stem().and_then(|stem| stem.to_str());
    Ok(stem.and_then(|stem| groups.remove(stem)))
}

/// Joins one video and one set of CSV files under another name, because the video was renamed.
/// Returns `None` if there are other files.
fn join_renamed(groups: &BTreeMap<String, VideoFiles>) -> Option<VideoFiles> {
    let mut videos = groups.values().filter(|group| group.video.is_some());
    let mut sets = groups.values().filter(|group| group.video.is_none());
    let (video, set) = (videos.next()?, sets.next()?);
    let is_alone = [&video.frames, &video.gyro, &video.accel]
        .iter()
        .all(|file| file.is_none());
    if videos.next().is_some() || sets.next().is_some() || !is_alone {
        return None;
    }
    Some(VideoFiles {
        video: video.video.clone(),
        ..set.clone()
    })
}

/// Collects the files below a folder by the names of their videos.
fn collect(folder: &Path) -> io::Result<BTreeMap<String, VideoFiles>> {
    let mut groups = BTreeMap::new();
    let mut left = MAX_ENTRIES;
    collect_in(folder, LEVELS, &mut left, &mut groups)?;
    Ok(groups)
}

fn collect_in(
    folder: &Path,
    depth: u32,
    left: &mut usize,
    groups: &mut BTreeMap<String, VideoFiles>,
) -> io::Result<()> {
    let mut folders = Vec::new();
    let mut entries = fs::read_dir(folder)?.collect::<io::Result<Vec<_>>>()?;
    entries.sort_by_key(fs::DirEntry::file_name);
    for entry in entries {
        *left = left.saturating_sub(1);
        if *left == 0 {
            return Ok(());
        }
        let path = entry.path();
        if entry.file_type()?.is_dir() {
            folders.push(path);
            continue;
        }
        let name = entry.file_name();
        let Some((part, video)) = name.to_str().and_then(classify) else {
            continue;
        };
        let group = groups.entry(video.clone()).or_default();
        group.name = video;
        let slot = match part {
            Part::Video => &mut group.video,
            Part::Frames => &mut group.frames,
            Part::Gyro => &mut group.gyro,
            Part::Accel => &mut group.accel,
        };
        slot.get_or_insert(path);
    }
    // Files at an upper level take precedence.
    for folder in folders.iter().filter(|_| depth > 1) {
        // Folders that cannot be read are skipped.
        let _ = collect_in(folder, depth - 1, left, groups);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(files: &[&str]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for file in files {
            let path = folder.path().join(file);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, "").unwrap();
        }
        folder
    }

    #[test]
    fn both_forms_of_the_names_are_found() {
        for frames in ["_imu_timestamps.csv", "_timestamps.csv"] {
            let frames = format!("20210401_120000/VID_20210401_120000{frames}");
            let folder = folder(&[
                "VID_20210401_120000.mp4",
                "20210401_120000/VID_20210401_120000gyro.csv",
                "20210401_120000/VID_20210401_120000accel.csv",
                &frames,
                "notes.txt",
                "twist_1_phone_gyro.csv",
            ]);
            let found = find(folder.path(), None).unwrap().unwrap();
            assert_eq!(found.name, "VID_20210401_120000");
            assert_eq!(found.missing(), Vec::<&str>::new());
            assert!(found.frames.unwrap().ends_with(&frames));
            let video = folder.path().join("VID_20210401_120000.mp4");
            assert!(find(&video, None).unwrap().unwrap().gyro.is_some());
        }
    }

    #[test]
    fn a_second_video_within_one_second_has_files_of_its_own() {
        let names = ["gyro.csv", "accel.csv", "_imu_timestamps.csv", ".mp4"];
        for number in ["_1", " (1)"] {
            let second = names.map(|name| name.replace('.', &format!("{number}.")));
            let all = names.map(str::to_owned).into_iter().chain(second);
            let all: Vec<String> = all
                .map(|name| format!("VID_20210401_120000{name}"))
                .collect();
            let folder = folder(&all.iter().map(String::as_str).collect::<Vec<_>>());
            for video in [
                "VID_20210401_120000",
                &format!("VID_20210401_120000{number}"),
            ] {
                let found = find(folder.path(), Some(video)).unwrap().unwrap();
                assert_eq!(found.missing(), Vec::<&str>::new(), "{video}");
                let gyro = found.gyro.unwrap();
                let ending = video.replace("120000", "120000gyro");
                assert!(gyro.ends_with(format!("{ending}.csv")), "{gyro:?}");
            }
        }
    }

    #[test]
    fn several_recordings_are_refused_by_name() {
        let folder = folder(&["a.mp4", "b.mp4", "agyro.csv", "bgyro.csv"]);
        let error = find(folder.path(), None).unwrap_err().to_string();
        assert!(error.contains("(a, b)"), "{error}");
        let one = find(&folder.path().join("b.mp4"), None).unwrap().unwrap();
        assert!(one.gyro.unwrap().ends_with("bgyro.csv"));
        let named = find(folder.path(), Some("a")).unwrap().unwrap();
        assert!(named.gyro.unwrap().ends_with("agyro.csv"));
    }

    #[test]
    fn a_renamed_video_still_belongs_to_its_set() {
        let folder = folder(&["video.mp4", "x/VID_1gyro.csv", "x/VID_1_timestamps.csv"]);
        let found = find(folder.path(), None).unwrap().unwrap();
        assert!(found.video.is_some() && found.gyro.is_some() && found.frames.is_some());
        assert_eq!(found.missing(), ["accelerometer (accel.csv)"]);
    }

    #[test]
    fn sensors_left_over_from_a_twist_do_not_matter() {
        let twists = ["IMU_115900gyro.csv", "IMU_115930gyro.csv"];
        let whole = ["a.mp4", "d/agyro.csv", "d/aaccel.csv", "d/a_timestamps.csv"];
        let found = |files: &[&str]| find(folder(files).path(), None);
        for twists in [&twists[..1], &twists] {
            let one = found(&[&whole, twists].concat()).unwrap().unwrap();
            assert!(one.gyro.unwrap().ends_with("agyro.csv"));
            let renamed = ["video.mp4", whole[1], whole[3]];
            let one = found(&[&renamed, twists].concat()).unwrap().unwrap();
            assert!(one.gyro.unwrap().ends_with("agyro.csv"));
            assert!(one.video.unwrap().ends_with("video.mp4"));
        }
        // Which of two twists is whose is not guessed, and neither which video.
        assert!(found(&twists).is_err());
        let two = ["b.mp4", "d/bgyro.csv", twists[0]];
        assert!(found(&[&whole, &two[..]].concat()).is_err());
    }

    #[test]
    fn a_video_is_found_by_its_name_and_the_nearer_file_first() {
        let name = "VID_20240131_120000";
        let deep = format!("20240131_120000/{name}_imu_timestamps.csv");
        let folder = folder(&[&deep]);
        // The video itself need not be there.
        let video = folder.path().join(format!("{name}.mp4"));
        let frames = || of_video(&video).unwrap().unwrap().frames.unwrap();
        assert!(frames().ends_with(&deep));
        for near in ["_timestamps.csv", "_imu_timestamps.csv"] {
            let near = folder.path().join(format!("{name}{near}"));
            fs::write(&near, "").unwrap();
            assert_eq!(frames(), near);
        }
        assert_eq!(of_video(&video.with_file_name("VID_2.mp4")).unwrap(), None);
    }

    #[test]
    fn a_folder_without_files_of_a_phone_has_no_video() {
        assert_eq!(find(folder(&["readme.md"]).path(), None).unwrap(), None);
        assert!(find(Path::new("no/such/place"), None).is_err());
    }
}
