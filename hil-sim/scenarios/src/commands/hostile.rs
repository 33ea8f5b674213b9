//! `hil-sim hostile`: the hostile campaign.

use anyhow::Result;
use scenarios::hostile::campaign;

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
    let outcome = campaign(&program, &args.seeds.all(), &|seed, result| match result {
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
    let failed = outcome.failed.iter().map(|finding| finding.seed);
    args.seeds.fail_for("hostile", failed)
}
