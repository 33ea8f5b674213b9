//! The evidence about the phone's stream in `data/twist`, as Markdown:
//! displacement of each class of samples modulo ten against the board's
//! gyroscope, copies apart, and the offset under variants of the estimate.
//!
//! `cargo run --release -p twist-scenarios --example twist_evidence`
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::Path;

use phone::gyro_csv;
use twist_sync::compare::{self, Pair};
use twist_sync::{GyroTrack, Options, estimate_offset};

/// Displacement of some samples (µs) with its 1-sigma from their scatter.
fn displacement(
    pairs: &[Pair],
    slopes: &[[f64; 3]],
    chosen: impl Fn(&Pair) -> bool,
) -> (f64, f64, usize) {
    let members: Vec<(f64, f64)> = pairs
        .iter()
        .zip(slopes)
        .filter(|(pair, _)| chosen(pair))
        .map(|(pair, slope)| {
            (0..3).fold((0.0, 0.0), |(score, information), axis| {
                (
                    score - (pair.b[axis] - pair.a[axis]) * slope[axis],
                    information + slope[axis] * slope[axis],
                )
            })
        })
        .collect();
    let information: f64 = members.iter().map(|m| m.1).sum();
    let shift = members.iter().map(|m| m.0).sum::<f64>() / information;
    let scatter: f64 = members.iter().map(|m| (m.0 - shift * m.1).powi(2)).sum();
    (
        shift * 1e6,
        scatter.sqrt() / information * 1e6,
        members.len(),
    )
}

fn main() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/twist");
    let read = |name: &str| gyro_csv::read_file(&folder.join(name)).unwrap().track;
    let (mcu, phone) = (read("mcu_gyro_data.csv"), read("smartphone_gyro_data.csv"));
    let options = Options::default();
    let estimate = estimate_offset(&mcu, &phone, &options).unwrap();
    let pairs = compare::pairs(&mcu, &phone, &estimate, &options);
    // Rate of change of the board's rate over ±5 samples of the phone.
    let slopes: Vec<[f64; 3]> = (0..pairs.len())
        .map(|i| {
            let (before, after) = (
                &pairs[i.saturating_sub(5)],
                &pairs[(i + 5).min(pairs.len() - 1)],
            );
            std::array::from_fn(|axis| (after.a[axis] - before.a[axis]) / (after.a_s - before.a_s))
        })
        .collect();
    let first = |k: usize| k + 1 < phone.len() && phone.w[k] == phone.w[k + 1];
    let second = |k: usize| k > 0 && phone.w[k] == phone.w[k - 1];

    println!("| samples | number | content is late (−) or early (+) by, µs |");
    println!("|---|---|---|");
    let row = |name: &str, chosen: &dyn Fn(&Pair) -> bool| {
        let (shift, sigma, count) = displacement(&pairs, &slopes, chosen);
        println!("| {name} | {count} | {:+.0} ± {sigma:.0} |", -shift);
    };
    row("first of a pair of copies", &|p| first(p.index));
    row("second of a pair of copies", &|p| second(p.index));
    for class in 0..10 {
        row(&format!("number 10·n + {class}, no copies"), &|p| {
            p.index % 10 == class && !first(p.index) && !second(p.index)
        });
    }

    println!("\n| variant | offset − 947,848.638 s at board time 1267 s, µs | 1-sigma, µs |");
    println!("|---|---|---|");
    let variant =
        |name: &str, mcu: &GyroTrack, phone: &GyroTrack, options: &Options| match estimate_offset(
            mcu, phone, options,
        ) {
            Ok(e) => {
                let at = e.clock.offset_at(1267.0);
                println!(
                    "| {name} | {:.1} | {:.1} |",
                    (at.value - 947_848.638) * 1e6,
                    at.sigma * 1e6
                );
            }
            Err(refusal) => println!("| {name} | refused: {refusal} | |"),
        };
    variant("as it is used", &mcu, &phone, &options);
    let with = |change: fn(&mut Options)| {
        let mut options = options;
        change(&mut options);
        options
    };
    for (name, options) in [
        ("faults kept", with(|o| o.handle_faults = false)),
        ("low-pass 15 Hz", with(|o| o.low_pass_hz = 15.0)),
        ("low-pass 40 Hz", with(|o| o.low_pass_hz = 40.0)),
    ] {
        variant(name, &mcu, &phone, &options);
    }
    let only = |track: &GyroTrack, keep: fn(usize) -> bool| {
        let kept = || (0..track.len()).filter(|&k| keep(k));
        GyroTrack {
            epoch_s: track.epoch_s,
            t: kept().map(|k| track.t[k]).collect(),
            w: kept().map(|k| track.w[k]).collect(),
        }
    };
    let every_other = only(&mcu, |k| k % 2 == 0);
    let clean = only(&phone, |k| k % 10 > 1);
    let (start, end) = (mcu.epoch_s, mcu.epoch_s + 9.8);
    let middle = estimate.clock.reference;
    let (early, late) = (mcu.between(start, middle), mcu.between(middle, end));
    for (name, mcu, phone) in [
        ("every other sample of the board", &every_other, &phone),
        ("classes 0 and 1 removed beforehand", &mcu, &clean),
        ("first half of the information", &early, &phone),
        ("second half of the information", &late, &phone),
    ] {
        variant(name, mcu, phone, &options);
    }
}
