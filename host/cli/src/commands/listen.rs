//! Listening to the board: until what is waited for has come, the user stops it, or
//! nothing comes any more.

use std::time::Duration;

use crate::cli::Context;
use crate::outcome::Failure;
use board::Board;
use board::Event;

/// How long there may be no sign of life, on the link's clock. A board sends a status
/// once a second of board time; a simulated one may be slower.
const PATIENCE: Duration = Duration::from_secs(20);

/// What an event is to whoever listens.
pub(crate) enum Heard<T> {
    /// What was waited for.
    Done(T),
    /// A sign that it may still come.
    Sign,
    /// Nothing of interest.
    Other,
}

/// How listening ended.
pub(crate) enum Listened<T> {
    Done(T),
    Interrupted,
    /// There was no sign of life for too long.
    Quiet,
}

/// Listens. `take` gets each event, and nothing where none came for a while.
pub(crate) fn listen<T>(
    board: &mut Board,
    context: &Context,
    mut take: impl FnMut(&mut Board, Option<Event>) -> Result<Heard<T>, Failure>,
) -> Result<Listened<T>, Failure> {
    let mut sign = board.now();
    loop {
        if context.interrupt.requested() {
            return Ok(Listened::Interrupted);
        }
        let event = board.next_event(Duration::from_millis(100))?;
        match take(board, event)? {
            Heard::Done(result) => return Ok(Listened::Done(result)),
            Heard::Sign => sign = board.now(),
            Heard::Other => {}
        }
        if board.now().saturating_sub(sign) > PATIENCE {
            return Ok(Listened::Quiet);
        }
    }
}
