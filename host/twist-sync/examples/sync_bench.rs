//! The clock estimate on simulated twists: error, honesty and time, scenario by
//! scenario; and the recordings as files, for other programs.
//!
//! `sync_bench [--trials N] [--export DIR --scenario NAME]`. All figures are of
//! simulated recordings. Run by `cargo xtask bench --sync`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::Instant;

use clap::Parser;
use rayon::prelude::*;
use twist_sync::simulate::{self, Scenario, Twist};
use twist_sync::{GyroTrack, Options, estimate_offset};

#[derive(Parser)]
struct Args {
    /// Twists per scenario
    #[arg(long, default_value_t = 300)]
    trials: u64,
    /// Only scenarios whose name contains this
    #[arg(long)]
    scenario: Option<String>,
    /// First seed
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Equal clock rates
    #[arg(long)]
    no_skew: bool,
    /// Write the recordings as CSV and our results beside the truth to this folder
    #[arg(long)]
    export: Option<PathBuf>,
}

fn options(scenario: &Scenario) -> Options {
    Options {
        a_delay_s: simulate::filter_delay_s(&scenario.spec.a),
        b_delay_s: simulate::filter_delay_s(&scenario.spec.b),
        ..Options::default()
    }
}

fn csv(track: &GyroTrack) -> String {
    let mut out = String::from("time,x,y,z\n");
    for (t, w) in track.t.iter().zip(&track.w) {
        let _ = writeln!(
            out,
            "{:.9},{:.9},{:.9},{:.9}",
            track.epoch_s + t,
            w[0],
            w[1],
            w[2]
        );
    }
    out
}

fn main() {
    let args = Args::parse();
    if args.export.is_none() {
        println!("Simulated twists, {} per scenario.\n", args.trials);
        println!(
            "| scenario | accepted | RMSE µs | largest µs | mean sigma µs | error/sigma rms | largest | ms each |"
        );
        println!("|---|---|---|---|---|---|---|---|");
    }
    for mut scenario in simulate::scenarios() {
        if args.no_skew {
            scenario.spec.skew_ppm = 0.0;
        }
        if args
            .scenario
            .as_ref()
            .is_some_and(|name| !scenario.name.contains(name.as_str()))
        {
            continue;
        }
        match &args.export {
            Some(folder) => export(&args, &scenario, folder),
            None => row(&args, &scenario),
        }
    }
}

fn twist(args: &Args, scenario: &Scenario, trial: u64) -> Twist {
    simulate::twist(&scenario.spec, args.seed + 1000 * trial)
}

fn row(args: &Args, scenario: &Scenario) {
    let options = options(scenario);
    let results: Vec<(Option<(f64, f64)>, f64)> = (0..args.trials)
        .into_par_iter()
        .map(|trial| {
            let twist = twist(args, scenario, trial);
            let start = Instant::now();
            let result = estimate_offset(&twist.a, &twist.b, &options);
            let ms = start.elapsed().as_secs_f64() * 1e3;
            let accepted = result.ok().map(|e| {
                let error = e.clock.offset - twist.offset_at(e.clock.reference);
                (error, e.offset_sigma_s())
            });
            (accepted, ms)
        })
        .collect();
    let ms = results.iter().map(|r| r.1).sum::<f64>() / results.len() as f64;
    let accepted: Vec<(f64, f64)> = results.iter().filter_map(|r| r.0).collect();
    let n = accepted.len() as f64;
    let rms = |f: &dyn Fn(&(f64, f64)) -> f64| {
        (accepted.iter().map(|a| f(a).powi(2)).sum::<f64>() / n).sqrt()
    };
    let most =
        |f: &dyn Fn(&(f64, f64)) -> f64| accepted.iter().map(|a| f(a).abs()).fold(0.0, f64::max);
    if accepted.is_empty() {
        println!(
            "| {} | 0 of {} | – | – | – | – | – | {ms:.0} |",
            scenario.name, args.trials
        );
        return;
    }
    println!(
        "| {} | {} of {} | {:.3} | {:.2} | {:.2} | {:.2} | {:.2} | {ms:.0} |",
        scenario.name,
        accepted.len(),
        args.trials,
        rms(&|a| a.0) * 1e6,
        most(&|a| a.0) * 1e6,
        accepted.iter().map(|a| a.1).sum::<f64>() / n * 1e6,
        rms(&|a| a.0 / a.1),
        most(&|a| a.0 / a.1),
    );
}

/// Recordings and a table `trial,reference,true offset there,ours,sigma,ms`.
fn export(args: &Args, scenario: &Scenario, folder: &std::path::Path) {
    std::fs::create_dir_all(folder).unwrap();
    let options = options(scenario);
    let mut table = String::from("trial,reference_s,true_offset_s,offset_s,sigma_s,ms\n");
    for trial in 0..args.trials {
        let twist = twist(args, scenario, trial);
        std::fs::write(folder.join(format!("{trial}_a.csv")), csv(&twist.a)).unwrap();
        std::fs::write(folder.join(format!("{trial}_b.csv")), csv(&twist.b)).unwrap();
        // From the files, as the other program gets them.
        let read = |side: &str| {
            phone::gyro_csv::read_file(&folder.join(format!("{trial}_{side}.csv")))
                .unwrap()
                .track
        };
        let (a, b) = (read("a"), read("b"));
        let start = Instant::now();
        let result = estimate_offset(&a, &b, &options);
        let ms = start.elapsed().as_secs_f64() * 1e3;
        let middle = twist.a.epoch_s + 0.5 * twist.a.t[twist.a.len() - 1];
        let (reference, ours, sigma) = result.map_or((middle, f64::NAN, f64::NAN), |e| {
            (e.clock.reference, e.clock.offset, e.offset_sigma_s())
        });
        let _ = writeln!(
            table,
            "{trial},{reference:.9},{:.9},{ours:.9},{sigma:.9},{ms:.3}",
            twist.offset_at(reference)
        );
    }
    std::fs::write(folder.join("ours.csv"), table).unwrap();
}
