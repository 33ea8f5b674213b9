//! The flashes light up the rows that were exposed at that moment, through the
//! whole chain: true time, the phone's clock, the rolling shutter, H.264, and
//! a decoder.

use std::process::Command;
use std::sync::Arc;

use rig::flash_log::{FlashLog, TrueFlash};
use rig::oscillator::TrueTime;
use rig::rolling_shutter::FlashTrain;

use crate::phone_bench::Bench;

/// Frames that see flashes.
const FLASHED: usize = 80;

/// Mean grey level of each row of each frame.
fn rows_of(path: &std::path::Path, rows: usize, columns: usize) -> Vec<Vec<f64>> {
    let out = Command::new("ffmpeg")
        .args(["-v", "error", "-i"])
        .arg(path)
        .args([
            "-f",
            "rawvideo",
            "-pix_fmt",
            "gray",
            "-fps_mode",
            "passthrough",
            "pipe:1",
        ])
        .output()
        .expect("ffmpeg is needed for this test");
    assert!(out.status.success());
    out.stdout
        .chunks_exact(rows * columns)
        .map(|frame| {
            frame
                .chunks_exact(columns)
                .map(|row| row.iter().map(|&p| f64::from(p)).sum::<f64>() / columns as f64)
                .collect()
        })
        .collect()
}

/// Middle of the band between two rows that is brighter than half way from the
/// scene to its brightest row, to a fraction of a row.
fn middle_of_band(rows: &[f64], from: usize, to: usize) -> f64 {
    let scene = rows[from].min(rows[to]);
    let brightest = rows[from..=to].iter().copied().fold(0.0, f64::max);
    let half = 0.5 * (scene + brightest);
    let crossing = |above: usize, below: usize| {
        let (a, b) = (rows[above], rows[below]);
        above as f64 + (below as f64 - above as f64) * (a - half) / (a - b)
    };
    let first = (from..=to).find(|&r| rows[r] > half).unwrap();
    let last = (from..=to).rfind(|&r| rows[r] > half).unwrap();
    0.5 * (crossing(first, first - 1) + crossing(last, last + 1))
}

#[test]
fn flashes_light_up_the_rows_that_were_exposed() {
    let log = FlashLog::default();
    let mut bench = Bench::with(40, Arc::new(log.clone()), |c| {
        c.camera.exposure_ns = 200_000;
        c.camera.read_noise = 0.5;
        c.app.stop_ms = 0.0;
    });
    bench.pass(1.0);
    let started = bench.phone.ask("video_start");
    // The depth camera's centre is 400 µs late, and drifts by 10 µs a frame.
    let video = bench.phone.videos()[0].clone();
    let train = FlashTrain::NFOV;
    let late = |n: usize| 400_000 + 10_000 * n as i64;
    let true_ns = |ns: i64| {
        let at = bench.phone.oscillator().when_nanos(ns).unwrap();
        at.as_nanos() as i64
    };
    for n in 0..FLASHED {
        let center = true_ns(video.frames.middle_ns(n)) + late(n);
        for flash in train.centered_at(center) {
            let at = |ns: i64| TrueTime::from_nanos(ns.unsigned_abs());
            log.push(TrueFlash {
                start: at(flash.start_ns),
                end: at(flash.start_ns + flash.duration_ns),
            });
        }
    }
    bench.pass(4.0);
    assert_eq!(bench.take(started).unwrap()[0], "SUCCESS");
    bench.ask("video_stop");
    assert_eq!(bench.ask("get_video")[0], "SUCCESS");

    let camera = bench.phone.handset().config.camera.clone();
    let frames = rows_of(&bench.phone.videos()[0].path, camera.rows, camera.columns);
    let count = bench.phone.videos()[0].count.unwrap();
    assert_eq!(frames.len(), count);
    assert!(count > FLASHED + 1);
    let pitch = train.pitch_ns as f64 / camera.row_time_ns;
    let mut worst = 0.0f64;
    for (n, rows) in frames.iter().enumerate().take(FLASHED) {
        let middle = 0.5 * (camera.rows as f64 - 1.0) + late(n) as f64 / camera.row_time_ns;
        for k in -2..=2 {
            let expected = middle + f64::from(k) * pitch;
            let from = (expected - 0.5 * pitch) as usize;
            let found = middle_of_band(rows, from, from + pitch as usize);
            worst = worst.max((found - expected).abs());
        }
    }
    println!("worst flash: {worst:.3} rows off");
    // A row is 10.2 µs; what is left is compression and grey levels.
    assert!(worst < 1.0, "a flash is {worst:.2} rows off");
    // Behind the last flash there is the scene only.
    let dark = &frames[count - 1];
    let brightest = dark.iter().copied().fold(0.0, f64::max);
    assert!(brightest < camera.ambient + 5.0, "{brightest}");
}
