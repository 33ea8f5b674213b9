//! `smartdepthsync gnss`: pulse per second and NMEA sentences for a lidar.

use std::fmt::Write as _;

use clap::Subcommand;
use protocol::{Baud, GnssReport, GnssSettings, GnssStatus, Sentences, TICK_HZ, TrainState};
use serde::Serialize;

use crate::context::Context;
use crate::decimal::parse_us_ticks;
use crate::options::PortArg;
use crate::outcome::{ExitStatus, Failure};
use board::gnss::{NMEA_DELAY_MS, parse_baud, utc_at_zero};

/// Options of `gnss`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    port: PortArg,
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Start the pulse on the next whole second of board time; as a Velodyne
    /// VLP-16 wants it unless given otherwise
    Start {
        /// UTC of the present second as Unix time [default: this computer's clock]
        #[arg(long, value_name = "SECONDS")]
        utc: Option<i64>,
        /// Rate of the serial line: 4800, 9600, 19200, 38400, 57600 or 115200
        #[arg(long, value_name = "BD", default_value = "9600", value_parser = parse_baud)]
        baud: Baud,
        /// The serial line is high when idle, as a UART's; otherwise low, as
        /// behind an RS-232 driver
        #[arg(long)]
        idle_high: bool,
        /// Send $GPZDA after $GPRMC
        #[arg(long)]
        zda: bool,
        /// From the pulse to the first bit of the sentences, ms
        #[arg(long, value_name = "MS", default_value_t = NMEA_DELAY_MS)]
        delay_ms: u16,
        /// Length of the pulse, µs
        #[arg(long, value_name = "US", default_value = "20000", value_parser = parse_us_ticks)]
        width_us: u32,
        /// The pulse goes from high to low
        #[arg(long)]
        pulse_low: bool,
    },
    /// Stop pulse and sentences
    Stop,
    /// Show its state
    Status,
}

/// What `--json` prints.
#[derive(Debug, Serialize)]
struct PrintedGnss {
    #[serde(flatten)]
    status: GnssStatus,
    settings: Option<PrintedSettings>,
}

#[derive(Debug, Serialize)]
struct PrintedSettings {
    /// UTC = board time + this, both in seconds.
    utc_at_zero: i64,
    baud: u32,
    idle_high: bool,
    sentences: &'static str,
    delay_ms: u16,
    ends_ms: f64,
    pulse_width_us: f64,
    pulse_low: bool,
}

/// Runs `gnss`.
///
/// # Errors
///
/// The board cannot be reached or refuses.
pub(crate) fn run(args: &Args, context: &Context) -> Result<ExitStatus, Failure> {
    let mut board = args.port.open()?;
    let report = match args.action {
        Action::Start {
            utc,
            baud,
            idle_high,
            zda,
            delay_ms,
            width_us,
            pulse_low,
        } => {
            let utc_at_zero = match utc {
                Some(utc) => {
                    let (now, _) = board.ping()?;
                    utc.saturating_sub_unsigned(now.0 / u64::from(TICK_HZ))
                }
                None => utc_at_zero(&mut board)?.ok_or_else(|| {
                    Failure::new(
                        ExitStatus::Usage,
                        "this computer's clock is set before 1970",
                    )
                    .next_step("set it, or give the time with --utc")
                })?,
            };
            let settings = GnssSettings {
                utc_at_zero,
                baud,
                line_inverted: !idle_high,
                sentences: if zda {
                    Sentences::RmcZda
                } else {
                    Sentences::Rmc
                },
                delay_ms,
                pulse_width: width_us,
                pulse_inverted: pulse_low,
            };
            board::gnss::start(&mut board, settings)
        }
        Action::Stop => board.stop_gnss(),
        Action::Status => board.gnss(),
    };
    let report = PrintedGnss::from(&report?);
    context.print(&report, || report.text())?;
    Ok(ExitStatus::of_loss(
        report.status.late > 0 || report.status.missed > 0,
    ))
}

impl From<&GnssReport> for PrintedGnss {
    fn from(report: &GnssReport) -> Self {
        Self {
            status: report.status,
            settings: report.settings.map(|settings| PrintedSettings {
                utc_at_zero: settings.utc_at_zero,
                baud: settings.baud.hz(),
                idle_high: !settings.line_inverted,
                sentences: match settings.sentences {
                    Sentences::Rmc => "GPRMC",
                    Sentences::RmcZda => "GPRMC, GPZDA",
                },
                delay_ms: settings.delay_ms,
                ends_ms: f64::from(settings.ends_us()) / 1e3,
                pulse_width_us: f64::from(settings.pulse_width) * 1e6 / f64::from(TICK_HZ),
                pulse_low: settings.pulse_inverted,
            }),
        }
    }
}

impl PrintedGnss {
    fn text(&self) -> String {
        let mut text = String::new();
        let state = match self.status.state {
            TrainState::Stopped => "stopped",
            TrainState::Waiting => "waiting for the next whole second",
            TrainState::Running | TrainState::Slewing => "running",
        };
        let _ = writeln!(text, "state      {state}");
        let _ = writeln!(
            text,
            "so far     {} pulses, sentences of {} seconds",
            self.status.pulses, self.status.sentences
        );
        if self.status.missed > 0 || self.status.late > 0 {
            let _ = writeln!(
                text,
                "lost       sentences of {} seconds; {} edges came late",
                self.status.missed, self.status.late
            );
        }
        if let Some(settings) = &self.settings {
            let polarity = |low| if low { "high to low" } else { "low to high" };
            let idle = if settings.idle_high { "high" } else { "low" };
            let _ = writeln!(
                text,
                "time       UTC = board time {:+} s",
                settings.utc_at_zero
            );
            let _ = writeln!(
                text,
                "pulse      PE9, {:.3} µs, {}",
                settings.pulse_width_us,
                polarity(settings.pulse_low)
            );
            let _ = writeln!(
                text,
                "sentences  PC12, {} Bd, idle {idle}: {}, {} ms after the pulse, over after {:.1} ms",
                settings.baud, settings.sentences, settings.delay_ms, settings.ends_ms
            );
        }
        text
    }
}
