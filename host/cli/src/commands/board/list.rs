//! `smartdepthsync board list`: which serial ports there are, and which look like
//! the board.

use std::collections::BTreeMap;

use crate::advice::Advice;
use crate::context::Context;
use crate::outcome::{ExitStatus, Failure};
use board::BoardError;
use board::transport::ports;

/// Lists the ports.
///
/// # Errors
///
/// The system does not list its ports.
pub(crate) fn run(context: &Context) -> Result<ExitStatus, Failure> {
    let ports = ports::list().map_err(|error| BoardError::Ports(error.to_string()))?;
    if ports.iter().all(|port| !port.board) {
        let (_, step) = BoardError::NoBoard.advice();
        context.say(format!("{}; {step}", BoardError::NoBoard));
    }
    context.show(&BTreeMap::from([("ports", ports)]))?;
    Ok(ExitStatus::Good)
}
