//! The evaluation on real H.264, and on videos that are not as they should be.

use std::path::Path;
use std::process::Command;

use crate::strobes::Scene;
use evaluate::footage::Footage;
use evaluate::precision::{self, Evaluated, evaluate_recording};
use evaluate::{EvaluateError, Settings};
use report::evaluation;
use rig::picture::rolling_shutter::RollingShutter;
use rig::picture::video_writer::Quality;
use test_support::processes::run;

fn scene(exposure_us: f64, row_time_us: f64, amplitude: f64, bias_us: f64) -> Scene {
    Scene {
        camera: RollingShutter {
            columns: 320,
            exposure_ns: 1e3 * exposure_us,
            row_time_ns: 1e3 * row_time_us,
            amplitude,
            ..RollingShutter::default()
        },
        bias_us,
        ..Scene::default()
    }
}

fn evaluate(path: &Path, settings: &Settings) -> Result<Evaluated, EvaluateError> {
    let recording = Footage::read(path, settings, None)?;
    evaluate_recording(recording, settings, 16)
}

/// Compressed video: bias within 2 µs, row time within 0.2 %.
#[test]
fn compressed_video_keeps_the_bias() {
    let dir = tempfile::tempdir().unwrap();
    println!("exposure  row time  grey  quality | fit error  sigma  row time ppm");
    for (i, (exposure, row_time, grey, quality)) in [
        (100.0, 10.2, 40.0, Quality::RateFactor(23)),
        (125.0, 8.0, 60.0, Quality::RateFactor(28)),
        (250.0, 20.0, 30.0, Quality::RateFactor(23)),
        (1000.0, 10.2, 30.0, Quality::BitRate(3_000_000)),
        (4000.0, 14.0, 30.0, Quality::RateFactor(20)),
    ]
    .into_iter()
    .enumerate()
    {
        // Without the row time, an end of the train shows that these are flashes: one more would be in the
        // picture.
        let end_us = if i > 1 { 0.0 } else { 4100.0 };
        let scene = scene(exposure, row_time, grey, 217.0 - 133.3 * i as f64 + end_us);
        let path = dir.path().join(format!("{i}.mp4"));
        scene.write_mp4(&path, quality);
        let settings = Settings {
            row_time_us: (i > 1).then_some(row_time),
            ..Settings::default()
        };
        let result = evaluate(&path, &settings).unwrap().result;
        let error = result.bias_us - scene.bias_us;
        let row = (result.row_time_us / row_time - 1.0) * 1e6;
        println!(
            "{exposure:8} {row_time:9} {grey:5} {quality:?} | {error:8.3} {:7.3} {row:8.0}",
            result.sigma_us
        );
        assert!(error.abs() < 2.0, "{exposure} µs: {error} µs");
        assert!(
            error.abs() < result.uncertainty_99_us,
            "{error} µs {result:?}"
        );
        assert!(row.abs() < 2000.0, "{exposure} µs: {row} ppm");
    }
}

#[test]
fn videos_without_flashes_truncated_or_of_another_size() {
    let dir = tempfile::tempdir().unwrap();
    let settings = Settings {
        row_time_us: Some(10.2),
        ..Settings::default()
    };
    let lit = scene(125.0, 10.2, 40.0, 55.0);
    let good = dir.path().join("good.mp4");
    lit.write_mp4(&good, Quality::RateFactor(20));

    let dark = dir.path().join("dark.mp4");
    Scene {
        lit_from: u64::MAX,
        ..lit.clone()
    }
    .write_mp4(&dark, Quality::RateFactor(20));
    let e = evaluate(&dark, &settings).unwrap_err();
    assert!(
        matches!(e, EvaluateError::NoFlashes { frames: 20, .. }),
        "{e}"
    );

    // The index of an MP4 comes last.
    let cut = dir.path().join("cut.mp4");
    let bytes = std::fs::read(&good).unwrap();
    std::fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    let e = evaluate(&cut, &settings).unwrap_err().to_string();
    assert!(e.contains("cut.mp4") && e.contains("truncated"), "{e}");

    // With the index in front, half of the frames are still there.
    let front = dir.path().join("front.mp4");
    let mut ffmpeg = Command::new("ffmpeg");
    ffmpeg.args(["-v", "error", "-i"]).arg(&good);
    run(ffmpeg
        .args(["-c", "copy", "-movflags", "faststart"])
        .arg(&front));
    let bytes = std::fs::read(&front).unwrap();
    std::fs::write(&front, &bytes[..bytes.len() * 7 / 10]).unwrap();
    let result = evaluate(&front, &settings).unwrap().result;
    assert!(
        result
            .notes
            .iter()
            .any(|n| n.contains("truncated:") && n.contains("of 20 frames")),
        "{:?}",
        result.notes
    );
    assert!((result.bias_us - 55.0).abs() < 2.0, "{result:?}");

    let text = dir.path().join("text.mp4");
    std::fs::write(&text, "not a video").unwrap();
    let e = evaluate(&text, &settings).unwrap_err();
    assert!(matches!(e, EvaluateError::NotAVideo { .. }), "{e}");

    // A recording of another size among others is left out and named.
    let small = dir.path().join("small.mp4");
    Scene {
        camera: RollingShutter {
            rows: 720,
            ..lit.camera.clone()
        },
        ..lit.clone()
    }
    .write_mp4(&small, Quality::RateFactor(20));
    let inputs = [good.clone(), small.clone(), dark.clone()];
    let mut reported = 0;
    let (result, shown) =
        precision::evaluate(&inputs, &settings, 16, &mut |_, _| reported += 1).unwrap();
    assert_eq!((result.recordings.len(), reported), (1, 3));
    let reasons: Vec<&str> = result.left_out.iter().map(|l| l.reason.as_str()).collect();
    assert!(reasons[0].contains("320x720"), "{reasons:?}");
    assert!(reasons[1].contains("no strobe flashes"), "{reasons:?}");

    let shown = shown.unwrap();
    let html = evaluation::precision(&result, false, &shown.shown, &settings, &good);
    assert!(html.contains("data:image/png;base64,") && html.contains("left out"));
    assert!(!html.contains("src=\"http") && !html.contains("<script"));
    assert!(html.contains("<svg") && html.contains("sensor row"));
}

/// The phone's timestamps beside the video are the time axis.
#[test]
fn the_app_s_timestamps_are_used() {
    let dir = tempfile::tempdir().unwrap();
    let video = dir.path().join("VID_20240131_120000.mp4");
    let scene = Scene {
        frames: 40,
        drift_us_per_min: 600.0,
        // The video claims twice the rate at which its frames were taken.
        ..scene(125.0, 10.2, 60.0, 0.0)
    };
    scene.write_mp4(&video, Quality::RateFactor(15));
    let settings = Settings {
        row_time_us: Some(10.2),
        ..Settings::default()
    };
    let drift = |settings: &Settings| {
        let recording = Footage::read(&video, settings, None).unwrap();
        evaluate::drift::evaluate(recording, settings)
            .unwrap()
            .result
    };
    let by_rate = drift(&settings);
    assert!(
        (by_rate.drift_us_per_min - 600.0).abs() < 30.0,
        "{by_rate:?}"
    );
    let lines: Vec<String> = (0..40)
        .map(|f| (scene.start_ns(f) + (scene.start_ns(f) - scene.start_ns(0))).to_string())
        .collect();
    let csv = dir.path().join("VID_20240131_120000_imu_timestamps.csv");
    std::fs::write(&csv, lines.join("\n")).unwrap();
    let by_file = drift(&settings);
    assert!(
        (by_file.drift_us_per_min / by_rate.drift_us_per_min - 0.5).abs() < 1e-3,
        "{by_file:?}"
    );
    // Fewer timestamps than frames: the rest is left out, and said.
    std::fs::write(&csv, lines[..30].join("\n")).unwrap();
    let shorter = drift(&settings);
    assert_eq!(shorter.frames.read, 30);
    assert!(
        shorter
            .notes
            .iter()
            .any(|n| n.contains("30 timestamps for a video of 40 frames")),
        "{:?}",
        shorter.notes
    );
}
