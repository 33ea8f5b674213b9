//! The clock estimate on simulated twists: error, honesty and time, scenario by
//! scenario; and the recordings as files, for other programs.
//!
//! `sync_bench [--trials N] [--hour | --export DIR --scenario NAME]`. All figures are of
//! simulated recordings. Run by `cargo xtask bench sync`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fmt::Write as _;
use std::path::PathBuf;

use clap::Parser;
use rayon::prelude::*;
use twist_scenarios::{ClockPath, Scenario, Twist, TwistSpec, options, rms};
use twist_sync::robust;
use twist_sync::{ClockRelation, Estimate, GyroTrack, Options, Refusal, estimate_offset};

#[derive(Parser)]
struct Args {
    /// Twists per scenario; five times as many of those that must be refused
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
    /// Print the result of each trial
    #[arg(long)]
    verbose: bool,
    /// Five twists over an hour instead, of some scenarios
    #[arg(long)]
    hour: bool,
    /// Write the recordings as CSV, and the results beside the ground truth, to this folder; for
    /// all scenarios to subfolders
    #[arg(long)]
    export: Option<PathBuf>,
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

/// Factor of the number of trials for scenarios that must be refused.
const REFUSALS: u64 = 5;

/// Recordings of which five are taken over an hour.
const HOUR: [&str; 4] = [
    "base",
    "faulty stream b",
    "several faults of b",
    "two phones with faults",
];

fn main() {
    let args = Args::parse();
    if args.export.is_none() && !args.hour {
        println!("Simulated twists, {} per scenario.\n", args.trials);
        println!(
            "| scenario | accepted | RMSE µs | largest µs | mean sigma µs | error/sigma rms | largest | of the skew | ms |"
        );
        println!("|---|---|---|---|---|---|---|---|---|");
    }
    let scenarios = twist_scenarios::scenarios();
    if args.hour {
        println!("\nFive estimates of one pair of clocks over an hour, about a straight line:\n");
        println!("| recordings | accepted | error/sigma rms |\n|---|---|---|");
        for name in HOUR {
            if let Some(scenario) = scenarios.iter().find(|s| s.name == name) {
                hour(&args, name, &scenario.spec);
            }
        }
        return;
    }
    for mut scenario in scenarios {
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
            Some(folder) if args.scenario.is_some() => export(&args, &scenario, folder),
            Some(folder) => {
                let letters = |c: char| if c.is_ascii_alphanumeric() { c } else { '-' };
                let name: String = scenario.name.chars().map(letters).collect();
                export(&args, &scenario, &folder.join(name));
            }
            None => row(&args, &scenario),
        }
    }
}

fn twist(args: &Args, scenario: &Scenario, trial: u64) -> Twist {
    twist_scenarios::twist(&scenario.spec, args.seed + 1000 * trial)
}

fn row(args: &Args, scenario: &Scenario) {
    let options = options(&scenario.spec);
    // One that is accepted wrongly weighs more than one that is refused.
    let count = match scenario.rmse_us {
        Some(_) => args.trials,
        None => REFUSALS * args.trials,
    };
    let trials: Vec<Option<Accepted>> = (0..count)
        .into_par_iter()
        .map(|trial| {
            let twist = twist(args, scenario, trial);
            let result = estimate_offset(&twist.a, &twist.b, &options);
            if args.verbose {
                println!("{trial}: {}", reported(&twist, &result));
            }
            result.ok().map(|e| Accepted {
                error_s: e.clock.offset - twist.offset_at(e.clock.reference),
                sigma_s: e.offset_sigma_s(),
                skew_sigmas: (e.clock.skew - twist.skew) / e.skew_sigma(),
            })
        })
        .collect();
    print_row(scenario.name, &trials, median_ms(args, scenario));
}

/// Twists of a row that are timed, one after the other.
const TIMED: u64 = 15;
/// Runs of each estimate, of which the fastest counts: other work on the machine only adds time.
const RUNS: usize = 5;

/// Processor time of this thread, ms. Linux updates the figure when the thread yields.
fn processor_ms() -> f64 {
    std::thread::yield_now();
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    let nanos = text.split(' ').next().unwrap();
    nanos.parse::<f64>().unwrap() * 1e-6
}

/// Time of one estimate by itself, ms: in the trials a waiting thread takes on other work.
fn fastest_ms(a: &GyroTrack, b: &GyroTrack, options: &Options) -> f64 {
    let run = |_| {
        let start = processor_ms();
        let result = estimate_offset(a, b, options);
        let ms = processor_ms() - start;
        std::hint::black_box(result.is_ok());
        ms
    };
    (0..RUNS).map(run).fold(f64::INFINITY, f64::min)
}

/// Median of that time over the twists of a row.
fn median_ms(args: &Args, scenario: &Scenario) -> f64 {
    let options = options(&scenario.spec);
    let each: Vec<f64> = (0..TIMED.min(args.trials))
        .map(|trial| twist(args, scenario, trial))
        .map(|twist| fastest_ms(&twist.a, &twist.b, &options))
        .collect();
    robust::median(&each).unwrap_or(f64::NAN)
}

struct Accepted {
    error_s: f64,
    sigma_s: f64,
    /// Error of the skew over its sigma.
    skew_sigmas: f64,
}

fn reported(twist: &Twist, result: &Result<Estimate, Refusal>) -> String {
    let report = match result {
        Ok(estimate) => &estimate.report,
        Err(refusal) => &refusal.report,
    };
    let faults: Vec<String> = report
        .faults
        .iter()
        .map(|f| {
            let period = f.period.map_or(String::new(), |p| format!(" every {p}"));
            format!("{} {:?} {}{period}", f.stream, f.kind, f.count)
        })
        .collect();
    let outcome = match result {
        Ok(e) => {
            let error = e.clock.offset - twist.offset_at(e.clock.reference);
            format!(
                "{:+.2} ± {:.2} µs, skew {:+.2} ± {:.2} ppm",
                error * 1e6,
                e.offset_sigma_s() * 1e6,
                (e.clock.skew - twist.skew) * 1e6,
                e.skew_sigma() * 1e6
            )
        }
        Err(refusal) => refusal.to_string(),
    };
    format!("{outcome} [{}] {:?}", faults.join(", "), report.warnings)
}

fn print_row(name: &str, trials: &[Option<Accepted>], ms: f64) {
    let count = trials.len();
    let accepted: Vec<&Accepted> = trials.iter().flatten().collect();
    if accepted.is_empty() {
        println!("| {name} | 0 of {count} | – | – | – | – | – | – | {ms:.1} |");
        return;
    }
    let errors_s = || accepted.iter().map(|a| a.error_s);
    let over_sigma = || accepted.iter().map(|a| a.error_s / a.sigma_s);
    println!(
        "| {name} | {} of {count} | {:.3} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} | {ms:.1} |",
        accepted.len(),
        rms(errors_s()) * 1e6,
        largest(errors_s()) * 1e6,
        accepted.iter().map(|a| a.sigma_s).sum::<f64>() / accepted.len() as f64 * 1e6,
        rms(over_sigma()),
        largest(over_sigma()),
        rms(accepted.iter().map(|a| a.skew_sigmas)),
    );
}

fn largest(values: impl Iterator<Item = f64>) -> f64 {
    values.map(f64::abs).fold(0.0, f64::max)
}

/// Five twists of one pair of clocks over an hour, about a straight line.
fn hour(args: &Args, name: &str, spec: &TwistSpec) {
    let sessions: Vec<Option<f64>> = (0..args.trials)
        .into_par_iter()
        .map(|trial| {
            let skew = 20e-6 * (trial as f64 / args.trials as f64 - 0.5);
            let seed = args.seed + 1000 * trial;
            let path = ClockPath::new(seed, skew, 0.0, 3700.0, 1800.0);
            let clocks: Vec<ClockRelation> = (0..5_u32)
                .filter_map(|k| {
                    let at = 900.0 * f64::from(k);
                    let twist = twist_scenarios::twist_on(spec, seed + u64::from(k), &path, at);
                    estimate_offset(&twist.a, &twist.b, &Options::default()).ok()
                })
                .map(|estimate| estimate.clock)
                .collect();
            (clocks.len() == 5).then(|| about_a_line(&clocks))
        })
        .collect();
    let whole: Vec<f64> = sessions.iter().flatten().copied().collect();
    let ratio = (whole.iter().sum::<f64>() / (3 * whole.len().max(1)) as f64).sqrt();
    println!(
        "| {name} | {} of {} sessions | {ratio:.2} |",
        whole.len(),
        args.trials
    );
}

/// Chi-square of five offsets about their weighted straight line: 3 degrees of freedom.
fn about_a_line(clocks: &[ClockRelation]) -> f64 {
    let base = clocks[0];
    let (mut s, mut sx, mut sy, mut sxx, mut sxy) = (0.0, 0.0, 0.0, 0.0, 0.0);
    let points: Vec<(f64, f64, f64)> = clocks
        .iter()
        .map(|c| {
            (
                c.reference - base.reference,
                c.offset - base.offset,
                1.0 / c.covariance[0][0],
            )
        })
        .collect();
    for (x, y, w) in &points {
        s += w;
        sx += w * x;
        sy += w * y;
        sxx += w * x * x;
        sxy += w * x * y;
    }
    let slope = (s * sxy - sx * sy) / (s * sxx - sx * sx);
    let offset = (sy - slope * sx) / s;
    points
        .iter()
        .map(|(x, y, w)| w * (y - offset - slope * x).powi(2))
        .sum()
}

/// Writes the recordings, and a table of the ground truth, our results (all digits), the
/// settings and the time.
fn export(args: &Args, scenario: &Scenario, folder: &std::path::Path) {
    std::fs::create_dir_all(folder).unwrap();
    let options = options(&scenario.spec);
    let mut table =
        String::from("trial,reference_s,true_offset_s,offset_s,sigma_s,a_delay_s,b_delay_s,ms\n");
    for trial in 0..args.trials {
        let twist = twist(args, scenario, trial);
        std::fs::write(folder.join(format!("{trial}_a.csv")), csv(&twist.a)).unwrap();
        std::fs::write(folder.join(format!("{trial}_b.csv")), csv(&twist.b)).unwrap();
        // From the files, as the other program gets them.
        let read = |side: &str| {
            twist_scenarios::read_csv(&folder.join(format!("{trial}_{side}.csv"))).unwrap()
        };
        let (a, b) = (read("a"), read("b"));
        let result = estimate_offset(&a, &b, &options);
        let ms = fastest_ms(&a, &b, &options);
        let middle = twist.a.epoch_s + 0.5 * twist.a.t[twist.a.len() - 1];
        let (reference, ours, sigma) = result.map_or((middle, f64::NAN, f64::NAN), |e| {
            (e.clock.reference, e.clock.offset, e.offset_sigma_s())
        });
        let _ = writeln!(
            table,
            "{trial},{reference},{:.9},{ours},{sigma},{},{},{ms:.3}",
            twist.offset_at(reference),
            options.a_delay_s,
            options.b_delay_s
        );
    }
    std::fs::write(folder.join("ours.csv"), table).unwrap();
}
