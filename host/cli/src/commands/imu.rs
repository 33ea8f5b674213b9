//! `smartdepthsync imu`: stream the board's IMU, judge it, write it to a file.

use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};

use indicatif::ProgressBar;
use protocol::{
    AccelRange, DeviceToHost, GyroRange, ImuClock, ImuConfig, ImuSensor, ImuState, LowPass, TICK_HZ,
};
use serde::Serialize;

use crate::advice::imu_scale;
use crate::context::Context;
use crate::decimal::seconds;
use crate::options::PortArg;
use crate::outcome::{ExitStatus, Failure, refuse_to_overwrite};
use crate::record::preflight::IMU_WIRING;
use board::imu::{
    ACCEL_RANGES, GYRO_RANGES, LOW_PASSES, Sample, Scale, Summary, SummaryReport, describe,
    last_fault, setting,
};
use board::{Board, Event, Stream};

/// How long, in board time, samples may stay away before it is given up. The
/// board recovers a sensor within a second.
const PATIENCE_TICKS: u64 = 5 * TICK_HZ as u64;

/// Options of `imu`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    port: PortArg,
    /// How long, in seconds of board time
    #[arg(long, value_name = "SECONDS", default_value_t = 10,
          value_parser = clap::value_parser!(u32).range(1..=86_400))]
    seconds: u32,
    /// Write the samples to this file, in SI units with board time
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Replace the file if it is there
    #[arg(long, requires = "csv")]
    overwrite: bool,
    #[command(flatten)]
    settings: Settings,
}

/// Settings to change first; what is not given stays.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
pub(crate) struct Settings {
    /// Samples a second: 1000 divided by a whole number up to 256
    #[arg(long, value_name = "HZ", value_parser = parse_rate)]
    rate: Option<u8>,
    /// Low-pass of the sensor, Hz: of those that it has, the nearest is set
    #[arg(long, value_name = "HZ", value_parser = |text: &str| parse_setting(text, &LOW_PASSES))]
    low_pass: Option<LowPass>,
    /// Full scale of the gyroscope, °/s
    #[arg(long, value_name = "DPS", value_parser = |text: &str| parse_setting(text, &GYRO_RANGES))]
    gyro_range: Option<GyroRange>,
    /// Full scale of the accelerometer, g
    #[arg(long, value_name = "G", value_parser = |text: &str| parse_setting(text, &ACCEL_RANGES))]
    accel_range: Option<AccelRange>,
}

impl Settings {
    /// The settings that are given, over those that are set.
    fn over(self, set: ImuConfig) -> ImuConfig {
        ImuConfig {
            divider: self.rate.unwrap_or(set.divider),
            low_pass: self.low_pass.unwrap_or(set.low_pass),
            gyro_range: self.gyro_range.unwrap_or(set.gyro_range),
            accel_range: self.accel_range.unwrap_or(set.accel_range),
        }
    }
}

fn parse_rate(text: &str) -> Result<u8, String> {
    text.parse::<u32>()
        .ok()
        .filter(|&rate| rate > 0 && 1_000 % rate == 0)
        .and_then(|rate| u8::try_from(1_000 / rate - 1).ok())
        .filter(|&divider| divider <= ImuConfig::MAX_DIVIDER)
        .ok_or_else(|| String::from("expected a divisor of 1000 from 5 to 1000: 1000, 500, 250, 200, 125, 100, 50, 40, 25, 20, 10, 8 or 5"))
}

fn parse_setting<T: Copy>(text: &str, settings: &[(u32, T)]) -> Result<T, String> {
    // As people write it: no `+250`.
    let number = text
        .parse()
        .ok()
        .filter(|number: &u32| number.to_string() == text);
    setting(number.unwrap_or(0), settings).map_err(|expected| format!("expected {expected}"))
}

/// What `--json` prints.
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
    csv: Option<PathBuf>,
    /// The sensor in words.
    #[serde(skip)]
    described: String,
}

/// Streams the IMU.
///
/// # Errors
///
/// The board cannot be reached, its IMU gives nothing, or the file cannot be
/// written.
pub(crate) fn run(args: &Args, context: &Context) -> Result<ExitStatus, Failure> {
    // What is in the way is told before the board is asked for anything.
    if let Some(path) = &args.csv {
        refuse_to_overwrite(path, args.overwrite)?;
    }
    let mut board = args.port.open()?;
    let mut csv = args.csv.as_deref().map(Csv::create).transpose()?;
    let mut setup = board.imu()?;
    let wanted = args.settings.over(setup.config);
    if wanted != setup.config {
        setup = board.configure_imu(wanted)?;
    }
    let scale = imu_scale(&setup)?;
    let mut summary = Summary::default();
    let streamed = stream(args, &mut board, context, &scale, &mut summary, &mut csv)?;
    if let Some(csv) = csv {
        csv.finish()?;
    }
    // The clock is only known once samples have come.
    setup = board.imu()?;
    let report = PrintedImu {
        described: describe(&setup),
        sensor: setup.sensor,
        clock: setup.status.clock,
        scale,
        nominal_interval_ticks: setup.interval,
        summary: summary.report(),
        missed: board.conversation().counts().of(Stream::Imu).lost,
        csv: args.csv.clone(),
    };
    context.print(&report, || report.text())?;
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
    let bar = context.progress(Some(args.seconds.into()), "{bar:30} {pos}/{len} s  {msg}");
    let length = i64::from(args.seconds) * i64::from(TICK_HZ);
    let mut last_sign = board.conversation().latest();
    let stop = context.interrupt.question();
    let streamed = board.listen("IMU samples", &stop, |board, event| {
        match event {
            Some(Event::Message(DeviceToHost::Imu(raw))) => {
                let sample = scale.apply(&raw);
                let first = summary.first().unwrap_or(sample.at);
                if (sample.at - first).0 >= length {
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
                        .next_step("`smartdepthsync info` says why"),
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
    let state = match setup.status.state {
        ImuState::Starting => "being set up",
        ImuState::Running => "running",
        ImuState::Failed => "failed",
    };
    Failure::new(
        ExitStatus::Error,
        format!(
            "no IMU samples for 5 s of board time (IMU {state}; {})",
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

impl PrintedImu {
    fn text(&self) -> String {
        let summary = &self.summary;
        let mut text = String::new();
        let clock = match (self.clock, self.sensor.model.clock_input()) {
            (ImuClock::External, Some((_, rate))) => {
                format!("{rate} from the board: exact in board time")
            }
            (ImuClock::Unknown, _) => String::from("not known yet"),
            _ => String::from("the sensor's own: up to 1.5 % off"),
        };
        let _ = writeln!(text, "sensor       {}", self.described);
        let _ = writeln!(
            text,
            "samples      {} in {:.3} s, {} missed, {} late, {} saturated, {} interruptions",
            summary.samples,
            summary.seconds,
            self.missed,
            summary.late,
            summary.saturated,
            summary.breaks
        );
        let _ = writeln!(text, "clock        {clock}");
        if let (Some(rate), Some(mean)) = (summary.rate_hz, summary.interval_mean_ticks) {
            let _ = writeln!(text, "rate         {rate:.6} Hz");
            let _ = writeln!(
                text,
                "interval     {mean:.3} ticks (nominal {}), jitter {:.3} ticks, {} to {}",
                self.nominal_interval_ticks,
                summary.interval_jitter_ticks.unwrap_or_default(),
                summary.interval_min_ticks.unwrap_or_default(),
                summary.interval_max_ticks.unwrap_or_default()
            );
        }
        let axes = |values: &[Option<f64>; 3]| {
            values.map(|value| value.map_or(String::from("-"), |value| format!("{value:.6}")))
        };
        for (name, unit, noise, mean) in [
            (
                "gyroscope",
                "rad/s",
                &summary.gyro_noise_rad_s,
                &summary.gyro_mean_rad_s,
            ),
            (
                "accelerometer",
                "m/s²",
                &summary.accel_noise_m_s2,
                &summary.accel_mean_m_s2,
            ),
        ] {
            let _ = writeln!(
                text,
                "{name:<14}mean {} {unit}, deviation {} {unit}",
                axes(mean).join(" "),
                axes(noise).join(" ")
            );
        }
        if let Some(temperature) = summary.temperature_c {
            let _ = writeln!(text, "temperature  {temperature:.2} °C");
        }
        if let Some(csv) = &self.csv {
            let _ = writeln!(text, "written to   {}", csv.display());
        }
        text
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_those_of_the_sensor() {
        assert_eq!(parse_rate("500"), Ok(1));
        assert_eq!(parse_rate("1000"), Ok(0));
        assert_eq!(parse_rate("5"), Ok(199));
        for text in ["0", "4", "300", "2", "1001", "-5", ""] {
            assert!(parse_rate(text).is_err(), "{text}");
        }
    }

    #[test]
    fn a_setting_that_is_not_given_stays() {
        let set = ImuConfig {
            divider: 1,
            low_pass: LowPass::Hz188,
            gyro_range: GyroRange::Dps500,
            accel_range: AccelRange::G4,
        };
        assert_eq!(Settings::default().over(set), set);
        let changed = Settings {
            gyro_range: Some(GyroRange::Dps1000),
            ..Settings::default()
        };
        assert_eq!(changed.over(set).gyro_range, GyroRange::Dps1000);
        assert_eq!(changed.over(set).divider, 1);
    }
}
