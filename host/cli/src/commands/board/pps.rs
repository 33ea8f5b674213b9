//! `smartdepthsync board pps`: pulse per second and NMEA sentences for a lidar.

use clap::Subcommand;
use protocol::{Baud, QueryGnss, StopGnss, TICK_HZ};

use crate::context::Context;
use crate::options::PortArg;
use crate::outcome::{ExitStatus, Failure};
use board::gnss::{self, parse_baud, utc_at_zero};

/// Options of `board pps`.
#[derive(Debug, clap::Args)]
pub(crate) struct PpsArgs {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Start the pulse on the next whole second of board time; the defaults suit a Velodyne VLP-16
    #[command(after_help = "Example: smartdepthsync board pps start --baud 115200 --zda")]
    Start {
        /// Present second of UTC as Unix time [default: by this computer's clock]
        #[arg(long, value_name = "SECONDS")]
        utc: Option<i64>,
        /// Rate of the serial line: 9600 or 115200
        #[arg(long, value_name = "BD", default_value = "9600", value_parser = parse_baud)]
        baud: Baud,
        /// Keep the idle serial line high, as a UART does; by default it is low, as behind an
        /// RS-232 driver
        #[arg(long)]
        idle_high: bool,
        /// Send $GPZDA after $GPRMC
        #[arg(long)]
        zda: bool,
    },
    /// Stop the pulse and the sentences
    #[command(after_help = "Example: smartdepthsync board pps stop")]
    Stop,
    /// Show the state
    #[command(after_help = "Example: smartdepthsync board pps status")]
    Status,
}

/// Runs `board pps`.
///
/// # Errors
///
/// The board cannot be reached or refuses.
pub(crate) fn run(
    args: &PpsArgs,
    port: &PortArg,
    context: &Context,
) -> Result<ExitStatus, Failure> {
    let mut board = port.open()?;
    let report = match args.action {
        Action::Start {
            utc,
            baud,
            idle_high,
            zda,
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
            let settings = gnss::settings(utc_at_zero, baud, idle_high, zda);
            gnss::start(&mut board, settings)?
        }
        Action::Stop => board.call(StopGnss)?,
        Action::Status => board.call(QueryGnss)?,
    };
    context.show(&report)?;
    let status = report.status;
    Ok(ExitStatus::of_loss(status.late > 0 || status.missed > 0))
}
