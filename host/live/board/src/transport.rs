//! Bytes to and from the board, and nothing else: no frames, no messages.
//!
//! [`Link`] is what a [`Conversation`](crate::conversation::Conversation) is driven through.
//! [`serial::SerialLink`] is the one for boards: a USB serial port, or any other
//! terminal device such as the pseudo-terminal of a simulated board. A link
//! also keeps the time by which deadlines are counted, so that a rig in the same
//! process can run on a clock of its own.

use std::time::Duration;

pub mod ports;
pub mod serial;

/// A byte stream to a board, with the clock of its deadlines.
pub trait Link {
    /// Time since any fixed moment, for deadlines. The moment is the same for all
    /// links of a program, so that the board's time can be followed from one to
    /// the next.
    fn now(&self) -> Duration;

    /// The same clock, but for what the system does to steer it towards the right time.
    fn steady(&self) -> Duration {
        self.now()
    }

    /// Sends all bytes.
    ///
    /// # Errors
    ///
    /// The link is gone, or took no bytes for a second.
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError>;

    /// Appends what has arrived to `into`. Waits for the first byte at most for
    /// `wait`; nothing appended means that nothing came.
    ///
    /// # Errors
    ///
    /// The link is gone. What had arrived before was given out before.
    fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError>;

    /// Lets time pass in which nothing that arrives is taken from the board.
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
    /// The board takes no bytes.
    #[error("the board takes no bytes")]
    Stuck,
}
