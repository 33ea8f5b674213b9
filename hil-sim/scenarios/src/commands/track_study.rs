//! `hil-sim track-study`: clocks that warm up for an hour, followed or not.

use anyhow::Result;
use scenarios::tracking::{Part, Place, StudyOptions, over_ranges, study};

/// Options of `track-study`.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// How many rigs.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    rigs: u32,
    /// The first rig's seed; the others follow it.
    #[arg(long, default_value_t = 1)]
    first_seed: u64,
    /// Length of a recording, seconds of board time.
    #[arg(long, default_value_t = 3_600, value_parser = clap::value_parser!(u32).range(60..=36_000))]
    seconds: u32,
    /// How many rigs run at the same time.
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=64))]
    jobs: u32,
    /// Leave this out of the simulated world; may be given several times.
    #[arg(long, value_enum)]
    without: Vec<Part>,
    /// Three values of the phase: links and warming in the middle of their
    /// ranges, drawn, and one of them at an end.
    #[arg(long)]
    ranges: bool,
    /// Rigs with each value at each end of its range.
    #[arg(long, default_value_t = 4, requires = "ranges")]
    rigs_an_end: u32,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    let options = StudyOptions {
        first_seed: args.first_seed,
        rigs: args.rigs,
        seconds: args.seconds,
        jobs: args.jobs,
        without: args.without.clone(),
        place: Place::Drawn,
    };
    if args.ranges {
        println!("{}", over_ranges(&options, args.rigs_an_end).table());
        return Ok(());
    }
    println!("{}", study(&options)?.table());
    Ok(())
}
