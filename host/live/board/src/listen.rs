//! Listening to a board until an awaited event.

use std::time::Duration;

use crate::calls::Board;
use crate::conversation::Event;
use crate::error::BoardError;

/// Longest silence, on the link's clock. A board sends a status once a second of board time; a
/// simulated one may be slower.
const PATIENCE: Duration = Duration::from_secs(20);

impl Board {
    /// Passes each event to `take`, or `None` after a while without events, until `take` returns a
    /// result. Returns `None` if `stop` returns true before. `what` names the awaited event in
    /// messages.
    ///
    /// # Errors
    ///
    /// The link is gone, messages have ceased, or `take` has an error.
    pub fn listen<T, E: From<BoardError>>(
        &mut self,
        what: &'static str,
        stop: &dyn Fn() -> bool,
        mut take: impl FnMut(&mut Self, Option<Event>) -> Result<Option<T>, E>,
    ) -> Result<Option<T>, E> {
        let mut heard = self.now();
        while !stop() {
            let event = self.next_event(Duration::from_millis(100))?;
            if let Some(Event::Message(_)) = event {
                heard = self.now();
            }
            if let Some(result) = take(self, event)? {
                return Ok(Some(result));
            }
            if self.now().saturating_sub(heard) > PATIENCE {
                return Err(BoardError::NoAnswer { command: what }.into());
            }
        }
        Ok(None)
    }
}
