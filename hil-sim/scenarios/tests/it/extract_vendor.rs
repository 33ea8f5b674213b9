//! Depth recordings by the camera maker's own library (from PyPI), whose tags decide the
//! times: mode, delays, sync mode; and one that mkvmerge wrote again.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::json;

use crate::support::run_python;
use crate::synthetic::{Synthetic, Truth, make};
use crate::whole_chain::programs;
use extract::error::ExtractError;
use extract::layout::Format;
use extract::options::Options;
use extract::report::{ExtractReport, MatchError};
use extract::run::{Job, run};
use recording::profile::Profile;
use recording::session_file::SessionFile;
use scenarios::whole_chain::{self, Plan};
use test_support::{TestFolder, processes};

/// Numbers of the maker's enumerations (k4atypes.h).
const NFOV_2X2BINNED: u8 = 1;
pub(crate) const NFOV_UNBINNED: u8 = 2;
const WFOV_UNBINNED: u8 = 4;
const STANDALONE: u8 = 0;
const SUBORDINATE: u8 = 2;

pub(crate) struct Case {
    folder: PathBuf,
    /// Holds the folder, if it goes with the test.
    _temporary: Option<TestFolder>,
}

impl Case {
    pub(crate) fn new(config: &Synthetic) -> (Self, Truth) {
        let case = Self::empty();
        let truth = case.make(config);
        (case, truth)
    }

    /// The same in a folder that stays until the next run.
    pub(crate) fn lasting(name: &str, config: &Synthetic) -> (Self, Truth) {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        // After a clean build there is no such folder.
        let _ = std::fs::remove_dir_all(&folder);
        let case = Self {
            folder,
            _temporary: None,
        };
        let truth = case.make(config);
        (case, truth)
    }

    fn empty() -> Self {
        let temporary = TestFolder::new();
        Self {
            folder: temporary.path().to_owned(),
            _temporary: Some(temporary),
        }
    }

    fn make(&self, config: &Synthetic) -> Truth {
        let recording = self.path("recording");
        std::fs::create_dir_all(&recording).unwrap();
        make(&recording, config)
    }

    /// A recording of the whole chain, with the phone's files in its folder.
    pub(crate) fn of_chain(plan: &Plan) -> Self {
        let case = Self::empty();
        let recorded = whole_chain::record(plan, &programs(), &case.folder).unwrap();
        std::fs::rename(recorded.phone, recorded.folder.join("phone")).unwrap();
        std::fs::rename(recorded.folder, case.path("recording")).unwrap();
        case
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    pub(crate) fn extract(
        &self,
        depth: Option<&Path>,
        out: &str,
        options: Options,
    ) -> ExtractReport {
        self.extract_as(Format::Euroc, depth, out, options)
    }

    pub(crate) fn extract_as(
        &self,
        format: Format,
        depth: Option<&Path>,
        out: &str,
        options: Options,
    ) -> ExtractReport {
        self.try_extract(format, depth, out, options).unwrap()
    }

    pub(crate) fn try_extract(
        &self,
        format: Format,
        depth: Option<&Path>,
        out: &str,
        options: Options,
    ) -> Result<ExtractReport, ExtractError> {
        let job = Job {
            recording: self.path("recording"),
            phone: None,
            depth: depth.map(Path::to_owned),
            format,
            out: self.path(out),
            options,
            overwrite: false,
            monitor: system::ReadMonitor::default(),
        };
        run(&job)
    }

    /// A recording of the maker's library with these device times.
    pub(crate) fn vendor(&self, name: &str, frames: &[i64], more: serde_json::Value) -> PathBuf {
        let mut spec = json!({
            "frames": frames, "depth_mode": NFOV_2X2BINNED, "sync": SUBORDINATE,
            "subordinate_us": 0, "depth_delay_us": 0, "color": null, "color_us": 0,
            "size": [16, 16], "calibration": null,
        });
        for (key, value) in more.as_object().unwrap() {
            spec[key] = value.clone();
        }
        let spec_path = self.path(&format!("{name}.json"));
        std::fs::write(&spec_path, spec.to_string()).unwrap();
        let out = self.path(&format!("{name}.mkv"));
        run_python("vendor_recording.py", &[&spec_path, &out]);
        out
    }

    /// Frames by ffmpeg.
    pub(crate) fn test_picture(&self, name: &str, size: &str, frames: usize) -> PathBuf {
        let path = self.path(name);
        let (source, frames) = (format!("testsrc2=size={size}"), frames.to_string());
        let mut ffmpeg = Command::new("ffmpeg");
        ffmpeg.args(["-v", "error", "-f", "lavfi", "-i", &source]);
        processes::run(ffmpeg.args(["-frames:v", &frames]).arg(&path));
        path
    }

    /// Columns of a table of an output as integers.
    pub(crate) fn table(&self, file: &str, columns: &[usize]) -> Vec<Vec<Option<i64>>> {
        let text = std::fs::read_to_string(self.path(file)).unwrap();
        let row = |line: &str| {
            let cells: Vec<&str> = line.split(',').collect();
            let cell = |&column: &usize| cells[column].parse().ok();
            columns.iter().map(cell).collect()
        };
        text.lines().skip(1).map(row).collect()
    }

    fn depth_times(&self, out: &str) -> Vec<i64> {
        let rows = self.table(&format!("{out}/depth_frames.csv"), &[2]);
        rows.iter().map(|row| row[0].unwrap()).collect()
    }
}

pub(crate) fn said(report: &ExtractReport, what: &str) {
    let losses = report.losses.iter().map(|loss| &loss.what);
    let found = losses
        .chain(&report.remarks)
        .any(|text| text.contains(what));
    assert!(found, "{what}\n{:#?}\n{:#?}", report.losses, report.remarks);
}

fn later(found: &[i64], base: &[i64], by: i64) {
    assert_eq!(found.len(), base.len());
    for (found, base) in found.iter().zip(base) {
        assert_eq!(found - base, by);
    }
}

#[test]
fn the_files_own_tags_decide_the_times() {
    let (case, _) = Case::new(&Synthetic {
        seed: 5,
        seconds: 25,
        ..Synthetic::default()
    });
    case.extract(None, "base", Options::default());
    let base = case.depth_times("base");
    let device = case.table("base/depth_frames.csv", &[1]);
    let device: Vec<i64> = device.iter().map(|row| row[0].unwrap() / 1000).collect();

    // Another mode than the profile's NFOV: 20.245 ms of pulses and not 12.725 ms.
    let wide = case.vendor("wide", &device, json!({ "depth_mode": WFOV_UNBINNED }));
    let report = case.extract(Some(&wide), "wide", Options::default());
    later(&case.depth_times("wide"), &base, 3_760_000);
    said(
        &report,
        "in mode WFOV_UNBINNED and the profile says NFOV_UNBINNED",
    );
    // A profile that has the file's mode.
    let mut profile = SessionFile::load(&case.path("recording")).unwrap().profile;
    profile.depth.mode = String::from("WFOV_UNBINNED");
    let with = |profile: &Profile| Options {
        profile: Some(profile.clone()),
        ..Options::default()
    };
    case.extract(Some(&wide), "given", with(&profile));
    let nominal = case.depth_times("given")[0];
    assert!((nominal - base[0]).abs() < 1_000_000, "{nominal}");
    profile.depth.mode = String::from("NFOV_UNBINNED");

    // Delays, and colour 160 µs behind depth.
    let jpeg = case.test_picture("color.jpg", "1280x720", 1);
    let delays = json!({
        "subordinate_us": 500, "depth_delay_us": -160, "color": jpeg, "color_us": 160,
        "size": [320, 288],
    });
    let delayed = case.vendor("delayed", &device, delays);
    let report = case.extract(Some(&delayed), "delayed", Options::default());
    let depth = case.depth_times("delayed");
    later(&depth, &base, 340_000);
    said(&report, "500 µs after the trigger");
    said(&report, "color_exposure_us");
    let found = report.depth.as_ref().unwrap();
    assert_eq!(found.color, base.len() as u64);
    assert!(
        found.damaged.is_empty() && found.broken.is_empty(),
        "{found:?}"
    );
    let color = case.table("delayed/camera_frames.csv", &[3]);
    assert_eq!(color.len(), depth.len());
    for (color, depth) in color.iter().zip(&depth) {
        // 160 µs of a clock that is 300 ppm off, and stamps of whole microseconds.
        assert!(
            (color[0].unwrap() - depth - 160_000).abs() < 1_100,
            "{color:?}"
        );
    }
    let cam1 = case.path("delayed/mav0/cam1");
    let list = std::fs::read_to_string(cam1.join("data.csv")).unwrap();
    let name = list.lines().nth(1).unwrap().split(',').nth(1).unwrap();
    let written = std::fs::read(cam1.join("data").join(name)).unwrap();
    assert_eq!(written, std::fs::read(&jpeg).unwrap());

    // A colour exposure of 20 ms begins before the pulses of depth, by SDK issue 868.
    profile.depth.color_exposure_us = Some(20_000.0);
    case.extract(Some(&delayed), "exposed", with(&profile));
    later(&case.depth_times("exposed"), &base, 340_000 + 3_637_500);
    let start = case.table("exposed/camera_frames.csv", &[2, 3]);
    assert!(
        start
            .iter()
            .all(|row| row[1].unwrap() - row[0].unwrap() == 10_000_000)
    );

    // A flipped bit in a colour image is found by the checksum of its cluster.
    let mut bytes = std::fs::read(&delayed).unwrap();
    let place = bytes
        .windows(4)
        .rposition(|w| w == [0xFF, 0xD8, 0xFF, 0xE0])
        .unwrap();
    bytes[place + 5_000] ^= 4;
    let flipped = case.path("flipped.mkv");
    std::fs::write(&flipped, bytes).unwrap();
    let report = case.extract(Some(&flipped), "flipped", Options::default());
    assert!(!report.depth.as_ref().unwrap().damaged.is_empty());
    said(&report, "checksum is wrong");

    // Written again with times in whole milliseconds.
    let merged = case.path("merged.mkv");
    let mut mkvmerge = Command::new("mkvmerge");
    processes::run(mkvmerge.args(["-q", "-o"]).args([&merged, &wide]));
    let report = case.extract(Some(&merged), "merged", Options::default());
    said(&report, "mkvmerge");
    said(&report, "to 1 ms");
    let losses = format!("{:?}", report.losses);
    assert!(!losses.contains("sync cable"), "{losses}");

    // No pulse made the frames of a camera on its own.
    let alone = case.vendor("alone", &device, json!({ "sync": STANDALONE }));
    let report = case.extract(Some(&alone), "alone", Options::default());
    let reason = report.depth.as_ref().unwrap().not_matched.clone().unwrap();
    let sync = String::from("STANDALONE");
    assert_eq!(reason, MatchError::OtherSync { sync });
    said(&report, "--external-sync sub");
}
