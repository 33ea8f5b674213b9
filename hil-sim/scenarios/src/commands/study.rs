//! `hil-sim study`: figures over what may be true of rigs.

use std::path::PathBuf;

use anyhow::Result;
use clap::Subcommand;
use scenarios::study::{self, RigResult, Rigs, Specimen, StudyOptions, models, tracking};
use scenarios::whole_chain::ranges;

/// Options of `study`.
#[derive(clap::Args)]
pub(crate) struct StudyArgs {
    #[command(subcommand)]
    what: What,
    #[command(flatten)]
    options: StudyOptions,
    /// Write the figures to this file, as JSON.
    #[arg(long, value_name = "FILE", global = true)]
    json: Option<PathBuf>,
    #[command(flatten)]
    sessions: super::Sessions,
}

#[derive(Subcommand)]
enum What {
    /// Twists, learning and alignment on the models alone, without board, link and app.
    Models {
        /// The exposure of drawn rigs is the same in each recording and each frame, as with the
        /// app's exposure locked
        #[arg(long)]
        exposure_locked: bool,
        /// Find of each worst rig the value without which it is best, which takes longer than the
        /// rest
        #[arg(long)]
        causes: bool,
    },
    /// The phase over an hour while the phone's clock is followed, or is not: clocks and links
    /// alone.
    Tracking {
        /// Length of a recording, seconds of board time.
        #[arg(long, default_value_t = 3_600, value_parser = clap::value_parser!(u32).range(60..=36_000))]
        seconds: u32,
    },
    /// From the twist to the data set on the whole simulated rig: what session and extraction
    /// state of themselves against the ground truth.
    Chain {
        /// Seconds of board time to record with each.
        #[arg(long, value_name = "SECONDS", default_value_t = 30)]
        seconds: u32,
        /// Folder for the recordings; each of the same name is replaced.
        #[arg(long, value_name = "DIR", default_value = "target/chain")]
        out: PathBuf,
        /// Keep the recordings.
        #[arg(long)]
        keep: bool,
    },
}

pub(crate) fn run(args: &StudyArgs) -> Result<()> {
    let options = &args.options;
    let show_failed = |rig: &RigResult| {
        if rig.figures.is_err() {
            println!("{rig}");
        }
    };
    let study = match &args.what {
        What::Models {
            exposure_locked,
            causes,
        } => {
            let rigs = Rigs::of_models(*exposure_locked);
            let rigs = if *causes { rigs } else { rigs.without_causes() };
            let sessions = |rig: &Specimen| Ok(models::sessions(rig.seed, &rig.values)?.figures());
            study::run(options, &rigs, sessions, show_failed)
        }
        What::Tracking { seconds } => {
            let sessions = |rig: &Specimen<_>| tracking::figures(rig.seed, rig.values, *seconds);
            study::run(options, &tracking::rigs(), sessions, show_failed)
        }
        What::Chain { seconds, out, keep } => {
            let programs = args.sessions.programs()?;
            let sessions = |rig: &Specimen| {
                let plan = ranges::plan(rig, *seconds);
                let figures = ranges::figures(&plan, &programs, out)?;
                if !keep {
                    // What is left over does no harm.
                    let _ = std::fs::remove_dir_all(out.join(&plan.name));
                }
                Ok(figures)
            };
            // Each is minutes.
            let rigs = Rigs::of_models(false).without_causes();
            study::run(options, &rigs, sessions, |rig| println!("{rig}"))
        }
    };
    println!("\n{}", study.table());
    super::write_json(args.json.as_deref(), &study)
}
