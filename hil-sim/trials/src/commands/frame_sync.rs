//! `hil-sim frame-sync`: many launches on rigs of their own, judged by the truth.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use trials::demo::frame_sync::{self, FrameSyncOptions};

/// Options of `frame-sync`.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// How many rigs; each does one session with nothing learnt and one after it.
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(2..=10_000))]
    launches: u32,
    /// Length of each recording, seconds of board time; at least a minute, or
    /// there is nothing to learn from.
    #[arg(long, default_value_t = 300, value_parser = clap::value_parser!(u32).range(60..=3600))]
    seconds: u32,
    /// The first rig's seed; the others follow it.
    #[arg(long, default_value_t = 1)]
    first_seed: u64,
    /// How many rigs run at the same time.
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
    /// The firmware's ELF; without this, what `cargo xtask build` made.
    #[arg(long, value_name = "FILE")]
    elf: Option<PathBuf>,
    /// The program of the sessions; the `smartdepthsync` beside this one by default.
    #[arg(long, value_name = "FILE")]
    program: Option<PathBuf>,
    /// Virtual time passes at most so many times as fast as real time.
    #[arg(long, default_value_t = 30.0, value_parser = super::speed)]
    speed: f64,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    let options = FrameSyncOptions {
        first_seed: args.first_seed,
        launches: args.launches,
        seconds: args.seconds,
        jobs: args.jobs,
        out: args.out.clone(),
        elf: args.elf.clone(),
        program: super::session_program(args.program.as_deref())?,
        speed: args.speed,
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
    if let Some(path) = &args.json {
        let json = serde_json::to_string_pretty(&result)?;
        std::fs::write(path, json + "\n")
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    if !result.failed.is_empty() {
        bail!(
            "{} of {} rigs failed; the figures are those of the others",
            result.failed.len(),
            args.launches
        );
    }
    Ok(())
}
