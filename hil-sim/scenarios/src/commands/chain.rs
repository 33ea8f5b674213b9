//! `hil-sim chain`: extraction and evaluation checked on recordings of the whole
//! simulated rig.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use clap::Subcommand;
use scenarios::whole_chain::evaluation::EvaluationFigures;
use scenarios::whole_chain::{Plan, calibration, evaluation, extraction};
use serde::Serialize;
use stm32f4_sim::time::SimDuration;

/// Options of `chain`.
#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    what: What,
    /// The one seed of all randomness, or the first of several.
    #[arg(long, default_value_t = 1, global = true)]
    seed: u64,
    /// Folder for the recordings; each of the same name is replaced.
    #[arg(
        long,
        value_name = "DIR",
        default_value = "target/chain",
        global = true
    )]
    out: PathBuf,
    /// Write the figures to this file, as JSON.
    #[arg(long, value_name = "FILE", global = true)]
    json: Option<PathBuf>,
    #[command(flatten)]
    sessions: super::Sessions,
    /// Keep the recordings.
    #[arg(long, global = true)]
    keep: bool,
}

#[derive(Subcommand)]
enum What {
    /// Record hand-held motion with a camera that drops frames, extract, and compare every
    /// timestamp, pair and dropped frame with the ground truth.
    Extract {
        /// Seconds of board time to record.
        #[arg(long, value_name = "SECONDS", default_value_t = 600)]
        seconds: u32,
    },
    /// Record with many seeds, evaluate each video, and compare bias and drift with the ground truth.
    Evaluate {
        /// Seeds.
        #[arg(long, default_value_t = 50)]
        seeds: u64,
        /// Seconds of board time to record with each.
        #[arg(long, value_name = "SECONDS", default_value_t = 10)]
        seconds: u32,
    },
    /// Record with a constant hidden in the camera, calibrate, and record again.
    Calibrate {
        /// By how much the camera flashes later than the profile says, ms.
        #[arg(long, value_name = "MS", default_value_t = 4,
              value_parser = clap::value_parser!(u64).range(0..=10))]
        hidden_ms: u64,
    },
}

pub(crate) fn run(args: &Args) -> Result<()> {
    let programs = args.sessions.programs()?;
    match &args.what {
        What::Extract { seconds } => {
            let plan = Plan {
                drop_probability: 0.01,
                name: format!("extract_{}", args.seed),
                ..Plan::new(args.seed, *seconds)
            };
            let figures = extraction::check(&plan, &programs, &args.out)?;
            args.discard(&plan.name);
            args.finish(&figures, &figures.table(), figures.good())
        }
        What::Evaluate { seeds, seconds } => {
            let mut figures = EvaluationFigures::default();
            for seed in args.seed..args.seed + seeds {
                let plan = Plan::new(seed, *seconds);
                let found = evaluation::check(&plan, &programs, &args.out)
                    .with_context(|| format!("seed {seed}"))?;
                println!(
                    "seed {seed:>3}  bias {:+.3} ± {:.3} µs (true {:+.3})  drift {:+.3} ± {:.3} µs/min (true {:+.3})",
                    found.bias.value,
                    found.bias.sigma,
                    found.bias.truth,
                    found.drift.value,
                    found.drift.sigma,
                    found.drift.truth
                );
                args.discard(&plan.name);
                figures.seeds.push(found);
            }
            args.finish(&figures, &figures.table(), figures.good())
        }
        What::Calibrate { hidden_ms } => {
            let plan = Plan {
                name: format!("calibrate_{}", args.seed),
                ..Plan::new(args.seed, 10)
            };
            let hidden = SimDuration::from_millis(*hidden_ms);
            let figures = calibration::check(&plan, hidden, &programs, &args.out)?;
            if !args.keep {
                calibration::discard(&plan, &args.out);
            }
            args.finish(&figures, &figures.table(), figures.good())
        }
    }
}

impl Args {
    /// Removes a recording that nobody wants to keep.
    fn discard(&self, name: &str) {
        if !self.keep {
            // What is left over does no harm.
            let _ = std::fs::remove_dir_all(self.out.join(name));
        }
    }

    fn finish(&self, figures: &impl Serialize, table: &str, good: bool) -> Result<()> {
        print!("\n{table}");
        super::write_json(self.json.as_deref(), figures)?;
        if !good {
            bail!("outside the limits");
        }
        Ok(())
    }
}
