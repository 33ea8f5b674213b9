//! Errors of the evaluation on rendered frames.
//!
//! `cargo run --release -p hil-sim --example strobe_study -- [SEEDS]`
//!
//! Every line is one setting over several seeds, each with another bias. Figures
//! are simulated: the light path is ideal and the truth is known.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "../tests/it/strobes.rs"]
mod strobes;

use evaluate::Settings;
use evaluate::footage::Footage;
use evaluate::precision::{RecordingResult, evaluate_recording};
use rig::rolling_shutter::RollingShutter;
use rig::video_writer::Quality;
use strobes::Scene;

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len().max(1) as f64).sqrt()
}

struct Case {
    exposure_us: f64,
    row_time_us: f64,
    amplitude: f64,
    lit_from: u64,
    quality: Option<Quality>,
}

fn run(case: &Case, seed: u64) -> Option<(RecordingResult, f64)> {
    let scene = Scene {
        camera: RollingShutter {
            columns: if case.quality.is_some() { 320 } else { 96 },
            exposure_ns: 1e3 * case.exposure_us,
            row_time_ns: 1e3 * case.row_time_us,
            amplitude: case.amplitude,
            seed,
            ..RollingShutter::default()
        },
        // Anywhere within half a pitch.
        bias_us: ((seed as f64 * 0.618_034).fract() - 0.5) * 1500.0,
        lit_from: case.lit_from,
        ..Scene::default()
    };
    // Known to half a per cent, as from a measurement before.
    let settings = Settings {
        row_time_us: Some(case.row_time_us * 1.003),
        exposure_us: Some(case.exposure_us),
        ..Settings::default()
    };
    let result = match case.quality {
        None => scene.evaluate(&settings),
        Some(quality) => {
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("scene.mp4");
            scene.write_mp4(&path, quality);
            Footage::read(&path, &settings, None, &|| false)
                .and_then(|r| evaluate_recording(r, &settings, 16))
                .map(|e| e.result)
        }
    };
    match result {
        Ok(result) => Some((result, scene.truth_of_last_us(16))),
        Err(e) => {
            println!("  seed {seed}: {e}");
            None
        }
    }
}

fn main() {
    let seeds: u64 = std::env::args()
        .nth(1)
        .and_then(|s| s.parse().ok())
        .unwrap_or(10);
    println!(
        "{:>8} {:>8} {:>5} {:>9} {:>8} | {:>9} {:>9} {:>7} {:>9}",
        "exposure",
        "row time",
        "grey",
        "reference",
        "codec",
        "fit rms",
        "fit max",
        "z rms",
        "row ppm"
    );
    for (quality, references) in [(None, &[4, 0][..]), (Some(Quality::RateFactor(23)), &[4])] {
        for &lit_from in references {
            for (row_time_us, exposures) in [
                (
                    10.2,
                    &[100.0, 125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0][..],
                ),
                (8.0, &[125.0, 1000.0]),
                (20.0, &[125.0, 1000.0, 4000.0]),
            ] {
                for &exposure_us in exposures {
                    for amplitude in [3.0, 20.0, 60.0] {
                        let case = Case {
                            exposure_us,
                            row_time_us,
                            amplitude,
                            lit_from,
                            quality,
                        };
                        report(&case, seeds);
                    }
                }
            }
        }
    }
}

fn report(case: &Case, seeds: u64) {
    let (mut fit, mut z, mut row) = (vec![], vec![], vec![]);
    for seed in 1..=seeds {
        let Some((r, truth)) = run(case, seed) else {
            continue;
        };
        fit.push(r.bias_us - truth);
        z.push((r.bias_us - truth) / r.sigma_us);
        row.push((r.row_time_us / case.row_time_us - 1.0) * 1e6);
    }
    let codec = match case.quality {
        None => "none".to_owned(),
        Some(Quality::RateFactor(q)) => format!("crf {q}"),
        Some(Quality::BitRate(b)) => format!("{} M", b / 1_000_000),
    };
    println!(
        "{:>8} {:>8} {:>5} {:>9} {:>8} | {:>9.3} {:>9.3} {:>7.2} {:>9.1}",
        case.exposure_us,
        case.row_time_us,
        case.amplitude,
        if case.lit_from > 0 { "frames" } else { "none" },
        codec,
        rms(&fit),
        fit.iter().fold(0.0f64, |m, e| m.max(e.abs())),
        rms(&z),
        rms(&row)
    );
}
