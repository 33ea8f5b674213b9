//! The person at the rig: prompts, answers, and marks, without ever keeping the
//! board waiting.

use std::io::BufRead as _;
use std::sync::mpsc::{Receiver, TryRecvError, channel};

use crate::view::screen::Key;

/// An answer to a prompt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Choice {
    /// Go on.
    Continue,
    /// Do the last step again.
    Repeat,
    /// Leave the step out.
    Skip,
    /// Stop cleanly.
    Quit,
}

/// Reads lines from standard input on a thread, or the keys of the live view.
pub struct Operator {
    lines: Option<Receiver<String>>,
    keys: Option<Receiver<Key>>,
    asks: bool,
}

impl Operator {
    /// Nobody is there: every prompt is answered with "go on".
    #[must_use]
    pub const fn absent() -> Self {
        Self {
            lines: None,
            keys: None,
            asks: false,
        }
    }

    /// Somebody is there. The thread ends with the process: a read of standard
    /// input cannot be called off.
    pub(crate) fn at_stdin() -> Self {
        let (sender, lines) = channel();
        std::thread::spawn(move || {
            for line in std::io::stdin().lock().lines() {
                let Ok(line) = line else { return };
                if sender.send(line).is_err() {
                    return;
                }
            }
        });
        Self {
            lines: Some(lines),
            keys: None,
            asks: true,
        }
    }

    /// Somebody is at the keys of the live view. Nothing is asked if `asks` is
    /// false; marks can be set all the same.
    #[must_use]
    pub(crate) const fn at_keys(keys: Receiver<Key>, asks: bool) -> Self {
        Self {
            lines: None,
            keys: Some(keys),
            asks,
        }
    }

    /// Whether somebody is there to be asked.
    pub(crate) const fn is_present(&self) -> bool {
        self.asks
    }

    /// Lines typed before a prompt are no answer to it.
    pub(crate) fn forget_typed(&self) {
        if let Some(keys) = &self.keys {
            while keys.try_recv().is_ok() {}
        }
        if let Some(lines) = &self.lines {
            while lines.try_recv().is_ok() {}
        }
    }

    /// An answer, if there is one. The end of the input means to quit.
    pub(crate) fn answer(&self) -> Option<Choice> {
        if !self.asks {
            return Some(Choice::Continue);
        }
        if let Some(keys) = &self.keys {
            return match keys.try_recv() {
                Ok(Key::GoOn) => Some(Choice::Continue),
                Ok(Key::Repeat) => Some(Choice::Repeat),
                Ok(Key::Skip) => Some(Choice::Skip),
                Ok(Key::Quit) | Err(TryRecvError::Disconnected) => Some(Choice::Quit),
                Ok(Key::Mark) | Err(TryRecvError::Empty) => None,
            };
        }
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
    pub(crate) fn mark(&self) -> Option<Option<String>> {
        if let Some(keys) = &self.keys {
            return match keys.try_recv().ok()? {
                Key::Quit => Some(None),
                Key::Mark => Some(Some(String::new())),
                Key::GoOn | Key::Repeat | Key::Skip => None,
            };
        }
        let line = self.lines.as_ref()?.try_recv().ok()?;
        let line = line.trim();
        Some((line != "q").then(|| line.to_owned()))
    }
}
