//! `hil-sim long-run`: hours of trigger, IMU and strobe, every edge compared.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Result, bail};
use rig::random::Seed;
use scenarios::long_run::{Options, Report, run as run_long};

/// Options of `long-run`.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The firmware's ELF; without this, what `cargo xtask build` made.
    #[arg(long, value_name = "FILE")]
    elf: Option<PathBuf>,
    /// Virtual time to run, for example 6h or 3min.
    #[arg(long = "for", value_name = "DURATION", default_value = "6h",
          value_parser = rig::serve::duration)]
    length: Duration,
    /// Share of the time in which the link is filled up with as much as USB takes.
    #[arg(long, value_name = "PERCENT", default_value_t = 10,
          value_parser = clap::value_parser!(u64).range(0..=100))]
    full_link: u64,
    /// Leave the strobe input dark.
    #[arg(long)]
    no_strobe: bool,
    /// The one seed of all randomness.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print the figures as JSON.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    if args.length.as_secs() < 10 {
        bail!(
            "--for {:?} is too short to judge memory by: give 10s or more",
            args.length
        );
    }
    let options = Options {
        elf: args.elf.clone(),
        seed: Seed(args.seed),
        seconds: args.length.as_secs(),
        full_link_percent: args.full_link,
        strobe: !args.no_strobe,
    };
    let mut shown = 0;
    let report = run_long(&options, |progress| {
        shown += 1;
        if shown % 10 == 0 {
            eprintln!(
                "{:>9.0} s of virtual time: {} pulses and {} samples, all exact",
                progress.at.as_secs_f64(),
                progress.pulses,
                progress.samples
            );
        }
    })?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        print(&report);
    }
    Ok(())
}

fn print(r: &Report) {
    println!(
        "{:.2} virtual hours in {:.1} min ({:.1} x real time), seed {}, firmware {}",
        r.virtual_s / 3600.0,
        r.wall_s / 60.0,
        r.virtual_s / r.wall_s,
        r.seed,
        r.firmware
    );
    println!(
        "link: {} bytes, full for {} s; {} messages lost on all streams",
        r.link_bytes, r.full_link_s, r.lost
    );
    println!(
        "trigger: {} pulses at the pin, 0 ticks from the arithmetic; {} reported",
        r.pulses, r.pulses_reported
    );
    println!(
        "IMU: {} samples, 0 ticks from data-ready, values as in the registers",
        r.samples
    );
    println!(
        "strobe: {} edges, 0 ticks from the pin; {} status messages, {} of filler",
        r.captures, r.statuses, r.fillers
    );
    println!("the 32-bit counter wrapped {} times", r.wraps);
    for g in &r.growth {
        println!(
            "  {:<30} from {} to {} bytes, last {}",
            g.field, g.from_bytes, g.to_bytes, g.last
        );
    }
    println!(
        "stack of the board: {} of {} bytes ({} after the first tenth), {} free",
        r.stack_used,
        r.stack_size,
        r.stack_used_early,
        r.stack_size - r.stack_used
    );
    let mib: Vec<String> = r
        .resident
        .iter()
        .map(|&bytes| format!("{:.1}", bytes as f64 / f64::from(1 << 20)))
        .collect();
    println!(
        "host's resident memory after each tenth: {} MiB (growth {} bytes)",
        mib.join(", "),
        r.resident_growth()
    );
    println!(
        "worst load in a second {:.1} %; from an edge to the end of its handler {:.2} us at most",
        r.worst_load_percent, r.trigger_latency_us
    );
    println!(
        "{:<32} {:>10} {:>12} {:>10} {:>12}",
        "interrupt", "entries", "longest wait", "mean wait", "longest run"
    );
    for i in &r.interrupts {
        let wait = |us: Option<f64>| us.map_or_else(|| "-".to_owned(), |us| format!("{us:.2} us"));
        println!(
            "{:<32} {:>10} {:>12} {:>10} {:>9.2} us",
            i.name,
            i.entries,
            wait(i.longest_wait_us),
            wait(i.mean_wait_us),
            i.longest_run_us
        );
    }
    println!("All but wall time and memory is simulated.");
}
