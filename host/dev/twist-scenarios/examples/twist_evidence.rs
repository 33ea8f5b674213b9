//! The evidence about the phone's stream in `host/sync/twist-sync-python/python/twist_sync/example`, as Markdown:
//! displacement of each class of samples modulo ten against the board's
//! gyroscope, copies apart, and the offset under variants of the estimate.
//!
//! `cargo run --release -p twist-scenarios --example twist_evidence`
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::Path;

use twist_sync::interpolant::Uneven;
use twist_sync::{Action, Estimate, GyroTrack, Options, Stream, estimate_offset};

/// A sample of the phone beside the board's rate at the same instant.
struct Pair {
    /// Index of the sample of the phone.
    index: usize,
    /// Time of the board, seconds.
    a_s: f64,
    /// The board's rate in the axes of the phone, rad/s.
    a: [f64; 3],
    /// The phone's sample, rad/s.
    b: [f64; 3],
}

/// All samples of the phone that lie between used samples of the board, whose rate is known
/// there.
fn pairs(mcu: &GyroTrack, phone: &GyroTrack, estimate: &Estimate) -> Vec<Pair> {
    let faults = estimate.report.faults.iter();
    let of_mcu = faults.filter(|f| f.stream == Stream::A && f.action == Action::LeftOut);
    let out: Vec<usize> = of_mcu.flat_map(|f| f.samples.clone()).collect();
    let kept = || (0..mcu.len()).filter(|k| !out.contains(k));
    let t: Vec<f64> = kept().map(|k| mcu.t[k]).collect();
    let w: Vec<[f64; 3]> = kept().map(|k| mcu.w[k]).collect();
    let rates = Uneven::new(&t, &w).unwrap();
    let (first, last) = rates.domain();
    let clock = &estimate.clock;
    let all = phone.t.iter().zip(&phone.w).enumerate();
    all.filter_map(|(index, (t, &b))| {
        let at = clock.b_to_a(phone.epoch_s + t) - mcu.epoch_s;
        let rate = rates.value(at);
        let a = std::array::from_fn(|i| {
            let row = estimate.calibration[i];
            (0..3).map(|k| row[k] * rate[k]).sum::<f64>() + estimate.bias[i]
        });
        let a_s = mcu.epoch_s + at;
        (first..=last)
            .contains(&at)
            .then_some(Pair { index, a_s, a, b })
    })
    .collect()
}

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
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../sync/twist-sync-python/python/twist_sync/example");
    let read = |name: &str| twist_scenarios::read_csv(&folder.join(name)).unwrap();
    let (mcu, phone) = (read("mcu_gyro_data.csv"), read("smartphone_gyro_data.csv"));
    let options = Options::default();
    let estimate = estimate_offset(&mcu, &phone, &options).unwrap();
    let pairs = pairs(&mcu, &phone, &estimate);
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
