//! `hil-sim faults`: the fault campaign.

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::{Context, Result};
use scenarios::campaign::plan::Fault;
use scenarios::campaign::{Finding, Verdict, campaign, folders};

/// Options of `faults`.
#[derive(clap::Args)]
pub(crate) struct FaultsArgs {
    /// The firmware's ELF; without this, what `cargo xtask build` made.
    #[arg(long, value_name = "FILE")]
    elf: Option<PathBuf>,
    #[command(flatten)]
    seeds: super::Seeds,
    /// Keep the recordings in this folder.
    #[arg(long, value_name = "FOLDER")]
    keep: Option<PathBuf>,
    /// Print the verdicts as JSON.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &FaultsArgs) -> Result<()> {
    let temporary = tempfile::tempdir().context("no temporary folder")?;
    let seeds = args.seeds.all();
    let folder = args.keep.as_deref().unwrap_or(temporary.path());
    let results = campaign(&seeds, args.elf.as_deref(), folder, &|seed, result| {
        match result {
            Ok(verdict) => eprintln!(
                "passed {} -> {:?}, {:?}",
                verdict.plan, verdict.outcome, verdict.problems
            ),
            Err(finding) => eprintln!("FAILED {finding}"),
        }
        if args.keep.is_none() {
            for place in folders(seed, folder) {
                // At the end it goes with the whole folder anyway.
                let _ = std::fs::remove_dir_all(place);
            }
        }
    });
    let (passed, failed): (Vec<_>, Vec<_>) = results.into_iter().partition(Result::is_ok);
    let passed: Vec<Verdict> = passed.into_iter().flatten().collect();
    let failed: Vec<Finding> = failed.into_iter().filter_map(Result::err).collect();
    if args.json {
        println!("{}", serde_json::to_string_pretty(&passed)?);
    } else {
        table(&passed, &failed);
    }
    let failed = failed.iter().map(|finding| finding.plan.seed);
    args.seeds.fail_for("faults", failed)
}

fn table(passed: &[Verdict], failed: &[Finding]) {
    println!(
        "{:<22} {:>6} {:>9} {:>6} {:>12} {:>12} {:>10}",
        "fault", "tried", "survived", "alone", "pulses lost", "samples lost", "reconnects"
    );
    for fault in Fault::ALL {
        let with: Vec<&Verdict> = passed.iter().filter(|v| v.plan.has(fault)).collect();
        let not = failed.iter().filter(|f| f.plan.has(fault)).count();
        // What it costs by itself: from the runs in which nothing else happened.
        let alone: Vec<&&Verdict> = with.iter().filter(|v| v.plan.events.len() == 1).collect();
        let most = |pick: fn(&Verdict) -> u64| alone.iter().map(|v| pick(v)).max();
        let cell = |value: Option<u64>| value.map_or_else(|| "-".to_owned(), |v| v.to_string());
        println!(
            "{:<22} {:>6} {:>9} {:>6} {:>12} {:>12} {:>10}",
            format!("{fault:?}"),
            with.len() + not,
            with.len(),
            alone.len(),
            cell(most(|v| v.pulses_lost)),
            cell(most(|v| v.samples_lost)),
            cell(most(|v| v.reconnects.into())),
        );
    }
    let sum = |pick: fn(&Verdict) -> u64| passed.iter().map(pick).sum::<u64>();
    let mut outcomes: BTreeMap<String, u32> = BTreeMap::new();
    for verdict in passed {
        *outcomes
            .entry(format!("{:?}", verdict.outcome))
            .or_default() += 1;
    }
    println!(
        "{} runs passed, {} failed; {:.0} virtual s; outcomes {outcomes:?}",
        passed.len(),
        failed.len(),
        passed.iter().map(|v| v.virtual_s).sum::<f64>()
    );
    println!(
        "{} pulses at the pin, 0 ticks from the grid, whose period changed {} times; {} messages \
         about edges and samples, all right; {} samples hit in their transfer; {} damaged \
         frames, all counted",
        sum(|v| v.pulses),
        sum(|v| v.period_changes),
        sum(|v| v.delivered),
        sum(|v| v.disturbed),
        sum(|v| v.damaged_frames.into())
    );
    println!("Simulated. The columns of losses are the most in runs with that fault alone.");
}
