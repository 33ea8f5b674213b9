//! `hil-sim demo`: a whole session on the simulated rig, judged by the ground truth.

use std::path::PathBuf;

use anyhow::Result;
use scenarios::demo::{self, DEFAULT_SECONDS, DemoOptions, SECONDS};
use scenarios::whole_chain::several::{self, SeveralPlan};

/// The rig that is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum RigKind {
    /// A phone and a depth camera.
    Published,
    /// Two phones, a depth camera, three more cameras and a lidar.
    Multi,
}

/// Options of `demo`.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The one seed of all randomness: clocks, mounting, motion, noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// The published rig, or one of two phones, four cameras and a lidar.
    #[arg(long, value_enum, default_value_t = RigKind::Published)]
    rig: RigKind,
    /// Seconds of board time to record.
    #[arg(long, value_name = "SECONDS", default_value_t = DEFAULT_SECONDS,
          value_parser = clap::value_parser!(u32).range(i64::from(*SECONDS.start())..=i64::from(*SECONDS.end())))]
    seconds: u32,
    /// Write the figures to this file, as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Show a session on an uncalibrated rig, without one before it that
    /// teaches.
    #[arg(long)]
    fresh: bool,
    /// Folder for the recording, the phone's files and the report.
    #[arg(long, value_name = "DIR", default_value = "target/demo")]
    out: PathBuf,
    #[command(flatten)]
    sessions: super::Sessions,
    /// The phone does not hang on a cable: its clock is not followed.
    #[arg(long)]
    without_cable: bool,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    if args.rig == RigKind::Multi {
        return run_several(args);
    }
    let done = demo::run(&DemoOptions {
        seed: args.seed,
        out: args.out.clone(),
        programs: args.sessions.programs()?,
        has_cable: !args.without_cable,
        seconds: args.seconds,
        fresh: args.fresh,
    })?;
    println!("\n{}", done.figures.table());
    println!("{}", done.data.figures.table());
    println!("recording  {}", done.recording.display());
    println!("data set   {}", done.data.folder.display());
    println!("report     {}", done.report.display());
    write_json(args, &done.figures)?;
    if !done.data.figures.good() {
        anyhow::bail!("a time in the data set is outside its limit");
    }
    Ok(())
}

fn write_json(args: &Args, figures: &impl serde::Serialize) -> Result<()> {
    super::write_json(args.json.as_deref(), figures)?;
    if let Some(path) = &args.json {
        println!("figures    {}", path.display());
    }
    Ok(())
}

/// Two phones, other cameras and a lidar: each extracted and judged.
fn run_several(args: &Args) -> Result<()> {
    let programs = args.sessions.programs()?;
    let plan = SeveralPlan {
        seed: args.seed,
        seconds: args.seconds,
        small: false,
    };
    let out = args.out.join("multi");
    let figures = several::run(&plan, &programs, &out, |step| println!("{step} ..."))?;
    println!("\n{}", figures.table());
    let (recording, data) = (&figures.recording, &figures.data);
    println!("recording  {}", recording.display());
    println!("  report   {}", recording.join("report.html").display());
    println!("data set   {}", data.display());
    println!("  report   {}", data.join("report.html").display());
    write_json(args, &figures)?;
    if !figures.good() {
        anyhow::bail!("a figure is outside its limit");
    }
    Ok(())
}
