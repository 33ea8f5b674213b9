//! The clock estimate on families of twists: acceptance, error, and error over sigma.
//!
//! `sync_families [--trials N] [--only WORD] [--verbose]`. All figures are of simulated recordings.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use clap::Parser;
use rayon::prelude::*;
use twist_scenarios::rms;
use twist_sync::estimate_offset;

#[derive(Parser)]
struct Args {
    /// Twists in each family
    #[arg(long, default_value_t = 40)]
    trials: u64,
    /// Only families whose name contains this
    #[arg(long, default_value = "")]
    only: String,
    /// First seed
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Print the result of each trial
    #[arg(long)]
    verbose: bool,
}

fn main() {
    let args = Args::parse();
    println!(
        "| family | accepted | asked | rms µs | mean sigma µs | z rms | z 95 % | skew z | 95 % |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for (place, family) in (0..).zip(twist_scenarios::families()) {
        if !family.name.contains(&args.only) {
            continue;
        }
        let each = (0..args.trials).into_par_iter().map(|trial| {
            let seed = args.seed + 1000 * (place * 1000 + trial) + 3;
            let (twist, options, also_s) = family.twist(seed);
            let result = estimate_offset(&twist.a, &twist.b, &options);
            let out = result.as_ref().ok().map(|e| {
                let error = e.clock.offset - twist.offset_at(e.clock.reference);
                let error = if (error - also_s).abs() < error.abs() {
                    error - also_s
                } else {
                    error
                };
                let skew = (e.clock.skew - twist.skew) / e.skew_sigma();
                (error, e.offset_sigma_s(), skew)
            });
            if args.verbose {
                let said = match &result {
                    Ok(e) => {
                        let (error, sigma, skew) = out.unwrap();
                        format!(
                            "{:+.2} ± {:.2} µs = {:+.2}, skew {skew:+.2} {:?} {:?}",
                            error * 1e6,
                            sigma * 1e6,
                            error / sigma,
                            e.report.warnings,
                            e.report
                                .faults
                                .iter()
                                .map(|f| (f.stream, f.kind, f.count))
                                .collect::<Vec<_>>()
                        )
                    }
                    Err(refusal) => refusal.to_string(),
                };
                println!("{trial}: {said}");
            }
            out
        });
        let each: Vec<(f64, f64, f64)> = each.collect::<Vec<_>>().into_iter().flatten().collect();
        let n = each.len().max(1) as f64;
        let rms = |of: fn(&(f64, f64, f64)) -> f64| rms(each.iter().map(of));
        let p95 = |of: fn(&(f64, f64, f64)) -> f64| {
            let mut all: Vec<f64> = each.iter().map(|e| of(e).abs()).collect();
            all.sort_by(f64::total_cmp);
            all.get((all.len() * 95) / 100).copied().unwrap_or(f64::NAN)
        };
        println!(
            "| {} | {} of {} | {:.0} % | {:.1} | {:.1} | {:.2} | {:.1} | {:.2} | {:.1} |",
            family.name,
            each.len(),
            args.trials,
            1e2 * family.accepted,
            1e6 * rms(|e| e.0),
            1e6 * each.iter().map(|e| e.1).sum::<f64>() / n,
            rms(|e| e.0 / e.1),
            p95(|e| e.0 / e.1),
            rms(|e| e.2),
            p95(|e| e.2),
        );
    }
}
