//! `smartdepthsync board trigger`: the trigger outputs by hand.

use clap::Subcommand;
use protocol::{
    AlignTrigger, Output, Period, QueryTrigger, Readback, SetPeriod, StartTrigger, StopTrigger,
    TICK_HZ, Ticks, TrainState, TriggerAlign, TriggerStart, TriggerStatus,
};
use serde::Serialize;

use crate::context::Context;
use crate::decimal::{parse_fps, parse_period, parse_ticks};
use crate::options::PortArg;
use crate::outcome::{ExitStatus, Failure};

/// Options of `board trigger`.
#[derive(Debug, clap::Args)]
pub(crate) struct TriggerArgs {
    /// Trigger output: 1 is the camera's (PA5); 2, 3 and 4 are PE11, PE13 and PE14
    #[arg(long, value_name = "N", default_value_t = 1, global = true,
          value_parser = clap::value_parser!(u8).range(1..=4))]
    output: u8,
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Start the pulse train
    #[command(after_help = "Example: smartdepthsync board trigger start --fps 30")]
    Start {
        #[command(flatten)]
        period: PeriodArg,
        /// Length of a pulse: 12us for the camera, which needs more than 8us; 100us for
        /// outputs 2 to 4
        #[arg(long, value_name = "TIME", value_parser = parse_ticks)]
        width: Option<u32>,
        /// Board time of the first rising edge, in ticks of 48 MHz [default: at once]
        #[arg(long, value_name = "TICK")]
        first_edge: Option<u64>,
    },
    /// Move the running train so that an edge falls exactly on a tick; `board trigger status` shows
    /// when it has arrived
    #[command(after_help = "Example: smartdepthsync board trigger align --anchor 4416000000")]
    Align {
        /// Tick of 48 MHz on which an edge must fall, at most an hour away
        #[arg(long, value_name = "TICK")]
        anchor: u64,
        #[command(flatten)]
        period: PeriodArg,
        /// Largest move per frame; 0s jumps at once
        #[arg(long, value_name = "TIME", default_value = "100us", value_parser = parse_ticks)]
        slew: u32,
    },
    /// Change the period from the next edge on
    #[command(after_help = "Example: smartdepthsync board trigger period --period 33330.652us")]
    Period {
        #[command(flatten)]
        period: PeriodArg,
    },
    /// Stop the train
    #[command(after_help = "Example: smartdepthsync board trigger stop")]
    Stop,
    /// Show the state of the train
    #[command(after_help = "Example: smartdepthsync board trigger status --output 2")]
    Status,
}

/// A period in human units.
#[derive(Clone, Copy, Debug, clap::Args)]
#[group(multiple = false)]
struct PeriodArg {
    /// Frames per second, such as 30 or 29.97, exact; 30 when a train starts
    #[arg(long, value_name = "FPS", value_parser = parse_fps)]
    fps: Option<Period>,
    /// Period, such as 33330.652us; exact to 2⁻³² ticks
    #[arg(long, value_name = "TIME", value_parser = parse_period)]
    period: Option<Period>,
}

impl PeriodArg {
    fn given(self) -> Option<Period> {
        self.fps.or(self.period)
    }
}

/// Runs `trigger`.
///
/// # Errors
///
/// The board cannot be reached or refuses.
pub(crate) fn run(
    args: &TriggerArgs,
    port: &PortArg,
    context: &Context,
) -> Result<ExitStatus, Failure> {
    // Wrong options are reported before the port is opened.
    if let Action::Period { period } = &args.action
        && period.given().is_none()
    {
        return Err(Failure::new(
            ExitStatus::Usage,
            "board trigger period needs --fps or --period",
        )
        .next_step("give one of them, for example `board trigger period --fps 30`"));
    }
    // The command line takes 1 to 4.
    let output = Output::from_number(args.output).unwrap_or(Output::Camera);
    let mut board = port.open()?;
    let status = match args.action {
        Action::Start {
            period,
            width,
            first_edge,
        } => {
            let default_us = if output.is_camera() { 12 } else { 100 };
            let start = TriggerStart {
                period: period.given().unwrap_or(Period::from_ticks(TICK_HZ / 30)),
                width: width.unwrap_or(default_us * (TICK_HZ / 1_000_000)),
                first_edge: first_edge.map(|edge| Ticks(edge).into()),
            };
            board.call(StartTrigger { output, start })?
        }
        Action::Align {
            anchor,
            period,
            slew,
        } => {
            let period = match period.given() {
                Some(period) => period,
                None => board.call(QueryTrigger(output))?.period,
            };
            let to = TriggerAlign {
                anchor: Ticks(anchor),
                period,
                slew,
            };
            context.show(&board.call(AlignTrigger { output, to })?)?;
            return Ok(ExitStatus::Good);
        }
        Action::Period { period } => match period.given() {
            Some(period) => board.call(SetPeriod { output, period })?,
            None => board.call(QueryTrigger(output))?,
        },
        Action::Stop => board.call(StopTrigger(output))?,
        Action::Status => board.call(QueryTrigger(output))?,
    };
    context.show(&Train::new(output, &status))?;
    let lossy = status.late > 0 || status.readback.missing > 0;
    Ok(ExitStatus::of_loss(lossy))
}

/// State of a train.
#[derive(Debug, Serialize)]
struct Train {
    state: TrainState,
    train: u32,
    period_ns: String,
    period_ticks: u32,
    period_fraction: u32,
    fps: f64,
    width_us: f64,
    pulses: u64,
    next_edge_ticks: u64,
    next_edge_fraction: u32,
    late: u32,
    readback_state: String,
    readback: Readback,
}

impl Train {
    fn new(output: Output, status: &TriggerStatus) -> Self {
        let (period, readback) = (status.period, status.readback);
        let seconds = period.as_secs_f64();
        Self {
            state: status.state,
            train: status.train,
            period_ns: period.to_string().trim_end_matches(" ns").to_owned(),
            period_ticks: period.ticks(),
            period_fraction: period.fraction(),
            fps: if seconds > 0.0 { 1.0 / seconds } else { 0.0 },
            width_us: f64::from(status.width) * 1e6 / f64::from(TICK_HZ),
            pulses: status.pulses,
            next_edge_ticks: status.next_edge.ticks.0,
            next_edge_fraction: status.next_edge.fraction,
            late: status.late,
            readback_state: match (readback.seen, readback.missing, readback.stray) {
                _ if !output.is_camera() => String::from("none on this output"),
                (0, 0, 0) => String::from("not wired"),
                (_, 0, 0) => String::from("ok"),
                (_, 0, stray) => format!("stray {stray}"),
                (_, missing, _) => format!("missing {missing}"),
            },
            readback,
        }
    }
}
