//! Where log lines go: to standard error, except while the live view is there.
//!
//! The view draws on the same terminal, so a line of the log would land in the middle
//! of it; and a terminal that takes nothing would stop the thread that logs. Lines are
//! therefore held back while the view is open and written when it has gone, at most
//! [`MOST`] bytes of them; what is left out is counted.

use std::io::{self, Write};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// How much is held back, in bytes.
const MOST: usize = 64 << 10;

#[derive(Default)]
struct Held {
    text: Vec<u8>,
    left_out: u64,
}

impl Held {
    fn add(&mut self, line: &[u8]) {
        if self.text.len() + line.len() <= MOST {
            self.text.extend_from_slice(line);
        } else {
            self.left_out += 1;
        }
    }

    fn write_to(&self, mut out: impl Write) -> io::Result<()> {
        out.write_all(&self.text)?;
        if self.left_out > 0 {
            writeln!(
                out,
                "{} further log lines were left out: more than {} KiB came while the view was open",
                self.left_out,
                MOST >> 10
            )?;
        }
        out.flush()
    }
}

static HELD: Mutex<Option<Held>> = Mutex::new(None);

fn held() -> MutexGuard<'static, Option<Held>> {
    HELD.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Holds lines back from now on.
pub(crate) fn hold() {
    held().get_or_insert_default();
}

/// Writes what was held back to standard error; lines go there again.
pub(crate) fn release() {
    // Taken out first: nobody who logs must wait for the terminal.
    let held = held().take();
    if let Some(held) = held {
        // A terminal that has gone takes no log.
        let _ = held.write_to(io::stderr().lock());
    }
}

/// Takes whole lines.
pub(crate) struct Lines;

impl Write for Lines {
    /// One call is one line: the formatter hands over whole events.
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        if let Some(held) = held().as_mut() {
            held.add(line);
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
    fn lines_are_held_back_in_order_and_what_is_too_much_is_counted() {
        let mut held = Held::default();
        held.add(b"one\n");
        held.add(b"two\n");
        let long = vec![b'x'; MOST];
        held.add(&long);
        held.add(b"three\n");
        let mut out = Vec::new();
        held.write_to(&mut out).unwrap();
        let text = String::from_utf8(out).unwrap();
        assert!(
            text.starts_with("one\ntwo\nthree\n1 further log lines"),
            "{text}"
        );
    }

    #[test]
    fn while_held_nothing_reaches_the_terminal() {
        hold();
        Lines.write_all(b"a line\n").unwrap();
        assert_eq!(held().as_ref().unwrap().text, b"a line\n");
        release();
        assert!(held().is_none());
    }
}
