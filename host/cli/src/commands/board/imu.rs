//! `smartdepthsync board imu`: stream the board's IMU, judge it, write it to a file.

use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};

use indicatif::ProgressBar;
use protocol::{DeviceToHost, ImuClock, ImuSensor, TICK_HZ};
use serde::Serialize;

use crate::advice::imu_scale;
use crate::context::Context;
use crate::decimal::{parse_duration, seconds};
use crate::options::PortArg;
use crate::outcome::{ExitStatus, Failure, refuse_to_overwrite};
use board::imu::{Sample, Scale, Summary, SummaryReport, last_fault};
use board::{Board, Event, Stream};
use session::checks::IMU_WIRING;

/// How long, in board time, samples may stay away before it is given up. The
/// board recovers a sensor within a second.
const PATIENCE_TICKS: u64 = 5 * TICK_HZ as u64;

/// Options of `board imu`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: smartdepthsync board imu --duration 60s --out imu.csv")]
pub(crate) struct Args {
    /// How long, in board time: 90s, 5m, 1h
    #[arg(long, value_name = "TIME", default_value = "10s", value_parser = parse_duration)]
    duration: u64,
    /// Write the samples to this CSV file, in SI units with board time
    #[arg(short, long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Replace the file if it is there
    #[arg(long, requires = "out")]
    overwrite: bool,
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
    csv: Option<String>,
}

/// Streams the IMU.
///
/// # Errors
///
/// The board cannot be reached, its IMU gives nothing, or the file cannot be
/// written.
pub(crate) fn run(args: &Args, port: &PortArg, context: &Context) -> Result<ExitStatus, Failure> {
    // What is in the way is reported before the board is asked for anything.
    if let Some(path) = &args.out {
        refuse_to_overwrite(path, args.overwrite)?;
    }
    let mut board = port.open()?;
    let mut csv = args.out.as_deref().map(Csv::create).transpose()?;
    let scale = imu_scale(&board.imu()?)?;
    let mut summary = Summary::default();
    let streamed = stream(args, &mut board, context, &scale, &mut summary, &mut csv)?;
    if let Some(csv) = csv {
        csv.finish()?;
    }
    // The clock is only known once samples have come.
    let setup = board.imu()?;
    let report = PrintedImu {
        sensor: setup.sensor,
        clock: setup.status.clock,
        scale,
        nominal_interval_ticks: setup.interval,
        summary: summary.report(),
        missed: board.conversation().counts().of(Stream::Imu).lost,
        csv: args.out.as_ref().map(|path| path.display().to_string()),
    };
    context.show(&report)?;
    let impaired = report.missed > 0 || summary.is_impaired();
    Ok(match streamed {
        Some(()) => ExitStatus::of_loss(impaired),
        None => ExitStatus::Interrupted,
    })
}

/// Takes samples until the time is up; `None` if somebody stops it.
fn stream(
    args: &Args,
    board: &mut Board,
    context: &Context,
    scale: &Scale,
    summary: &mut Summary,
    csv: &mut Option<Csv>,
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
                if let Some(csv) = csv {
                    csv.sample(&sample)?;
                }
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
    let setup = match board.imu() {
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

/// The samples as a CSV file. See `docs/formats.md`.
struct Csv {
    file: BufWriter<File>,
    path: PathBuf,
}

impl Csv {
    const HEADER: &str = "ticks,time_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,\
                          accel_x_m_s2,accel_y_m_s2,accel_z_m_s2,temperature_c,flags";

    fn create(path: &Path) -> Result<Self, Failure> {
        let file = File::create(path).map_err(|error| Failure::file("write", path, &error))?;
        let mut csv = Self {
            file: BufWriter::new(file),
            path: path.to_owned(),
        };
        csv.line(Self::HEADER)?;
        Ok(csv)
    }

    fn sample(&mut self, sample: &Sample) -> Result<(), Failure> {
        let [gx, gy, gz] = sample.gyro;
        let [ax, ay, az] = sample.accel;
        self.line(&format!(
            "{},{},{gx:.9},{gy:.9},{gz:.9},{ax:.7},{ay:.7},{az:.7},{:.3},{}",
            sample.at.0,
            seconds(sample.at.as_nanos()),
            sample.temperature,
            sample.flags.0
        ))
    }

    fn line(&mut self, line: &str) -> Result<(), Failure> {
        writeln!(self.file, "{line}").map_err(|error| Failure::file("write", &self.path, &error))
    }

    fn finish(mut self) -> Result<(), Failure> {
        let written = self.file.flush();
        written.map_err(|error| Failure::file("write", &self.path, &error))
    }
}
