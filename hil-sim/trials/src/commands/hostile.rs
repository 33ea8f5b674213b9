//! `hil-sim hostile`: the hostile campaign.

use anyhow::{Result, bail};
use trials::hostile::campaign;

/// Options of `hostile`.
#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    program: super::Program,
    #[command(flatten)]
    seeds: super::Seeds,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    let program = args.program.path()?;
    let seeds = args.seeds.all();
    let outcome = campaign(&program, &seeds, &|seed, result| match result {
        Ok(verdict) => eprintln!(
            "passed {seed}: {:?} -> exit code {}, {} MB, {:.1} s",
            verdict.command,
            verdict.exit_code,
            verdict.peak / 1_000_000,
            verdict.took.as_secs_f64()
        ),
        Err(finding) => eprintln!("FAILED {finding}"),
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
        let failing: Vec<String> = outcome.failed.iter().map(|f| f.seed.to_string()).collect();
        bail!(
            "{} of {} seeds failed: {}; `cargo xtask hostile --seed N --count 1` repeats one",
            outcome.failed.len(),
            seeds.len(),
            failing.join(", ")
        );
    }
    Ok(())
}
