//! The demo: a whole session on the simulated rig, judged by the truth
//! (`hil-sim demo`).

use std::path::{Path, PathBuf};

use anyhow::Result;

use crate::process;

/// Options of `cargo xtask demo`.
#[derive(Debug, Default, clap::Args)]
pub(crate) struct Args {
    /// Seed of all randomness: clocks, mounting, motion, noise.
    #[arg(long)]
    seed: Option<u64>,
    /// The rig: `published`, or `multi` with two phones, four cameras and a lidar.
    #[arg(long, value_name = "RIG")]
    rig: Option<String>,
    /// Seconds of board time to record.
    #[arg(long, value_name = "SECONDS")]
    seconds: Option<u32>,
    /// Run one session only, on an uncalibrated rig, without an earlier one to learn
    /// from.
    #[arg(long)]
    fresh: bool,
    /// Write the figures to this file, as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Folder for the recording, the phone's files and the report [default: demo
    /// in cargo's target folder]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

impl Args {
    /// With everything as it is by default, into a folder.
    pub(crate) fn into_folder(out: PathBuf) -> Self {
        Self {
            out: Some(out),
            ..Self::default()
        }
    }
}

/// Runs the demo with the programs that were just built.
pub(crate) fn run(args: &Args, elf: &Path) -> Result<()> {
    // The simulator runs at the root; the paths are those of whoever calls.
    let here = std::env::current_dir()?;
    let path = |path: &Path| here.join(path).display().to_string();
    let default_out = process::target_dir().join("demo");
    let out = args.out.as_deref().unwrap_or(&default_out);
    let options = [
        ("--seed", args.seed.map(|seed| seed.to_string())),
        ("--rig", args.rig.clone()),
        ("--seconds", args.seconds.map(|seconds| seconds.to_string())),
        ("--json", args.json.as_deref().map(path)),
        ("--out", Some(path(out))),
    ];
    let mut all = vec!["demo"];
    for (name, value) in &options {
        all.extend(value.iter().flat_map(|value| [name, value.as_str()]));
    }
    if args.fresh {
        all.push("--fresh");
    }
    process::run_hil_sim(&all, elf)
}
