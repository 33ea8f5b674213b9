//! `smartdepthsync board test`: does this board do in hardware what the simulated one
//! does? What is measured and what must hold is in the crate `bring_up`.

use std::path::PathBuf;
use std::time::Duration;

use bring_up::{Operator, Part, Plan};
use clap::ValueEnum;
use recording::finding::Severity;

use crate::context::Context;
use crate::decimal::parse_real_time;
use crate::options::PortArg;
use crate::outcome::{ExitStatus, Failure, write_file};

/// Measure a board: edges, captures, IMU, USB, crystal; pass or fail with reasons.
///
/// Wire PA5 to PA3 and to PA2, and the IMU; nothing else. When asked to, move the wire
/// at PA2 to PE11, and unplug SDA. Takes two minutes.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: smartdepthsync board test --hands-off")]
pub(crate) struct Args {
    /// Measure only this; may be given several times
    #[arg(long = "part", value_name = "PART", value_enum)]
    parts: Vec<PartArg>,
    /// Leave out what needs somebody at the board
    #[arg(long)]
    hands_off: bool,
    /// How long the crystal is compared with this computer's clock: 60s, 5m
    #[arg(long, value_name = "TIME", default_value = "60s", value_parser = parse_real_time)]
    clock_time: Duration,
    /// Keep what was measured in the board: the delay of its inputs, the start delay of its
    /// outputs, its crystal against this computer's clock
    #[arg(long)]
    keep: bool,
    /// Folder for board-test.json and board-test.html
    #[arg(short, long, value_name = "FOLDER", default_value = "board-test")]
    out: PathBuf,
}

/// A part on the command line.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum PartArg {
    /// Edges, widths and aligns of the trigger
    Trigger,
    /// Output 2 beside the trigger
    Outputs,
    /// Data-ready and recovery of the IMU
    Imu,
    /// Throughput of USB, losses, handlers
    Link,
    /// The crystal beside the computer's clock
    Clock,
}

impl From<PartArg> for Part {
    fn from(part: PartArg) -> Self {
        match part {
            PartArg::Trigger => Self::Trigger,
            PartArg::Outputs => Self::Outputs,
            PartArg::Imu => Self::Imu,
            PartArg::Link => Self::Link,
            PartArg::Clock => Self::Clock,
        }
    }
}

/// Runs the command.
///
/// # Errors
///
/// The board cannot be reached, is in use or is reset meanwhile; the report cannot be
/// written.
pub(crate) fn run(args: &Args, port: &PortArg, context: &Context) -> Result<ExitStatus, Failure> {
    let parts: Vec<Part> = match args.parts.as_slice() {
        [] => Part::ALL.to_vec(),
        some => some.iter().copied().map(Part::from).collect(),
    };
    let mut board = port.open()?;
    std::fs::create_dir_all(&args.out).map_err(|error| Failure::file("make", &args.out, &error))?;
    let operator = Operator {
        say: &|prompt| context.say(prompt.to_string()),
        is_there: !args.hands_off,
        stop: &context.interrupt.question(),
    };
    let plan = Plan {
        parts: &parts,
        clock: args.clock_time,
        keep: args.keep,
    };
    let report = bring_up::run(&mut board, operator, plan)?;
    let json = serde_json::to_string_pretty(&report)?;
    let page = args.out.join("board-test.html");
    write_file(&args.out.join("board-test.json"), &json)?;
    write_file(&page, &report::board_test::page(&report))?;
    context.print_checks(&report, || {
        let text = report::board_test::summary(&report).text();
        format!("{text}report {}", page.display())
    })?;
    Ok(match report.count(Severity::Bad) {
        0 => ExitStatus::Good,
        _ => ExitStatus::Refused,
    })
}
