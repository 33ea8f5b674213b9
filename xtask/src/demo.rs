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
    let mut all = vec!["demo".to_owned()];
    let mut option = |name: &str, value: Option<String>| {
        if let Some(value) = value {
            all.extend([name.to_owned(), value]);
        }
    };
    let path = |path: &Path| here.join(path).display().to_string();
    option("--seed", args.seed.map(|seed| seed.to_string()));
    option("--rig", args.rig.clone());
    option("--seconds", args.seconds.map(|seconds| seconds.to_string()));
    option("--json", args.json.as_deref().map(path));
    let out = args
        .out
        .clone()
        .unwrap_or_else(|| process::target_dir().join("demo"));
    option("--out", Some(path(&out)));
    if args.fresh {
        all.push("--fresh".to_owned());
    }
    process::run_hil_sim(&all, elf)
}
