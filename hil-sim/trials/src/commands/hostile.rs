//! `hil-sim hostile`: the hostile campaign.

use std::path::PathBuf;

use anyhow::{Result, bail};
use trials::hostile::campaign;

/// Options of `hostile`.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The program; the `smartdepthsync` beside this one by default.
    #[arg(long, value_name = "FILE")]
    program: Option<PathBuf>,
    /// The first seed.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// How many seeds.
    #[arg(long, default_value_t = 200)]
    count: u64,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    let program = super::session_program(args.program.as_deref())?;
    let outcome = campaign(&program, args.seed, args.count, &|_, result| {
        if let Err(finding) = result {
            eprintln!("FAILED {finding}");
        }
    })?;
    println!(
        "{:<10} {:>6} {:>9} {:>9}  exit codes",
        "command", "runs", "MB most", "s longest"
    );
    for (command, (runs, codes, peak, took)) in outcome.by_command() {
        let codes: Vec<String> = codes
            .iter()
            .map(|(code, n)| format!("{code}: {n}"))
            .collect();
        println!(
            "{:<10} {runs:>6} {:>9} {:>9.1}  {}",
            format!("{command:?}"),
            peak / 1_000_000,
            took.as_secs_f64(),
            codes.join(", ")
        );
    }
    println!(
        "{} runs passed, {} failed",
        outcome.passed.len(),
        outcome.failed.len()
    );
    if !outcome.failed.is_empty() {
        let seeds: Vec<String> = outcome.failed.iter().map(|f| f.seed.to_string()).collect();
        bail!(
            "{} of {} seeds failed: {}; `cargo xtask hostile --seed N --count 1` repeats one",
            outcome.failed.len(),
            args.count,
            seeds.join(", ")
        );
    }
    Ok(())
}
