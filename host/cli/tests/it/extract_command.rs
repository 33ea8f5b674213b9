//! `smartdepthsync extract` as a process: exit codes, output, the video by ffmpeg.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use clock::{ClockRelation, Wander};
use recording::session_file::SessionFile;
use serde_json::Value;

use crate::support::synthetic::{SECONDS, Wrong, make};
use crate::support::test_video;
use test_support::TestFolder;
use test_support::processes::Ran;

/// Phone − board, s; without any skew.
const OFFSET: i64 = 900_000;
const PERIOD_NS: i64 = 33_333_333;

/// A recording without depth, whose clocks have whole seconds between them.
pub(crate) fn recording(parent: &Path) -> PathBuf {
    let folder = make(parent, Wrong::default());
    let mut session = SessionFile::load(&folder).unwrap();
    session.phones[0].clock = Some(ClockRelation {
        reference: 2.0,
        offset: OFFSET as f64,
        skew: 0.0,
        covariance: [[1e-12, 0.0], [0.0, 1e-14]],
        wander: Wander::default(),
    });
    session.save(&folder).unwrap();
    folder
}

/// The phone's video of `frames` frames, and `rows` timestamps.
pub(crate) fn phone(folder: &Path, frames: u32, rows: i64) {
    let place = folder.join("phone/20260131_140327");
    fs::create_dir_all(&place).unwrap();
    let name = "VID_20260131_140327";
    test_video(&folder.join(format!("phone/{name}.mp4")), frames, &[]);
    let stamps: String = (0..rows)
        .map(|row| format!("{}\n", (OFFSET + 2) * 1_000_000_000 + row * PERIOD_NS))
        .collect();
    fs::write(place.join(format!("{name}_timestamps.csv")), stamps).unwrap();
}

fn extract(arguments: &[&str], folder: &Path, path: Option<&str>) -> Ran {
    let mut command = Command::new(env!("CARGO_BIN_EXE_smartdepthsync"));
    command.arg("extract").arg(folder).args(arguments);
    if let Some(path) = path {
        command.env("PATH", path);
    }
    Ran::new(&mut command)
}

/// Returns true if a part of the recording is missing.
fn lacks(report: &Value, part: &str) -> bool {
    let losses = report["losses"].as_array().unwrap();
    losses.iter().any(|loss| loss["part"] == part)
}

#[test]
fn a_video_becomes_images_named_by_board_time() {
    let parent = TestFolder::new();
    let folder = recording(parent.path());
    phone(&folder, 60, 60);
    // However the folder is named.
    let named = folder.join("../walk");
    let output = extract(&["--json"], &named, None);
    // There is neither depth nor a gyroscope of the phone: finished, with loss.
    assert_eq!(output.status.code(), Some(4), "{output:?}");
    let report = output.json();
    assert_eq!(report["phone"]["images"], 60);
    assert!(!lacks(&report, "video"), "{report}");
    assert_eq!(report["clock"]["source"], "session");
    assert_eq!(report["board"]["imu"]["samples"], SECONDS * 500);

    let out = parent.path().join("walk-euroc/mav0/cam0");
    let list = fs::read_to_string(out.join("data.csv")).unwrap();
    let rows: Vec<&str> = list.lines().skip(1).collect();
    assert_eq!(rows.len(), 60);
    // Half of the session's exposure, and its middle row, after the timestamp.
    let middle = 2_000_000 + 5_503_000;
    for (index, row) in (0..).zip(&rows) {
        let expected = 2_000_000_000 + index * PERIOD_NS + middle;
        assert_eq!(*row, format!("{expected:019},{expected:019}.png"));
        let image = fs::read(out.join("data").join(format!("{expected:019}.png"))).unwrap();
        assert_eq!(&image[..8], b"\x89PNG\r\n\x1a\n");
        let size = |at: usize| u32::from_be_bytes(image[at..at + 4].try_into().unwrap());
        assert_eq!((size(16), size(20)), (64, 48));
    }
    assert!(parent.path().join("walk-euroc/report.html").exists());
    let page = fs::read_to_string(folder.join("report.html")).unwrap();
    assert!(page.contains("\"../walk-euroc/report.html\""), "{page}");

    // Again: the same, at once. In another format into the same folder: refused.
    let again = extract(&["--json"], &folder, None);
    assert_eq!(again.json(), report);
    let out = parent.path().join("walk-euroc");
    let mixed = extract(
        &["--format", "tum", "--out", out.to_str().unwrap()],
        &folder,
        None,
    );
    assert_eq!(mixed.status.code(), Some(2));
}

#[test]
fn a_video_short_of_frames_is_a_loss() {
    let parent = TestFolder::new();
    let folder = recording(parent.path());
    phone(&folder, 58, 60);
    let report = extract(&["--json", "--format", "topics"], &folder, None).json();
    assert_eq!(report["phone"]["images"], 58);
    assert!(lacks(&report, "video"), "{report}");
}

#[test]
fn without_ffmpeg_everything_else_is_there() {
    let parent = TestFolder::new();
    let folder = recording(parent.path());
    phone(&folder, 30, 30);
    let nowhere = parent.path().join("nowhere");
    let output = extract(&["--json"], &folder, nowhere.to_str());
    assert_eq!(output.status.code(), Some(4), "{output:?}");
    let report = output.json();
    assert!(lacks(&report, "video"), "{report}");
    let out = parent.path().join("walk-euroc");
    assert!(out.join("mav0/imu0/data.csv").exists());
    assert!(out.join("phone_frames.csv").exists());
    assert!(!out.join("mav0/cam0").exists());
    // With ffmpeg again, the next run completes it.
    let report = extract(&["--json"], &folder, None).json();
    assert_eq!(report["phone"]["images"], 30);
    assert!(out.join("mav0/cam0/data.csv").exists());
}
