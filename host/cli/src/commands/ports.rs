//! `smartdepthsync ports`: which serial ports there are, and which look like
//! the board.

use std::fmt::Write as _;

use serde::Serialize;

use crate::context::Context;
use crate::outcome::{ExitStatus, Failure};
use board::BoardError;
use board::transport::ports::{self, Port};

/// Options of `ports`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// List boards only, and end with the code for "no port" if there is none
    #[arg(long)]
    boards: bool,
}

/// What `--json` prints.
#[derive(Debug, Serialize)]
struct Ports<'a> {
    ports: &'a [Port],
}

/// Lists the ports.
///
/// # Errors
///
/// The system does not list its ports; or no board, where only boards were
/// asked for.
pub(crate) fn run(args: &Args, context: &Context) -> Result<ExitStatus, Failure> {
    let mut ports = ports::list().map_err(|error| BoardError::Ports(error.to_string()))?;
    if args.boards {
        ports.retain(|port| port.board);
        if ports.is_empty() {
            return Err(
                Failure::new(ExitStatus::NoPort, "no board found on any serial port")
                    .next_step("plug the board in; without --boards all ports are listed"),
            );
        }
    }
    context.print(&Ports { ports: &ports }, || text(&ports))?;
    Ok(ExitStatus::Good)
}

fn text(ports: &[Port]) -> String {
    if ports.is_empty() {
        return String::from("no serial ports");
    }
    let mut text = String::new();
    for port in ports {
        let mark = if port.board { "board" } else { "-" };
        let _ = write!(text, "{:<20} {mark:<6}", port.path);
        if let Some(usb) = &port.usb {
            let name = usb.product.as_deref().unwrap_or("(no product string)");
            let _ = write!(text, " {:04x}:{:04x} {name}", usb.vendor_id, usb.product_id);
            if let Some(serial) = &usb.serial_number {
                let _ = write!(text, ", serial number {serial}");
            }
        }
        text.truncate(text.trim_end().len());
        text.push('\n');
    }
    text
}
