//! `hil-sim phone-faults`: faults in the phone alone.

use anyhow::{Result, bail};
use trials::phone_faults::campaign;

/// Options of `phone-faults`.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The first seed.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// How many seeds.
    #[arg(long, default_value_t = 500)]
    count: u64,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    let seeds: Vec<u64> = (args.seed..args.seed.saturating_add(args.count)).collect();
    let runs = campaign(&seeds, &|run| {
        let verdict = if run.left_running { "FAILED" } else { "passed" };
        eprintln!("{verdict} {}: {}", run.seed, run.story);
    })?;
    let began = runs.iter().filter(|run| run.began).count();
    let failed = runs.iter().filter(|run| run.left_running).count();
    println!(
        "{} runs: {began} began a video, {failed} left one running",
        runs.len()
    );
    if failed > 0 {
        bail!("{failed} runs left a video running");
    }
    Ok(())
}
