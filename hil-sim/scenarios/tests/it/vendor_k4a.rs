//! The camera maker's own recording library writes, and we read; we write, and it reads.
//!
//! The library comes inside of the Python package pyk4a-bundle; the script
//! `tests/python/vendor_k4a.py` drives it. No camera: the images are made up.

use std::fs::File;
use std::path::Path;
use std::process::Command;

use crate::support::run_python;
use extract::depth::k4a::{Batch, CameraImu, Content, K4aError, RawImage, Recording, StartOffset};
use rig::depth_camera::k4a_mkv::{K4aImu, K4aMkvWriter, K4aSettings};
use serde_json::Value;
use system::ReadMonitor;
use test_support::processes;

/// Device time of the first capture in the library's recordings.
const START_US: i64 = 7_654_321;

fn run(what: &str, path: &Path) -> Value {
    serde_json::from_str(&run_python("vendor_k4a.py", &[Path::new(what), path])).unwrap()
}

/// Times in µs and checksums of big-endian images.
fn stamps(images: &[RawImage]) -> Vec<(i64, u32)> {
    let stamp = |image: &RawImage| {
        assert_eq!(image.at.0 % 1000, 0);
        (image.at.0 / 1000, crc32fast::hash(&image.bytes))
    };
    images.iter().map(stamp).collect()
}

/// The same, as the script tells them.
fn reported_stamps(reported: &Value) -> Vec<(i64, u32)> {
    let stamp = |pair: &Value| {
        let crc = u32::try_from(pair[1].as_u64().unwrap()).unwrap();
        (pair[0].as_i64().unwrap(), crc)
    };
    reported.as_array().unwrap().iter().map(stamp).collect()
}

/// An IMU sample: times in µs, and axes.
type Sample = (i64, [f32; 3], i64, [f32; 3]);

fn reported_imu(reported: &Value) -> Vec<Sample> {
    let axes = |axes: &Value| [0, 1, 2].map(|n| axes[n].as_f64().unwrap() as f32);
    let time = |time: &Value| time.as_i64().unwrap();
    let sample = |s: &Value| (time(&s[0]), axes(&s[1]), time(&s[2]), axes(&s[3]));
    reported.as_array().unwrap().iter().map(sample).collect()
}

fn samples(imu: &[CameraImu]) -> Vec<Sample> {
    let sample = |s: &CameraImu| (s.accel_at.0 / 1000, s.accel, s.gyro_at.0 / 1000, s.gyro);
    imu.iter().map(sample).collect()
}

/// Everything in an undamaged recording.
fn contents(recording: &mut Recording<impl system::Sparse>) -> Batch {
    let mut all = Batch::default();
    while let Some(batch) = recording.next_batch(Content::Pixels).unwrap() {
        assert!(batch.intact, "a checksum");
        all.depth.extend(batch.depth);
        all.ir.extend(batch.ir);
        all.color.extend(batch.color);
        all.imu.extend(batch.imu);
    }
    let damage = recording.damage();
    assert!(damage.is_empty(), "{damage:?}");
    all
}

/// Everything in a recording of the library, against what the script reports of it; of one
/// that was not closed, what had come to the disk.
fn holds(folder: &Path, reported: &Value, closed: bool) {
    let name = reported["file"].as_str().unwrap();
    let mut recording = Recording::open(&folder.join(name), &ReadMonitor::default()).unwrap();
    assert_eq!(recording.was_closed(), closed, "{name}");
    assert_eq!(
        recording.calibration(),
        Some(&br#"{"made": "up"}"#[..]),
        "{name}"
    );
    let size = match reported["mode"].as_u64() {
        Some(2) => (640, 576),
        _ => (320, 288),
    };
    assert_eq!(recording.size(), size, "{name}");
    if closed {
        assert_eq!(recording.tag("K4A_WIRED_SYNC_MODE"), Some("SUBORDINATE"));
        assert_eq!(recording.tag("K4A_SUBORDINATE_DELAY_NS"), Some("160000"));
        let offset = StartOffset::Tag(START_US * 1000);
        assert_eq!(recording.start_offset(), offset, "{name}");
    } else {
        let offset = StartOffset::Imu(START_US * 1000);
        assert_eq!(recording.start_offset(), offset, "{name}");
    }
    let all = contents(&mut recording);
    let (depth, ir, imu) = (all.depth, all.ir, samples(&all.imu));
    let (mut reported_depth, mut reported_ir) = (
        reported_stamps(&reported["depth"]),
        reported_stamps(&reported["ir"]),
    );
    let mut reported_samples = reported_imu(&reported["imu"]);
    if !closed {
        assert!(
            depth.len() >= 3 && imu.len() > 1000,
            "{name}: {} images",
            depth.len()
        );
        reported_depth.truncate(depth.len());
        reported_ir.truncate(ir.len());
        reported_samples.truncate(imu.len());
    }
    assert_eq!(stamps(&depth), reported_depth, "{name}: depth");
    assert_eq!(stamps(&ir), reported_ir, "{name}: infrared");
    assert!(imu == reported_samples, "{name}: IMU");
}

#[test]
fn recordings_of_the_makers_library_are_read_exactly() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let reported = run("write", folder);
    let of = |name: &str| {
        let files = reported.as_array().unwrap();
        files.iter().find(|file| file["file"] == name).unwrap()
    };
    for name in ["mjpg.mkv", "nv12.mkv", "yuy2.mkv", "bgra.mkv"] {
        assert!(of(name)["imu"].as_array().unwrap().len() > 300);
        holds(folder, of(name), true);
    }
    holds(folder, of("depth_alone.mkv"), true);
    // What is flushed is complete, whether it is closed or not.
    holds(folder, of("flushed.mkv"), true);
    holds(folder, of("unclosed.mkv"), false);
    match Recording::open(&folder.join("passive_ir.mkv"), &ReadMonitor::default()) {
        Err(K4aError::NoDepth { found }) => assert!(found.contains("IR"), "{found}"),
        Err(other) => panic!("{other}"),
        Ok(_) => panic!("passive infrared has no depth"),
    }
}

/// A file that the library wrote elsewhere, from made-up pictures (NOTICE).
#[test]
fn a_recording_from_elsewhere_holds_what_the_library_finds_in_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("elsewhere.mkv");
    let packed = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/tests/data/k4arecord_1.4.2_colour_depth_ir_imu.mkv.bz2"
    );
    let unpack = "import bz2, shutil, sys; \
        shutil.copyfileobj(bz2.open(sys.argv[1]), open(sys.argv[2], 'wb'))";
    processes::run(
        Command::new("python3")
            .args(["-c", unpack, packed])
            .arg(&path),
    );
    let reported = run("read", &path);

    let mut recording = Recording::open(&path, &ReadMonitor::default()).unwrap();
    assert!(recording.was_closed() && recording.color().unwrap().is_jpeg());
    assert_eq!(recording.size(), (320, 288));
    assert_eq!(
        recording.tag("K4A_DEPTH_MODE"),
        reported["K4A_DEPTH_MODE"].as_str()
    );
    let start = reported["start_timestamp_offset_usec"].as_i64().unwrap();
    assert_eq!(recording.start_offset(), StartOffset::Tag(start * 1000));
    let delay = reported["subordinate_delay_off_master_usec"]
        .as_u64()
        .unwrap()
        * 1000;
    assert_eq!(
        recording.tag("K4A_SUBORDINATE_DELAY_NS"),
        Some(&*delay.to_string())
    );
    let mut all = contents(&mut recording);
    // The library gives pixels little-endian.
    for image in all.depth.iter_mut().chain(&mut all.ir) {
        for pixel in image.bytes.chunks_exact_mut(2) {
            pixel.swap(0, 1);
        }
    }
    assert_eq!(all.depth.len(), 6);
    assert_eq!(stamps(&all.depth), reported_stamps(&reported["depth"]));
    assert_eq!(stamps(&all.ir), reported_stamps(&reported["ir"]));
    assert_eq!(stamps(&all.color), reported_stamps(&reported["color"]));
    let imu = samples(&all.imu);
    assert!(imu.len() > 100 && imu == reported_imu(&reported["imu"]));
}

#[test]
fn the_makers_library_reads_what_the_simulated_camera_records() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ours.mkv");
    let settings = K4aSettings {
        serial: "000123456789".into(),
        ..K4aSettings::default()
    };
    let (width, height) = (settings.width, settings.height);
    let pixels = |seed: u32| -> Vec<u16> {
        let pixel = |n: u32| (seed.wrapping_mul(7919).wrapping_add(n * 31)) as u16;
        (0..width * height).map(pixel).collect()
    };
    let little_endian = |pixels: &[u16]| -> u32 {
        let bytes: Vec<u8> = pixels.iter().flat_map(|p| p.to_le_bytes()).collect();
        crc32fast::hash(&bytes)
    };
    let start = 3_210_987_u64;
    let (mut depth, mut ir, mut imu) = (Vec::new(), Vec::new(), Vec::<Sample>::new());
    let mut writer = K4aMkvWriter::new(File::create(&path).unwrap(), settings).unwrap();
    for frame in 0..40 {
        let at = start + u64::from(frame) * 33_333;
        for n in 0..53 {
            let sample = K4aImu {
                accel_us: at + n * 625,
                accel: [0.5, -9.75, n as f32],
                gyro_us: at + n * 625 + 37,
                gyro: [frame as f32, 0.25, -1.0],
            };
            writer.write_imu(&sample).unwrap();
            let times = [sample.accel_us, sample.gyro_us].map(|us| us as i64);
            imu.push((times[0], sample.accel, times[1], sample.gyro));
        }
        let images = [pixels(frame), pixels(frame + 1000)];
        writer
            .write_capture(at, &images[0], Some(&images[1]))
            .unwrap();
        depth.push((at as i64, little_endian(&images[0])));
        ir.push((at as i64, little_endian(&images[1])));
    }
    writer.finish().unwrap();

    let read = run("read", &path);
    for (key, value) in [
        ("depth_mode", 2),
        ("camera_fps", 2),
        ("wired_sync_mode", 2),
        ("start_timestamp_offset_usec", start),
        // The end of the file, not a failure.
        ("end", 2),
        ("imu_end", 2),
    ] {
        assert_eq!(read[key], value, "{key}");
    }
    let tracks = ["color", "depth", "ir", "imu"].map(|t| &read[format!("{t}_track_enabled")]);
    assert_eq!(tracks, [false, true, true, true]);
    assert_eq!(read["K4A_DEVICE_SERIAL_NUMBER"], "000123456789");
    assert_eq!(read["K4A_DEPTH_MODE"], "NFOV_UNBINNED");
    assert_eq!(reported_stamps(&read["depth"]), depth);
    assert_eq!(reported_stamps(&read["ir"]), ir);
    assert_eq!(reported_imu(&read["imu"]), imu);
}
