//! `hil-sim frame-sync`: many launches on rigs of their own, judged by the truth.

use std::path::PathBuf;

use anyhow::{Result, bail};
use scenarios::frame_sync::{self, FrameSyncOptions};
use scenarios::study::{self, RangeOptions, Specimen, models};

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
    /// Instead, on the models alone: rigs as modelled, rigs drawn from what may be true,
    /// and rigs with one value at an end of its range. `--launches` is how many of the
    /// first two
    #[arg(long)]
    ranges: bool,
    /// With --ranges: rigs with each value at each end of its range
    #[arg(long, value_name = "RIGS", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=1_000))]
    rigs_an_end: u32,
    /// With --ranges: no drawn clock warms up by more, ppm in ten minutes; 5 by the ranges
    #[arg(long, value_name = "PPM", value_parser = warming)]
    most_warming: Option<f64>,
    /// With --ranges: the exposure of drawn rigs is the same in each recording, as with the
    /// app's exposure locked
    #[arg(long)]
    exposure_locked: bool,
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
    #[command(flatten)]
    sessions: super::Sessions,
}

/// ppm in ten minutes, within the range that is drawn from.
fn warming(text: &str) -> Result<f64, String> {
    let ppm = text.parse().ok().filter(|ppm| (0.1..=5.0).contains(ppm));
    ppm.ok_or_else(|| "expected 0.1 to 5 (ppm in ten minutes)".to_owned())
}

fn over_ranges(args: &Args) -> Result<()> {
    let options = RangeOptions {
        first_seed: args.first_seed,
        rigs: args.launches,
        rigs_an_end: args.rigs_an_end,
        most_warming_ppm: args.most_warming,
        exposure_locked: args.exposure_locked,
        jobs: args.jobs,
    };
    let sessions = |rig: &Specimen| Ok(models::sessions(rig.seed, &rig.values)?.figures());
    let study = study::run(&options, sessions, |rig| {
        if rig.figures.is_err() {
            println!("{rig}");
        }
    });
    println!("\n{}", study.table());
    super::write_json(args.json.as_deref(), &study)
}

pub(crate) fn run(args: &Args) -> Result<()> {
    if args.ranges {
        return over_ranges(args);
    }
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
