//! `hil-sim phone-faults`: faults in the phone alone.

use anyhow::{Result, bail};
use scenarios::phone_faults::campaign;

/// Options of `phone-faults`.
#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    seeds: super::Seeds,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    let runs = campaign(&args.seeds.all(), &|run| {
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
