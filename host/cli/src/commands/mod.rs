//! The subcommands of `smartdepthsync`, one a file.

pub(crate) mod bring_up;
pub(crate) mod completions;
pub(crate) mod doctor;
pub(crate) mod evaluate;
pub(crate) mod extract;
pub(crate) mod gnss;
pub(crate) mod imu;
pub(crate) mod info;
pub(crate) mod man;
pub(crate) mod monitor;
pub(crate) mod offset;
pub(crate) mod phone;
pub(crate) mod ports;
pub(crate) mod profile;
pub(crate) mod record;
pub(crate) mod repair;
pub(crate) mod report;
pub(crate) mod setup;
pub(crate) mod sync;
pub(crate) mod trigger;
pub(crate) mod verify;

use std::ops::RangeBounds;

use crate::outcome::Failure;
use board::Board;

/// For clap: a number within bounds, which `expected` names.
pub(crate) fn number_in(
    bounds: impl RangeBounds<f64>,
    text: &str,
    expected: &str,
) -> Result<f64, String> {
    let number = text.parse().ok();
    number
        .filter(|number| bounds.contains(number))
        .ok_or_else(|| format!("expected {expected}"))
}

/// The option of every command that talks to the board.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct PortArg {
    /// The board's serial port; may be left out if exactly one board is plugged in
    #[arg(long, value_name = "PATH", global = true)]
    pub(crate) port: Option<String>,
}

impl PortArg {
    /// Opens the board.
    ///
    /// # Errors
    ///
    /// No such port, no permission, busy, not this board, another version, no
    /// answer.
    pub(crate) fn open(&self) -> Result<Board, Failure> {
        Board::open(self.port.as_deref()).map_err(Failure::from)
    }
}
