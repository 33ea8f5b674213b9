//! `hil-sim study`: figures over what may be true of rigs.

use std::path::PathBuf;

use anyhow::Result;
use clap::Subcommand;
use scenarios::study::launches::{self, LaunchesOptions};
use scenarios::study::{self, RigResult, Rigs, Specimen, StudyOptions, models, sessions, tracking};
use scenarios::whole_chain::ranges;

/// Options of `study`.
#[derive(clap::Args)]
pub(crate) struct StudyArgs {
    #[command(subcommand)]
    what: What,
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
        #[command(flatten)]
        options: StudyOptions,
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
        #[command(flatten)]
        options: StudyOptions,
        /// Length of a recording, seconds of board time.
        #[arg(long, default_value_t = 3_600, value_parser = clap::value_parser!(u32).range(60..=36_000))]
        seconds: u32,
    },
    /// From the twist to the data set on the whole simulated rig: what session and extraction
    /// state of themselves against the ground truth.
    Chain {
        #[command(flatten)]
        options: StudyOptions,
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
    /// Sessions through the firmware's binary, its link and the program, with exposure locked and
    /// one session learnt from: the phase at the start, over five minutes and over the recording.
    Sessions {
        #[command(flatten)]
        options: StudyOptions,
        /// Seconds of each recording.
        #[arg(long, value_name = "SECONDS", default_value_t = 300,
              value_parser = clap::value_parser!(u32).range(10..=3_600))]
        seconds: u32,
        /// Folder for the recordings; each of the same name is replaced.
        #[arg(long, value_name = "DIR", default_value = "target/sessions")]
        out: PathBuf,
    },
    /// One rig launched again and again, measured from its strobes as the published rig was:
    /// spread of the phase between launches, and drift over five minutes.
    Launches {
        #[command(flatten)]
        options: LaunchesOptions,
    },
}

pub(crate) fn run(args: &StudyArgs) -> Result<()> {
    let show_failed = |rig: &RigResult| {
        if rig.figures.is_err() {
            println!("{rig}");
        }
    };
    let study = match &args.what {
        What::Models {
            options,
            exposure_locked,
            causes,
        } => {
            let rigs = Rigs::of_models(*exposure_locked);
            let rigs = if *causes { rigs } else { rigs.without_causes() };
            let sessions = |rig: &Specimen| Ok(models::sessions(rig.seed, &rig.values)?.figures());
            study::run(options, &rigs, sessions, show_failed)
        }
        What::Tracking { options, seconds } => {
            let sessions = |rig: &Specimen<_>| tracking::figures(rig.seed, rig.values, *seconds);
            study::run(options, &tracking::rigs(), sessions, show_failed)
        }
        What::Launches { options } => {
            let study = launches::run(options, &args.sessions.programs()?)?;
            println!("{study}");
            return super::write_json(args.json.as_deref(), &study);
        }
        What::Sessions {
            options,
            seconds,
            out,
        } => {
            let programs = args.sessions.programs()?;
            let figures = |rig: &Specimen| sessions::figures(rig, *seconds, &programs, out);
            let rigs = Rigs::of_models(true).without_causes();
            study::run(options, &rigs, figures, |rig| println!("{rig}"))
        }
        What::Chain {
            options,
            seconds,
            out,
            keep,
        } => {
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
