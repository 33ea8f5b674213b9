//! The output of log lines: standard error, except while the live view is open.
//!
//! The view draws on the same terminal, so a log line would land in the middle of it, and a
//! terminal that blocks would stop the thread that logs. Lines are therefore held back while the
//! view is open, up to [`MOST`] bytes, and written when it has closed.

use std::io::{self, Write};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Largest size of the lines held back, bytes.
const MOST: usize = 64 << 10;

/// Line in place of further ones.
const TOO_MUCH: &[u8] = b"further log lines were left out: too many came while the view was open\n";

static HELD: Mutex<Option<Vec<u8>>> = Mutex::new(None);

fn held() -> MutexGuard<'static, Option<Vec<u8>>> {
    HELD.lock().unwrap_or_else(PoisonError::into_inner)
}

fn add(held: &mut Vec<u8>, line: &[u8]) {
    if held.len() + line.len() <= MOST {
        held.extend_from_slice(line);
    } else if !held.ends_with(TOO_MUCH) {
        held.extend_from_slice(TOO_MUCH);
    }
}

/// Holds lines back from now on.
pub(crate) fn hold() {
    held().get_or_insert_default();
}

/// Writes what was held back to standard error; lines go there again.
pub(crate) fn release() {
    // Taken out first, so that a thread that logs does not wait for the terminal.
    let held = held().take();
    if let Some(held) = held {
        // Fails if the terminal has gone.
        let _ = io::stderr().lock().write_all(&held);
    }
}

/// Writes whole log lines.
pub(crate) struct Lines;

impl Write for Lines {
    /// Writes one line: the formatter passes a whole event per call.
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        if let Some(held) = held().as_mut() {
            add(held, line);
            return Ok(line.len());
        }
        io::stderr().lock().write(line)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_held_back_in_order_and_further_ones_are_replaced() {
        let mut held = Vec::new();
        for line in ["one\n", "two\n", &"x".repeat(MOST), &"y".repeat(MOST)] {
            add(&mut held, line.as_bytes());
        }
        assert_eq!(held, [b"one\ntwo\n", TOO_MUCH].concat());
    }

    #[test]
    fn while_held_nothing_reaches_the_terminal() {
        hold();
        Lines.write_all(b"a line\n").unwrap();
        assert_eq!(held().as_ref().unwrap(), b"a line\n");
        release();
        assert!(held().is_none());
    }
}
