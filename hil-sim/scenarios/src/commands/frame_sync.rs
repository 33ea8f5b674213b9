//! `hil-sim frame-sync`: many launches on rigs of their own, judged by the truth.

use std::path::PathBuf;

use anyhow::{Result, bail};
use scenarios::frame_sync::{self, FrameSyncOptions};

/// Options of `frame-sync`.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Number of rigs; each does one session with nothing learnt and one after it.
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(2..=10_000))]
    launches: u32,
    /// Length of each recording, seconds of board time; at least a minute, or
    /// there is nothing to learn from.
    #[arg(long, default_value_t = 300, value_parser = clap::value_parser!(u32).range(60..=3600))]
    seconds: u32,
    /// The first rig's seed; the others follow it.
    #[arg(long, default_value_t = 1)]
    first_seed: u64,
    /// Number of rigs that run at the same time.
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=64))]
    jobs: u32,
    /// Write all launches to this file, as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Folder of the recordings.
    #[arg(long, value_name = "DIR", default_value = "target/frame-sync")]
    out: PathBuf,
    /// Keep the recordings (20 MB for ten minutes).
    #[arg(long)]
    keep: bool,
    #[command(flatten)]
    sessions: super::Sessions,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    let options = FrameSyncOptions {
        first_seed: args.first_seed,
        launches: args.launches,
        seconds: args.seconds,
        jobs: args.jobs,
        out: args.out.clone(),
        programs: args.sessions.programs()?,
        keep: args.keep,
    };
    let result = frame_sync::run(&options, |fresh, learnt| {
        println!(
            "seed {:>4}: fresh {:+8.2} µs {:+8.2} µs/min, learnt {:+8.2} µs {:+8.2} µs/min",
            fresh.seed,
            fresh.phase_error_us,
            fresh.drift_us_per_min,
            learnt.phase_error_us,
            learnt.drift_us_per_min
        );
    });
    println!("\n{}", result.table());
    super::write_json(args.json.as_deref(), &result)?;
    if !result.failed.is_empty() {
        bail!(
            "{} of {} rigs failed; the figures are those of the others",
            result.failed.len(),
            args.launches
        );
    }
    Ok(())
}
