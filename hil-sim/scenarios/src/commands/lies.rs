//! `hil-sim lies`: sessions with a board or a phone that lies.

use std::collections::BTreeMap;

use anyhow::{Context as _, Result};
use scenarios::lies::campaign;

/// Options of `lies`.
#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    campaign: super::Campaign,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    let folder = tempfile::tempdir().context("no temporary folder")?;
    let programs = args.campaign.programs()?;
    let seeds = args.campaign.seeds.all();
    let results = campaign(&seeds, &programs, folder.path(), &|result| match result {
        Ok(verdict) => eprintln!(
            "passed {}: {} -> {} lies told, exit code {}, {} frames",
            verdict.seed, verdict.lies, verdict.told, verdict.exit_code, verdict.frames
        ),
        Err(finding) => eprintln!("FAILED {finding}"),
    });
    let (mut told, mut frames) = (0, 0);
    let mut codes: BTreeMap<i32, u32> = BTreeMap::new();
    for verdict in results.iter().flatten() {
        told += verdict.told;
        frames += verdict.frames;
        *codes.entry(verdict.exit_code).or_default() += 1;
    }
    let findings = || results.iter().filter_map(|result| result.as_ref().err());
    let failed = findings().count();
    println!(
        "{} sessions passed, {} failed: {told} messages and answers changed, {frames} frames compared; \
         exit codes {codes:?}",
        results.len() - failed,
        failed
    );
    let failed = findings().map(|finding| finding.seed);
    args.campaign.seeds.fail_for("lies", failed)
}
