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
    input: Input,
    asks: bool,
}

enum Input {
    Lines(Receiver<String>),
    Keys(Receiver<Key>),
}

impl Operator {
    /// Nobody is there: every prompt is answered with "go on".
    #[must_use]
    pub fn absent() -> Self {
        // Keys that nobody presses.
        Self::at_keys(channel().1, false)
    }

    /// Somebody is there. The thread ends with the process: a read of standard
    /// input cannot be called off.
    pub(crate) fn at_stdin() -> Self {
        let (sender, lines) = channel();
        std::thread::spawn(move || {
            let lines = std::io::stdin().lock().lines();
            // Ends with the input, and where nobody listens any more.
            let _ = lines
                .map_while(Result::ok)
                .try_for_each(|line| sender.send(line));
        });
        Self {
            input: Input::Lines(lines),
            asks: true,
        }
    }

    /// Somebody is at the keys of the live view. Nothing is asked if `asks` is
    /// false; marks can be set all the same.
    pub(crate) const fn at_keys(keys: Receiver<Key>, asks: bool) -> Self {
        Self {
            input: Input::Keys(keys),
            asks,
        }
    }

    /// Whether somebody is there to be asked.
    pub(crate) const fn is_present(&self) -> bool {
        self.asks
    }

    /// Lines typed before a prompt are no answer to it.
    pub(crate) fn forget_typed(&self) {
        match &self.input {
            Input::Lines(lines) => lines.try_iter().for_each(drop),
            Input::Keys(keys) => keys.try_iter().for_each(drop),
        }
    }

    /// An answer, if there is one. The end of the input means to quit.
    pub(crate) fn answer(&self) -> Option<Choice> {
        if !self.asks {
            return Some(Choice::Continue);
        }
        match &self.input {
            Input::Keys(keys) => match keys.try_recv() {
                Ok(Key::GoOn) => Some(Choice::Continue),
                Ok(Key::Repeat) => Some(Choice::Repeat),
                Ok(Key::Skip) => Some(Choice::Skip),
                Ok(Key::Quit) | Err(TryRecvError::Disconnected) => Some(Choice::Quit),
                Ok(Key::Mark) | Err(TryRecvError::Empty) => None,
            },
            Input::Lines(lines) => match lines.try_recv().as_deref().map(str::trim) {
                Ok("" | "c") => Some(Choice::Continue),
                Ok("r") => Some(Choice::Repeat),
                Ok("s") => Some(Choice::Skip),
                Ok("q") | Err(TryRecvError::Disconnected) => Some(Choice::Quit),
                Ok(_) | Err(TryRecvError::Empty) => None,
            },
        }
    }

    /// A line typed while recording: `Some(None)` is a quit, `Some(Some(label))`
    /// a mark. The end of the input is nothing: a recording may go on without it.
    pub(crate) fn mark(&self) -> Option<Option<String>> {
        match &self.input {
            Input::Keys(keys) => match keys.try_recv().ok()? {
                Key::Quit => Some(None),
                Key::Mark => Some(Some(String::new())),
                Key::GoOn | Key::Repeat | Key::Skip => None,
            },
            Input::Lines(lines) => {
                let line = lines.try_recv().ok()?;
                let line = line.trim();
                Some((line != "q").then(|| line.to_owned()))
            }
        }
    }
}
