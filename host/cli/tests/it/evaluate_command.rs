//! `smartdepthsync evaluate` as a process: files in, JSON and pictures out.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use evaluate::train::{Shape, TrainGeometry, row_light};

use crate::support::{code, program, run, run_line};
use test_support::TestFolder;
use test_support::browser;

/// A video of 64 columns and 1,080 rows of 10.2 µs, without loss; the first three frames
/// without flashes.
fn video(path: PathBuf, bias_us: f64) -> PathBuf {
    let shape = Shape {
        bias_us,
        row_time_us: 10.2,
        exposure_us: 250.0,
    };
    let grey = |at: usize| {
        let (frame, y, x) = (at / 64 / 1080, at / 64 % 1080, at % 64);
        let light = row_light(&TrainGeometry::NFOV, &shape, y as f64 - 539.5).value;
        let lit = if frame < 3 { 0.0 } else { 40.0 * light };
        // Differs from pixel to pixel, so that rounding averages out.
        let mixed = (x * 7919 + y * 104_729 + frame * 1_299_709) as u32;
        let noise = f64::from(mixed.wrapping_mul(2_654_435_761) >> 16) / 65_536.0 * 4.0;
        (30.0 + lit + noise) as u8
    };
    let pixels: Vec<u8> = (0..64 * 1080 * 12).map(grey).collect();
    let mut encoder = Command::new("ffmpeg")
        .args("-v error -f rawvideo -pix_fmt gray -s 64x1080 -r 30 -i - -c:v ffv1".split(' '))
        .arg(&path)
        .stdin(Stdio::piped())
        .spawn()
        .unwrap();
    encoder.stdin.take().unwrap().write_all(&pixels).unwrap();
    assert!(encoder.wait().unwrap().success());
    path
}

#[test]
fn precision_with_all_outputs() {
    let dir = TestFolder::new();
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let inputs: Vec<String> = [("a.mkv", 100.0), ("b.mkv", 104.0), ("c.mkv", 98.0)]
        .iter()
        .map(|(name, bias)| {
            video(dir.path().join(name), *bias)
                .to_str()
                .unwrap()
                .to_owned()
        })
        .collect();
    let html = path("report.html");
    let all = inputs.join(" ");
    let ran = run_line(&format!(
        "--json evaluate precision --row-time 10.2us --out {html} {all}"
    ));
    assert_eq!(code(&ran), 0, "{ran:?}");
    let json = ran.json();
    for (recording, truth) in json["recordings"]
        .as_array()
        .unwrap()
        .iter()
        .zip([100.0, 104.0, 98.0])
    {
        let bias = recording["bias_us"].as_f64().unwrap();
        assert!((bias - truth).abs() < 0.3, "{recording}");
        assert_eq!(recording["frames"]["without_flashes"], 3);
        assert_eq!(recording["frames"]["used"], 9);
    }
    let mean = json["bias"]["mean_us"].as_f64().unwrap();
    assert!((mean - 302.0 / 3.0).abs() < 0.2, "{mean}");
    assert!((json["bias"]["iqr_us"].as_f64().unwrap() - 3.0).abs() < 0.3);
    let row_time = json["row_time_us"].as_f64().unwrap();
    assert!((row_time / 10.2 - 1.0).abs() < 1e-3);
    browser::check(
        Path::new(&html),
        "evaluate",
        &[
            "data:image/png;base64,",
            "flash 5, row ",
            "after the middle of the phone",
        ],
    );

    let text = run(&["evaluate", "precision", "--row-time", "10.2us", &inputs[0]]);
    assert_eq!(code(&text), 0, "{text:?}");
    // Three frames without bands do not show that the others have flashes.
    let text = run(&["evaluate", "precision", &inputs[0]]);
    assert_eq!(code(&text), 3, "{text:?}");
}

#[test]
fn calibration_adds_to_what_was_applied_and_refuses_the_open() {
    let dir = TestFolder::new();
    let profile = dir.path().join("rig.toml");
    std::fs::write(
        &profile,
        "# rig\n[frame_sync]\nbias_us = -4000.0 # first guess\n",
    )
    .unwrap();
    let profile = profile.to_str().unwrap();
    let read = || -> toml::Table { std::fs::read_to_string(profile).unwrap().parse().unwrap() };

    // The train's ends are out of view.
    let open = video(dir.path().join("open.mkv"), 12.0);
    let open = open.to_str().unwrap();
    let calibrate = |rest: &str| {
        let ran = run_line(&format!("evaluate precision --calibrate {profile} {rest}"));
        println!("{ran:?}");
        code(&ran)
    };
    let known = format!("--row-time 10.2us {open}");
    assert_eq!(calibrate(&known), 3);
    assert_eq!(read()["frame_sync"]["bias_us"].as_float(), Some(-4000.0));
    // Known to half a pitch: accepted.
    assert_eq!(calibrate(&format!("--near 0us {known}")), 0);
    let bias = read()["frame_sync"]["bias_us"].as_float().unwrap();
    assert!((bias + 3988.0).abs() < 0.3, "{bias}");

    // With an end in view the frames say it themselves; the profile's bias was applied.
    let moved = video(dir.path().join("moved.mkv"), 4012.0);
    assert_eq!(calibrate(moved.to_str().unwrap()), 0);
    let table = &read()["frame_sync"];
    let bias = table["bias_us"].as_float().unwrap();
    assert!((bias - 24.0).abs() < 0.5, "{bias}");
    assert!(table["bias_sigma_us"].as_float().unwrap() < 0.5);
    assert!(table["bias_measured"].as_datetime().is_some());
    let text = std::fs::read_to_string(profile).unwrap();
    assert!(text.starts_with("# rig\n") && text.contains("# first guess"));
}

/// 4K at 60 frames per second: a clear answer, and memory that does not grow with
/// the video.
#[test]
fn four_k_sixty_in_bounded_memory() {
    let dir = TestFolder::new();
    let video = dir.path().join("4k60.mp4");
    let made = Command::new("ffmpeg")
        .args(
            "-v error -f lavfi -i color=c=gray:s=3840x2160:r=60:d=1.5,noise=alls=8:allf=t"
                .split(' '),
        )
        .args("-c:v libx264 -preset ultrafast -pix_fmt yuv420p".split(' '))
        .arg(&video)
        .status()
        .expect("ffmpeg, which the project's test command installs");
    assert!(made.success());
    let mut child = program(&["evaluate", "precision", video.to_str().unwrap()])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let status = format!("/proc/{}/status", child.id());
    let mut peak_kib = 0u64;
    while child.try_wait().unwrap().is_none() {
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        let now = text
            .lines()
            .find_map(|l| l.strip_prefix("VmHWM:"))
            .and_then(|l| l.trim().trim_end_matches(" kB").parse().ok());
        peak_kib = peak_kib.max(now.unwrap_or(0));
        std::thread::sleep(Duration::from_millis(5));
    }
    let output = child.wait_with_output().unwrap();
    let err = String::from_utf8(output.stderr).unwrap();
    println!("peak {peak_kib} KiB");
    assert_eq!(output.status.code(), Some(3), "{err}");
    assert!((1..100 * 1024).contains(&peak_kib), "peak {peak_kib} KiB");
}
