//! `smartdepthsync board imu`: stream the board's IMU and judge it.

use indicatif::ProgressBar;
use protocol::{DeviceToHost, ImuClock, ImuSensor, QueryImu, TICK_HZ};
use serde::Serialize;

use crate::advice::imu_scale;
use crate::context::Context;
use crate::decimal::parse_length;
use crate::options::PortArg;
use crate::outcome::{ExitStatus, Failure};
use board::imu::{Scale, Summary, SummaryReport, last_fault};
use board::{Board, Event, Stream};
use session::checks::IMU_WIRING;

/// Longest gap between samples before the command gives up, ticks. The board recovers a sensor
/// within a second.
const PATIENCE_TICKS: u64 = 5 * TICK_HZ as u64;

/// Options of `board imu`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: smartdepthsync board imu --duration 60s")]
pub(crate) struct BoardImuArgs {
    /// Duration in board time, such as 90s, 5m or 1h
    #[arg(long, value_name = "TIME", default_value = "10s", value_parser = parse_length)]
    duration: u64,
}

/// The result.
#[derive(Debug, Serialize)]
struct PrintedImu {
    sensor: ImuSensor,
    clock: ImuClock,
    scale: Scale,
    nominal_interval_ticks: u32,
    #[serde(flatten)]
    summary: SummaryReport,
    /// Samples that the board made and that did not arrive.
    missed: u64,
}

/// Collects samples of the IMU and prints their statistics.
///
/// # Errors
///
/// The board cannot be reached, or its IMU gives nothing.
pub(crate) fn run(
    args: &BoardImuArgs,
    port: &PortArg,
    context: &Context,
) -> Result<ExitStatus, Failure> {
    let mut board = port.open()?;
    let scale = imu_scale(&board.call(QueryImu)?)?;
    let mut summary = Summary::default();
    let streamed = stream(args, &mut board, context, &scale, &mut summary)?;
    // The clock is only known once samples have come.
    let setup = board.call(QueryImu)?;
    let report = PrintedImu {
        sensor: setup.sensor,
        clock: setup.status.clock,
        scale,
        nominal_interval_ticks: setup.interval,
        summary: summary.report(),
        missed: board.conversation().counts().get(Stream::Imu).lost,
    };
    context.show(&report)?;
    let impaired = report.missed > 0 || summary.is_impaired();
    Ok(match streamed {
        Some(()) => ExitStatus::of_loss(impaired),
        None => ExitStatus::Interrupted,
    })
}

/// Collects samples until the time is up. Returns `None` if the user stops it.
fn stream(
    args: &BoardImuArgs,
    board: &mut Board,
    context: &Context,
    scale: &Scale,
    summary: &mut Summary,
) -> Result<Option<()>, Failure> {
    let bar = context.progress(
        Some(args.duration / u64::from(TICK_HZ)),
        "{bar:30} {pos}/{len} s  {msg}",
    );
    let length = args.duration;
    let mut last_sign = board.conversation().latest();
    let stop = context.interrupt.question();
    let streamed = board.listen("IMU samples", &stop, |board, event| {
        match event {
            Some(Event::Message(DeviceToHost::Imu(raw))) => {
                let sample = scale.apply(&raw);
                let first = summary.first().unwrap_or(sample.at);
                if sample.at.0.saturating_sub(first.0) >= length {
                    return Ok(Some(()));
                }
                summary.add(&sample);
                last_sign = sample.at;
                if summary.samples().is_multiple_of(50) {
                    show(&bar, summary);
                }
            }
            Some(Event::Lost {
                stream: Stream::Imu,
                ..
            }) => summary.gap(),
            Some(Event::Restarted { .. }) => {
                return Err(
                    Failure::new(ExitStatus::LinkLost, "the board was reset meanwhile")
                        .next_step("`smartdepthsync board info` says why"),
                );
            }
            _ if (board.conversation().latest() - last_sign).0 > PATIENCE_TICKS as i64 => {
                return Err(no_samples(board));
            }
            _ => {}
        }
        Ok(None)
    })?;
    bar.finish_and_clear();
    Ok(streamed)
}

fn no_samples(board: &mut Board) -> Failure {
    let setup = match board.call(QueryImu) {
        Ok(setup) => setup,
        Err(error) => return error.into(),
    };
    Failure::new(
        ExitStatus::Error,
        format!(
            "no IMU samples for 5 s of board time (IMU {:?}; {})",
            setup.status.state,
            last_fault(&setup)
        ),
    )
    .next_step(IMU_WIRING)
}

fn show(bar: &ProgressBar, summary: &Summary) {
    let report = summary.report();
    bar.set_position(report.seconds as u64);
    bar.set_message(format!(
        "{:.1} Hz, jitter {:.1} ticks, {:.1} °C",
        report.rate_hz.unwrap_or_default(),
        report.interval_jitter_ticks.unwrap_or_default(),
        report.temperature_c.unwrap_or_default()
    ));
}
