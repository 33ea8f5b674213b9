//! `hil-sim demo`: a whole session on the simulated rig, judged by the ground truth.

use std::path::PathBuf;

use anyhow::Result;
use scenarios::demo::{self, DemoOptions};
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
pub(crate) struct DemoArgs {
    #[command(flatten)]
    options: DemoOptions,
    /// The published rig, or one of two phones, four cameras and a lidar.
    #[arg(long, value_enum, default_value_t = RigKind::Published)]
    rig: RigKind,
    /// Write the figures to this file, as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    #[command(flatten)]
    sessions: super::Sessions,
}

pub(crate) fn run(args: &DemoArgs) -> Result<()> {
    if args.rig == RigKind::Multi {
        return run_several(args);
    }
    let done = demo::run(&args.options, &args.sessions.programs()?)?;
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

fn write_json(args: &DemoArgs, figures: &impl serde::Serialize) -> Result<()> {
    super::write_json(args.json.as_deref(), figures)?;
    if let Some(path) = &args.json {
        println!("figures    {}", path.display());
    }
    Ok(())
}

/// Two phones, other cameras and a lidar: each extracted and judged.
fn run_several(args: &DemoArgs) -> Result<()> {
    let programs = args.sessions.programs()?;
    let plan = SeveralPlan {
        seed: args.options.seed,
        seconds: args.options.seconds,
        small: false,
    };
    let out = args.options.out.join("multi");
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
