//! Videos made by `ffmpeg` and read back.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use std::path::Path;
use std::process::Command;

use phone::video::{Pixels, Video, VideoError, presentation_times};
use system::ReadMonitor;

/// Five lossless frames of 32x16 pixels, all of grey level 100.
fn grey(path: &Path) {
    let made = Command::new("ffmpeg")
        .args(["-v", "error", "-f", "lavfi", "-i"])
        .arg("nullsrc=s=32x16:r=25:d=0.2,format=gray,geq=lum=100")
        .args(["-c:v", "png"])
        .arg(path)
        .status()
        .expect("this test needs ffmpeg: sudo apt-get install ffmpeg");
    assert!(made.success());
}

#[test]
fn every_frame_comes_once_as_luma_and_as_colours() {
    let dir = tempfile::tempdir().unwrap();
    // A name that could be taken for an option, or for a pattern.
    let path = dir.path().join("-i %d: ?.mkv");
    grey(&path);
    for (pixels, depth) in [(Pixels::Luma, 1), (Pixels::Rgb, 3)] {
        let mut video = Video::open(&path, pixels, &ReadMonitor::default()).unwrap();
        let info = video.info();
        assert_eq!((info.width, info.height), (32, 16));
        assert!((info.rate.unwrap() - 25.0).abs() < 1e-9);
        let (mut frame, mut count) = (Vec::new(), 0);
        while video.next_frame(&mut frame).unwrap() {
            assert_eq!(frame.len(), 32 * 16 * depth);
            assert!(frame.iter().all(|&level| level == 100));
            count += 1;
        }
        assert_eq!(count, 5);
        assert!(!video.next_frame(&mut frame).unwrap());
    }
    let times = presentation_times(&path, &ReadMonitor::default()).unwrap();
    assert_eq!(times, [0, 40_000_000, 80_000_000, 120_000_000, 160_000_000]);
}

#[test]
fn damaged_files_and_what_is_no_video_are_told_apart() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("whole.mkv");
    grey(&path);
    let mut bytes = std::fs::read(&path).unwrap();
    // In the pixels of the last frame.
    let data = bytes.windows(4).rposition(|name| name == b"IDAT").unwrap();
    bytes[data + 4..data + 10].fill(0xa5);
    let damaged = dir.path().join("damaged.mkv");
    std::fs::write(&damaged, bytes).unwrap();
    let mut video = Video::open(&damaged, Pixels::Rgb, &ReadMonitor::default()).unwrap();
    let mut frame = Vec::new();
    let error = loop {
        match video.next_frame(&mut frame) {
            Ok(more) => assert!(more, "the damage was not noticed"),
            Err(error) => break error,
        }
    };
    assert!(matches!(error, VideoError::Decode(_)), "{error}");
    assert!(!video.next_frame(&mut frame).unwrap());

    let text = dir.path().join("text.mp4");
    std::fs::write(&text, "not a video").unwrap();
    let error = Video::open(&text, Pixels::Luma, &ReadMonitor::default()).unwrap_err();
    assert!(matches!(error, VideoError::NotAVideo(_)), "{error}");
    assert_eq!(presentation_times(&text, &ReadMonitor::default()), None);
}
