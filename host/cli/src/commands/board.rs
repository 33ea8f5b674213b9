//! `smartdepthsync board`: the board by hand, one subcommand a file.

mod flash;
mod imu;
mod info;
mod list;
mod pps;
mod test;
mod trigger;

use std::time::{Duration, Instant};

use clap::Subcommand;

use crate::context::Context;
use crate::options::PortArg;
use crate::outcome::{ExitStatus, Failure};

/// Options of `board`.
#[derive(Debug, clap::Args)]
pub(crate) struct BoardArgs {
    #[command(flatten)]
    port: PortArg,
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// List the serial ports, and mark those that look like the board
    #[command(after_help = "Example: smartdepthsync board list")]
    List,
    /// Show the board's ID, firmware, uptime and last reset
    #[command(after_help = "Example: smartdepthsync board info")]
    Info,
    /// Put firmware on the board by USB, without a programmer, and check it
    Flash(flash::FlashArgs),
    /// Test a new board, with a report to send
    Test(test::TestArgs),
    /// Run the camera trigger by hand: start, align, period, stop, status
    Trigger(trigger::TriggerArgs),
    /// Stream the board's IMU: rate, jitter, noise
    Imu(imu::BoardImuArgs),
    /// Run pulse per second and NMEA sentences for a lidar: start, stop, status
    Pps(pps::PpsArgs),
}

/// Runs `board`.
///
/// # Errors
///
/// The board cannot be reached, refuses, or fails.
pub(crate) fn run(args: &BoardArgs, context: &Context) -> Result<ExitStatus, Failure> {
    let port = &args.port;
    match &args.action {
        Action::List => list::run(context),
        Action::Info => info::run(port, context),
        Action::Flash(args) => flash::run(args, port, context),
        Action::Test(args) => test::run(args, port, context),
        Action::Trigger(args) => trigger::run(args, port, context),
        Action::Imu(args) => imu::run(args, port, context),
        Action::Pps(args) => pps::run(args, port, context),
    }
}

/// Tries five times a second for up to a time, until it works or is `in_vain`.
fn keep_trying<T, E>(
    within: Duration,
    in_vain: impl Fn(&E) -> bool,
    mut attempt: impl FnMut() -> Result<T, E>,
) -> Result<T, E> {
    let begun = Instant::now();
    loop {
        match attempt() {
            Err(error) if begun.elapsed() < within && !in_vain(&error) => {
                std::thread::sleep(Duration::from_millis(200));
            }
            result => return result,
        }
    }
}
