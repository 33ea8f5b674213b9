//! `smartdepthsync trigger`: the trigger outputs by hand.

use std::fmt::Write as _;
use std::time::Duration;

use clap::Subcommand;
use protocol::{
    AlignPlan, Arrived, DeviceToHost, Output, OutputAction, OutputAlign, Period, Readback, TICK_HZ,
    Ticks, TrainState, TriggerAlign, TriggerStart, TriggerStatus,
};
use serde::Serialize;

use super::PortArg;
use crate::cli::Context;
use crate::decimal::{parse_fps, parse_period_us, parse_us_ticks};
use crate::outcome::{ExitStatus, Failure, Outcome};
use board::Event;
use board::{Board, BoardError, Result as BoardResult};
use evaluate::latency::{Latency, latency};
use evaluate::train::TrainGeometry;

/// How long the link may bring no pulse while the latency is measured.
const PULSE_PATIENCE: Duration = Duration::from_secs(20);

/// Options of `trigger`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    port: PortArg,
    /// Which trigger output: 1 is the camera's (PA5); 2, 3, 4 are PE11, PE13, PE14
    #[arg(long, value_name = "N", default_value_t = 1, global = true,
          value_parser = clap::value_parser!(u8).range(1..=4))]
    output: u8,
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Start the train of pulses; 30 fps unless told otherwise
    Start {
        #[command(flatten)]
        period: PeriodArg,
        /// Length of a pulse in µs (the camera needs more than 8) [default: 12; outputs 2
        /// to 4: 100]
        #[arg(long, value_name = "US", value_parser = parse_us_ticks)]
        width_us: Option<u32>,
        /// Board time of the first rising edge, in ticks of 48 MHz [default: at once]
        #[arg(long, value_name = "TICK")]
        first_edge: Option<u64>,
        /// Fraction of the tick of the first edge, in 1/2^32 (outputs 2 to 4); as
        /// `next_edge_fraction` of `trigger status --json` tells it
        #[arg(long, value_name = "N", requires = "first_edge", default_value_t = 0)]
        first_fraction: u32,
    },
    /// Move the running train so that an edge falls exactly on a tick
    Align {
        /// A tick of 48 MHz that the train shall pass through; at most an hour away
        #[arg(long, value_name = "TICK")]
        anchor: u64,
        /// Fraction of that tick, in 1/2^32 (outputs 2 to 4)
        #[arg(long, value_name = "N", default_value_t = 0)]
        anchor_fraction: u32,
        #[command(flatten)]
        period: PeriodArg,
        /// Move at most this many µs a frame; 0 jumps at once
        #[arg(long, value_name = "US", default_value = "100", value_parser = parse_us_ticks)]
        slew_us: u32,
        /// Do not wait for the train to arrive
        #[arg(long)]
        no_wait: bool,
    },
    /// Change the period from the next edge on
    Period {
        #[command(flatten)]
        period: PeriodArg,
    },
    /// Measure from the trigger's edge to the centre of exposure, with a photodiode on the
    /// strobe input (PA2) while the train runs
    Latency {
        /// The depth mode's strobe train: nfov, wfov, a mode such as WFOV_2X2BINNED, or COUNT,PITCH_US,DURATION_US
        #[arg(long, default_value = "nfov", value_name = "TRAIN")]
        train: TrainGeometry,
        /// Pulses to measure
        #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u32).range(2..=100_000))]
        pulses: u32,
    },
    /// Stop the train
    Stop,
    /// What the train does
    Status,
}

/// A period in human units.
#[derive(Clone, Copy, Debug, clap::Args)]
#[group(multiple = false)]
struct PeriodArg {
    /// Frames a second, such as 30 or 29.97; exact
    #[arg(long, value_name = "FPS", value_parser = parse_fps)]
    fps: Option<Period>,
    /// Period in µs, such as 33330.652; exact to 2⁻³² ticks
    #[arg(long, value_name = "US", value_parser = parse_period_us)]
    period_us: Option<Period>,
}

impl PeriodArg {
    fn given(self) -> Option<Period> {
        self.fps.or(self.period_us)
    }
}

/// What `--json` prints.
#[derive(Debug, Serialize)]
struct TriggerReport {
    state: TrainState,
    train: u32,
    period_ns: String,
    period_ticks: u32,
    period_fraction: u32,
    fps: f64,
    phase_step_ns: f64,
    width_us: f64,
    pulses: u64,
    next_edge_ticks: u64,
    next_edge_fraction: u32,
    late: u32,
    readback: ReadbackReport,
}

#[derive(Debug, Serialize)]
struct ReadbackReport {
    /// "not wired", "ok", "missing n", or "stray n".
    state: String,
    seen: u32,
    missing: u32,
    stray: u32,
    delay_ticks: Option<i32>,
    delay_ns: Option<f64>,
}

#[derive(Debug, Serialize)]
struct AlignReport {
    shift_ticks: i64,
    shift_us: f64,
    frames: u32,
    arrival_pulse: u64,
    arrival_ticks: u64,
    arrived: Option<ArrivedReport>,
}

#[derive(Debug, Serialize)]
struct ArrivedReport {
    pulse: u64,
    at_ticks: u64,
    remaining_ticks: i64,
}

/// Runs `trigger`.
///
/// # Errors
///
/// The board cannot be reached or refuses.
pub(crate) fn run(args: &Args, context: &Context) -> Result<Outcome, Failure> {
    // Wrong options are told before the port is opened.
    if let Action::Period { period } = &args.action
        && period.given().is_none()
    {
        return Err(Failure::new(
            ExitStatus::Usage,
            "trigger period needs --fps or --period-us",
        )
        .next_step("give one of them, for example `trigger period --fps 30`"));
    }
    let output = Output::from_number(args.output);
    let fraction = match args.action {
        Action::Start { first_fraction, .. } => first_fraction,
        Action::Align {
            anchor_fraction, ..
        } => anchor_fraction,
        _ => 0,
    };
    if output.is_none() && fraction != 0 {
        return Err(Failure::new(
            crate::outcome::ExitStatus::Usage,
            "a fraction of a tick is for outputs 2 to 4; the camera's train begins on whole ticks",
        )
        .next_step("leave the fraction out, or choose an output with --output 2, 3 or 4"));
    }
    if output.is_some() && matches!(args.action, Action::Latency { .. }) {
        return Err(Failure::new(
            ExitStatus::Usage,
            "the latency is measured on the camera's trigger, output 1",
        )
        .next_step("leave --output out"));
    }
    let board = args.port.open()?;
    let mut target = Target { board, output };
    act(&args.action, &mut target, context)
}

/// One trigger output of a board.
struct Target {
    board: Board,
    /// None is the camera's.
    output: Option<Output>,
}

impl Target {
    fn start(&mut self, start: TriggerStart, first_fraction: u32) -> BoardResult<TriggerStatus> {
        match self.output {
            None => self.board.start_trigger(start),
            Some(output) => {
                let start = protocol::OutputStart {
                    first_fraction,
                    ..start.into()
                };
                self.board.output(output, OutputAction::Start(start))
            }
        }
    }

    fn align(&mut self, to: TriggerAlign, anchor_fraction: u32) -> BoardResult<AlignPlan> {
        match self.output {
            None => self.board.align(to),
            Some(output) => {
                let to = OutputAlign {
                    anchor_fraction,
                    ..to.into()
                };
                self.board.align_output(output, to)
            }
        }
    }

    fn set_period(&mut self, period: Period) -> BoardResult<TriggerStatus> {
        match self.output {
            None => self.board.set_period(period),
            Some(output) => self.board.output(output, OutputAction::Period(period)),
        }
    }

    fn stop(&mut self) -> BoardResult<TriggerStatus> {
        match self.output {
            None => self.board.stop_trigger(),
            Some(output) => self.board.output(output, OutputAction::Stop),
        }
    }

    fn status(&mut self) -> BoardResult<TriggerStatus> {
        match self.output {
            None => self.board.trigger(),
            Some(output) => self.board.output(output, OutputAction::Query),
        }
    }

    /// The arrival that a message tells of, if it is one of this output.
    fn arrival(&self, message: &DeviceToHost) -> Option<Arrived> {
        match (self.output, message) {
            (None, DeviceToHost::Arrived(arrived)) => Some(*arrived),
            (Some(output), DeviceToHost::OutputArrived(arrived)) if arrived.output == output => {
                Some(Arrived {
                    command: arrived.command,
                    train: arrived.train,
                    pulse: arrived.pulse,
                    at: arrived.at,
                    remaining: arrived.remaining,
                })
            }
            _ => None,
        }
    }
}

fn act(action: &Action, board: &mut Target, context: &Context) -> Result<Outcome, Failure> {
    let status = match *action {
        Action::Latency { train, pulses } => {
            return measure_latency(&mut board.board, context, &train, pulses as usize);
        }
        Action::Start {
            period,
            width_us,
            first_edge,
            first_fraction,
        } => {
            let default_us = if board.output.is_none() { 12 } else { 100 };
            let start = TriggerStart {
                period: period.given().unwrap_or(Period::from_ticks(TICK_HZ / 30)),
                width: width_us.unwrap_or(default_us * (TICK_HZ / 1_000_000)),
                first_edge: first_edge.map(Ticks),
            };
            board.start(start, first_fraction)
        }
        Action::Align {
            anchor,
            anchor_fraction,
            period,
            slew_us,
            no_wait,
        } => {
            let align = Align {
                anchor: Ticks(anchor),
                anchor_fraction,
                period: period.given(),
                slew: slew_us,
                wait: !no_wait,
            };
            return align.run(board, context);
        }
        Action::Period { period } => match period.given() {
            Some(period) => board.set_period(period),
            None => board.status(),
        },
        Action::Stop => board.stop(),
        Action::Status => board.status(),
    };
    let status = status?;
    let mut report = TriggerReport::from(&status);
    if board.output.is_some() {
        report.readback.state = String::from("none on this output");
    }
    context.print(&report, || report.text(&status))?;
    Ok(if status.late > 0 || status.readback.missing > 0 {
        Outcome::Loss
    } else {
        Outcome::Good
    })
}

/// Collects pulses and strobes, and says how they lie to each other.
fn measure_latency(
    board: &mut Board,
    context: &Context,
    train: &TrainGeometry,
    wanted: usize,
) -> Result<Outcome, Failure> {
    let status = board.trigger()?;
    if status.state == TrainState::Stopped {
        return Err(Failure::new(
            ExitStatus::Refused,
            "the trigger is stopped: there is nothing to measure",
        )
        .next_step("start it with `smartdepthsync trigger start --fps 30`, and the depth camera"));
    }
    let (mut pulses, mut captures) = (Vec::new(), Vec::new());
    let mut quiet_since = board.now();
    // The last pulse only ends the one before it.
    while pulses.len() <= wanted {
        if context.interrupt.requested() {
            return Ok(Outcome::Interrupted);
        }
        match board.next_event(Duration::from_millis(100))? {
            Some(Event::Message(DeviceToHost::Pulse(pulse))) => {
                pulses.push(pulse.at);
                quiet_since = board.now();
            }
            Some(Event::Message(DeviceToHost::Capture(capture))) => captures.push(capture),
            _ => {}
        }
        if board.now().saturating_sub(quiet_since) > PULSE_PATIENCE {
            break;
        }
    }
    let Some(found) = latency(&pulses, &captures, train) else {
        return Err(Failure::new(
            ExitStatus::Refused,
            format!(
                "no pulse has a whole train of {} flashes: {} strobe edges came with {} pulses, {} a pulse are expected",
                train.count,
                captures.len(),
                pulses.len(),
                2 * train.count
            ),
        )
        .next_step("check that the depth camera runs on the trigger, that the photodiode on PA2 sees its flashes and nothing else, and that --train is the depth mode's"));
    };
    context.print(&found, || latency_text(&found))?;
    Ok(if found.left_out > 0 {
        Outcome::Loss
    } else {
        Outcome::Good
    })
}

fn latency_text(found: &Latency) -> String {
    let mut text = format!(
        "pulses       {} with a whole train of flashes, {} without\n",
        found.pulses, found.left_out
    );
    for (name, quantity) in [
        ("centre", &found.center),
        ("first flash", &found.first_flash),
        ("pitch", &found.pitch),
        ("flash", &found.duration),
    ] {
        let _ = writeln!(
            text,
            "{name:<12} {:.3} ± {:.3} µs (a single one: {:.3} µs)",
            quantity.mean_us, quantity.sigma_us, quantity.sd_us
        );
    }
    let _ = write!(
        text,
        "for the rig profile, less the light path's own delay:\n[depth]\ncenter_offset_us = {:.3}\ncenter_offset_sigma_us = {:.3}",
        found.center.mean_us, found.center.sigma_us
    );
    text
}

struct Align {
    anchor: Ticks,
    anchor_fraction: u32,
    period: Option<Period>,
    slew: u32,
    wait: bool,
}

impl Align {
    fn run(&self, board: &mut Target, context: &Context) -> Result<Outcome, Failure> {
        let period = match self.period {
            Some(period) => period,
            None => board.status()?.period,
        };
        let plan = board.align(
            TriggerAlign {
                anchor: self.anchor,
                period,
                slew: self.slew,
            },
            self.anchor_fraction,
        )?;
        let mut report = AlignReport::from(&plan);
        if !context.global.json {
            context.print(&report, || report.text())?;
        }
        let mut outcome = Outcome::Good;
        if self.wait {
            outcome = match wait_for_arrival(board, context, &plan)? {
                Wait::Arrived(arrived) => {
                    report.arrived = Some(ArrivedReport::from(&arrived));
                    Outcome::Good
                }
                Wait::Unconfirmed => {
                    tracing::warn!("the train runs on its grid, but its arrival was not reported");
                    Outcome::Loss
                }
                Wait::Interrupted => Outcome::Interrupted,
            };
        }
        match &report.arrived {
            Some(arrived) if !context.global.json => context.print(&report, || arrived.text())?,
            _ if context.global.json => context.print(&report, String::new)?,
            _ => {}
        }
        Ok(outcome)
    }
}

/// How waiting for an arrival ended.
enum Wait {
    Arrived(Arrived),
    /// The message was lost; the state of the train says that it has arrived.
    Unconfirmed,
    Interrupted,
}

/// Waits for the arrival of the last align.
fn wait_for_arrival(
    target: &mut Target,
    context: &Context,
    plan: &AlignPlan,
) -> Result<Wait, Failure> {
    // In board time, with a margin for the message; a rig that has no time
    // passing at all is given up by the clock on the wall.
    let latest = plan.arrival.0 + u64::from(TICK_HZ) * 3;
    let mut quiet_since = target.board.now();
    loop {
        if context.interrupt.requested() {
            return Ok(Wait::Interrupted);
        }
        match target.board.next_event(Duration::from_millis(100))? {
            Some(Event::Message(message)) => {
                let arrived = target.arrival(&message).filter(|arrived| {
                    arrived.pulse == plan.arrival_pulse && arrived.at == plan.arrival
                });
                if let Some(arrived) = arrived {
                    return Ok(Wait::Arrived(arrived));
                }
                quiet_since = target.board.now();
            }
            Some(_) => quiet_since = target.board.now(),
            None => {}
        }
        let quiet = target.board.now().saturating_sub(quiet_since) > Duration::from_secs(20);
        if quiet || target.board.conversation().latest().0 > latest {
            let status = target.status()?;
            if status.state == TrainState::Running && status.pulses > plan.arrival_pulse {
                return Ok(Wait::Unconfirmed);
            }
            return Err(BoardError::NoAnswer {
                command: "arrival of the align",
            }
            .into());
        }
    }
}

fn micros(ticks: f64) -> f64 {
    ticks * 1e6 / f64::from(TICK_HZ)
}

impl From<&TriggerStatus> for TriggerReport {
    fn from(status: &TriggerStatus) -> Self {
        let period = status.period;
        let seconds = period.as_secs_f64();
        Self {
            state: status.state,
            train: status.train,
            period_ns: period.to_string().trim_end_matches(" ns").to_owned(),
            period_ticks: period.ticks(),
            period_fraction: period.fraction(),
            fps: if seconds > 0.0 { 1.0 / seconds } else { 0.0 },
            phase_step_ns: 1e9 / f64::from(TICK_HZ),
            width_us: micros(f64::from(status.width)),
            pulses: status.pulses,
            next_edge_ticks: status.next_edge.0,
            next_edge_fraction: status.next_fraction,
            late: status.late,
            readback: ReadbackReport::from(&status.readback),
        }
    }
}

impl TriggerReport {
    fn text(&self, status: &TriggerStatus) -> String {
        let mut text = String::new();
        let state = match self.state {
            TrainState::Stopped => "stopped",
            TrainState::Waiting => "waiting for its first edge",
            TrainState::Running => "running",
            TrainState::Slewing => "slewing to another phase",
        };
        let _ = writeln!(text, "state       {state}");
        if self.train > 0 {
            let _ = writeln!(text, "train       {}, {} pulses", self.train, self.pulses);
            let _ = writeln!(
                text,
                "period      {} ns ({} + {}/2^32 ticks, {:.6} fps)",
                self.period_ns, self.period_ticks, self.period_fraction, self.fps
            );
            let _ = writeln!(text, "pulse       {:.3} µs wide", self.width_us);
        }
        if matches!(
            self.state,
            TrainState::Running | TrainState::Slewing | TrainState::Waiting
        ) {
            let _ = writeln!(
                text,
                "next edge   {} ({:.6} s)",
                status.next_edge,
                status.next_edge.as_secs_f64()
            );
        }
        let _ = writeln!(text, "phase step  {:.2} ns", self.phase_step_ns);
        if self.late > 0 {
            let _ = writeln!(
                text,
                "late edges  {}: they came later than asked for",
                self.late
            );
        }
        let _ = write!(text, "read-back   {}", self.readback.state);
        if let Some(delay) = self.readback.delay_ticks {
            let _ = write!(
                text,
                ", delay {delay} ticks ({:.0} ns)",
                self.readback.delay_ns.unwrap_or_default()
            );
        }
        text
    }
}

impl From<&Readback> for ReadbackReport {
    fn from(readback: &Readback) -> Self {
        let state = match (readback.seen, readback.missing, readback.stray) {
            (0, 0, 0) => String::from("not wired"),
            (_, 0, 0) => String::from("ok"),
            (_, 0, stray) => format!("stray {stray}"),
            (_, missing, _) => format!("missing {missing}"),
        };
        Self {
            state,
            seen: readback.seen,
            missing: readback.missing,
            stray: readback.stray,
            delay_ticks: readback.delay,
            delay_ns: readback
                .delay
                .map(|ticks| f64::from(ticks) * 1e9 / f64::from(TICK_HZ)),
        }
    }
}

impl From<&AlignPlan> for AlignReport {
    fn from(plan: &AlignPlan) -> Self {
        Self {
            shift_ticks: plan.shift.0,
            shift_us: micros(plan.shift.0 as f64),
            frames: plan.frames,
            arrival_pulse: plan.arrival_pulse,
            arrival_ticks: plan.arrival.0,
            arrived: None,
        }
    }
}

impl AlignReport {
    fn text(&self) -> String {
        format!(
            "moving by {:+} ticks ({:+.3} µs) over {} frames; on the grid from pulse {} on",
            self.shift_ticks, self.shift_us, self.frames, self.arrival_pulse
        )
    }
}

impl From<&Arrived> for ArrivedReport {
    fn from(arrived: &Arrived) -> Self {
        Self {
            pulse: arrived.pulse,
            at_ticks: arrived.at.0,
            remaining_ticks: arrived.remaining.0,
        }
    }
}

impl ArrivedReport {
    fn text(&self) -> String {
        format!(
            "arrived at pulse {} ({} ticks), {} ticks from the grid",
            self.pulse, self.at_ticks, self.remaining_ticks
        )
    }
}
