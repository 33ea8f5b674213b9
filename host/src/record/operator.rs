//! The person at the rig: prompts, answers, and marks, without ever keeping the
//! board waiting.

use std::io::BufRead as _;
use std::sync::mpsc::{Receiver, TryRecvError, channel};

/// An answer to a prompt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Choice {
    /// Go on.
    Continue,
    /// Do the last step again.
    Repeat,
    /// Leave the step out.
    Skip,
    /// Stop cleanly.
    Quit,
}

/// Reads lines from standard input on a thread.
pub struct Operator {
    lines: Option<Receiver<String>>,
}

impl Operator {
    /// Nobody is there: every prompt is answered with "go on".
    #[must_use]
    pub const fn absent() -> Self {
        Self { lines: None }
    }

    /// Somebody is there. The thread ends with the process: a read of standard
    /// input cannot be called off.
    #[must_use]
    pub fn at_stdin() -> Self {
        let (sender, lines) = channel();
        std::thread::spawn(move || {
            for line in std::io::stdin().lock().lines() {
                let Ok(line) = line else { return };
                if sender.send(line).is_err() {
                    return;
                }
            }
        });
        Self { lines: Some(lines) }
    }

    /// Whether somebody is there to be asked.
    #[must_use]
    pub const fn is_present(&self) -> bool {
        self.lines.is_some()
    }

    /// Lines typed before a prompt are no answer to it.
    pub fn forget_typed(&self) {
        if let Some(lines) = &self.lines {
            while lines.try_recv().is_ok() {}
        }
    }

    /// An answer, if there is one. The end of the input means to quit.
    pub fn answer(&self) -> Option<Choice> {
        let Some(lines) = &self.lines else {
            return Some(Choice::Continue);
        };
        match lines.try_recv() {
            Ok(line) => match line.trim() {
                "" | "c" => Some(Choice::Continue),
                "r" => Some(Choice::Repeat),
                "s" => Some(Choice::Skip),
                "q" => Some(Choice::Quit),
                _ => None,
            },
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => Some(Choice::Quit),
        }
    }

    /// A line typed while recording: `Some(None)` is a quit, `Some(Some(label))`
    /// a mark. The end of the input is nothing: a recording may go on without it.
    pub fn mark(&self) -> Option<Option<String>> {
        let line = self.lines.as_ref()?.try_recv().ok()?;
        let line = line.trim();
        Some((line != "q").then(|| line.to_owned()))
    }
}
