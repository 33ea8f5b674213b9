//! The subcommands of `smartdepthsync`, one a file.

pub mod completions;
pub mod doctor;
pub mod evaluate;
pub mod extract;
pub mod gnss;
pub mod imu;
pub mod info;
pub mod man;
pub mod monitor;
pub mod offset;
pub mod phone;
pub mod ports;
pub mod profile;
pub mod record;
pub mod repair;
pub mod report;
pub mod trigger;
pub mod verify;

use crate::outcome::Failure;
use board::Board;

/// The option of every command that talks to the board.
#[derive(Clone, Debug, clap::Args)]
pub struct PortArg {
    /// The board's serial port; may be left out if exactly one board is plugged in
    #[arg(long, value_name = "PATH", global = true)]
    pub port: Option<String>,
}

impl PortArg {
    /// Opens the board.
    ///
    /// # Errors
    ///
    /// No such port, no permission, busy, not this board, another version, no
    /// answer.
    pub fn open(&self) -> Result<Board, Failure> {
        Board::open(self.port.as_deref()).map_err(Failure::from)
    }
}
