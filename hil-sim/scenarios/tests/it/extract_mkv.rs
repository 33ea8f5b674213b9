//! Depth recordings as the camera writes them, whole, cut off and damaged, read
//! by the extractor's reader.

use std::io::Cursor;
use std::path::Path;

use extract::depth::k4a::{Content, RawImage, Recording, StartOffset};
use rig::depth_camera::k4a_mkv::{K4aImu, K4aMkvWriter, K4aSettings};
use system::ReadMonitor;

const START_US: u64 = 5_123_457;
const FRAMES: u64 = 120;

fn settings() -> K4aSettings {
    K4aSettings {
        width: 32,
        height: 18,
        calibration: b"{\"a\": 1}".to_vec(),
        ..K4aSettings::default()
    }
}

fn frame_us(frame: u64) -> u64 {
    START_US + frame * 33_333
}

fn pixels(frame: u64) -> Vec<u16> {
    (0..32 * 18)
        .map(|pixel| (frame * 131 + pixel * 7) as u16)
        .collect()
}

fn infrared(frame: u64) -> Vec<u16> {
    pixels(frame)
        .iter()
        .map(|pixel| pixel.wrapping_mul(3))
        .collect()
}

/// A recording of four seconds with IMU; the writer and where the last cluster ends.
fn record(imu: bool) -> K4aMkvWriter<Cursor<Vec<u8>>> {
    let settings = K4aSettings { imu, ..settings() };
    let mut writer = K4aMkvWriter::new(Cursor::new(Vec::new()), settings).unwrap();
    let mut next = START_US;
    for frame in 0..FRAMES {
        while imu && next < frame_us(frame) + 30_000 {
            // 1.6 kHz; the gyroscope a little later than the accelerometer.
            writer
                .write_imu(&K4aImu {
                    accel_us: next,
                    accel: [0.5, -9.75, 0.25],
                    gyro_us: next + 33,
                    gyro: [next as f32, 0.125, -1.0],
                })
                .unwrap();
            next += 625;
        }
        writer
            .write_capture(frame_us(frame), &pixels(frame), Some(&infrared(frame)))
            .unwrap();
    }
    writer
}

struct Read {
    depth: Vec<RawImage>,
    damaged: usize,
    damage: usize,
    offset: StartOffset,
    closed: bool,
}

fn read_file(path: &Path) -> Read {
    collect(Recording::open(path, &ReadMonitor::default()).unwrap())
}

fn read_bytes(bytes: &[u8]) -> Read {
    collect(Recording::new(Cursor::new(bytes)).unwrap())
}

fn collect<R: system::Sparse>(mut recording: Recording<R>) -> Read {
    let mut read = Read {
        depth: Vec::new(),
        damaged: 0,
        damage: 0,
        offset: recording.start_offset(),
        closed: recording.was_closed(),
    };
    while let Some(batch) = recording.next_batch(Content::Pixels).unwrap() {
        read.damaged += usize::from(!batch.intact);
        read.depth.extend(batch.depth);
    }
    read.damage = recording.damage().len();
    read
}

/// Leaves what a crash of the recorder leaves: no information, no start offset, no cues,
/// no size.
fn crashed(imu: bool) -> Vec<u8> {
    let mut writer = record(imu);
    writer.flush_clusters().unwrap();
    writer.into_inner().into_inner()
}

#[test]
fn a_recording_that_was_not_closed_keeps_its_device_times() {
    let bytes = crashed(true);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("crashed.mkv");
    std::fs::write(&path, &bytes).unwrap();
    let read = read_file(&path);
    assert!(!read.closed);
    assert_eq!(read.offset, StartOffset::Imu(START_US as i64 * 1000));
    assert_eq!(read.depth.len(), 120);
    // Times alone: the same frames, without their bytes.
    let mut times = Recording::open(&path, &ReadMonitor::default()).unwrap();
    let mut frames = (0..).zip(&read.depth);
    while let Some(batch) = times.next_batch(Content::Times).unwrap() {
        for image in batch.depth {
            let (frame, depth) = frames.next().unwrap();
            assert_eq!(depth.at.0, frame_us(frame) as i64 * 1000);
            assert_eq!((image.at, image.size), (depth.at, depth.bytes.len()));
            assert!(image.bytes.is_empty());
        }
    }
    assert!(frames.next().is_none());
    // Without an IMU track the times count from the first block.
    std::fs::write(&path, crashed(false)).unwrap();
    let read = read_file(&path);
    assert_eq!(read.offset, StartOffset::Lost);
    assert_eq!(read.depth[7].at.0, 7 * 33_333_000);
}

#[test]
fn a_recording_cut_at_any_place_gives_its_whole_frames() {
    let bytes = crashed(true);
    let whole = read_bytes(&bytes);
    // Every byte of the head, then steps that meet all parts of a cluster.
    let head = bytes
        .windows(4)
        .position(|four| four == [0x1F, 0x43, 0xB6, 0x75])
        .unwrap();
    let cuts = (0..head + 400).chain((head + 400..bytes.len()).step_by(1009));
    let mut frames = 0;
    for cut in cuts {
        let Ok(recording) = Recording::new(Cursor::new(&bytes[..cut])) else {
            assert!(cut <= head + 4, "not opened when cut at {cut}");
            continue;
        };
        let read = collect(recording);
        assert!(
            read.depth.len() >= frames,
            "fewer frames when cut later, at {cut}"
        );
        frames = read.depth.len();
        for (one, all) in read.depth.iter().zip(&whole.depth) {
            assert_eq!(one.bytes, all.bytes);
        }
    }
    assert!(frames >= 119);
    let error = Recording::new(Cursor::new(b"not a video")).err().unwrap();
    assert!(error.to_string().contains("no Matroska file"), "{error}");
}

#[test]
fn damage_in_the_middle_costs_what_it_hits() {
    let good = record(true).finish().unwrap().into_inner();
    let clusters: Vec<usize> = good
        .windows(4)
        .enumerate()
        .filter(|(_, four)| *four == [0x1F, 0x43, 0xB6, 0x75])
        .map(|(at, _)| at)
        .collect();
    assert!(clusters.len() > 100);
    // A flipped bit within pixels: everything is there, and the checksum tells.
    let mut flipped = good.clone();
    flipped[clusters[40] + 700] ^= 0x10;
    let read = read_bytes(&flipped);
    assert_eq!((read.depth.len(), read.damaged), (120, 1));
    // The head of a cluster overwritten: the reader goes on at the next one.
    let mut broken = good.clone();
    broken[clusters[50]..clusters[50] + 64].fill(0);
    let read = read_bytes(&broken);
    assert!(
        (119..=120).contains(&read.depth.len()),
        "{}",
        read.depth.len()
    );
    assert!(read.damage > 0);
    // A hole in the file.
    let mut hole = good[..clusters[60] + 100].to_vec();
    hole.extend_from_slice(&good[clusters[70] + 200..]);
    let read = read_bytes(&hole);
    assert!(
        (108..=110).contains(&read.depth.len()),
        "{}",
        read.depth.len()
    );
    assert!(read.damage > 0);
}
