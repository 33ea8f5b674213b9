//! Bytes to and from the board, and nothing else: no frames, no messages.
//!
//! A [`Link`] carries a [`Conversation`](crate::conversation::Conversation).
//! [`serial::SerialLink`] is the one for boards: a USB serial port, or any other
//! terminal device such as the pseudo-terminal of a simulated board. A link
//! also keeps the time by which deadlines are counted, so that a rig in the same
//! process can run on a clock of its own.

use std::time::Duration;

pub mod ports;
pub mod serial;

/// A byte stream to a board, with the clock of its deadlines.
pub trait Link {
    /// Returns the time since a fixed moment, for deadlines. The moment is the same for all links
    /// of a program, so that the board's time can be followed from one link to the next.
    fn now(&self) -> Duration;

    /// Returns the time of the same clock without the system's steering towards the right time.
    fn steady(&self) -> Duration {
        self.now()
    }

    /// Sends all bytes.
    ///
    /// # Errors
    ///
    /// The link is gone, or accepted no bytes for a second.
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError>;

    /// Appends received bytes to `into`, waiting up to `wait` for the first one. Appends nothing if
    /// none arrived.
    ///
    /// # Errors
    ///
    /// The link is gone. Bytes that arrived before have already been returned.
    fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError>;

    /// Reads nothing from the board for `time`.
    fn pause(&mut self, time: Duration);
}

/// The link broke.
#[derive(Clone, Debug, thiserror::Error)]
pub enum LinkError {
    /// The port has gone (unplugged, or the simulated board has ended).
    #[error("the link to the board is gone ({reason})")]
    Gone {
        /// The system's error message.
        reason: String,
    },
    /// The board accepts no bytes.
    #[error("the board takes no bytes")]
    Stuck,
}
