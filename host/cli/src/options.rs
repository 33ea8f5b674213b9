//! Options that several commands have.

use std::ops::RangeBounds;

use board::Board;

use crate::outcome::Failure;

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
