//! The operator at the terminal of a session: answers, marks, and requests to stop.

use std::io::BufRead as _;
use std::sync::mpsc::{Receiver, TryRecvError, channel};

use session::devices::{Choice, Operator, Wish};

use crate::context::Interrupt;
use crate::view::screen::Key;

/// The operator at the keys of the live view or at standard input, or no operator.
pub(crate) struct AtTerminal {
    input: Input,
    asks: bool,
    interrupt: Interrupt,
    /// Number of interrupts that were heeded.
    heeded: u32,
}

enum Input {
    Lines(Receiver<String>),
    Keys(Receiver<Key>),
    Nobody,
}

impl AtTerminal {
    /// Takes answers from the keys of the live view, if there is one, else from standard input.
    /// Without `asks` no questions are asked, but keys still set marks.
    pub(crate) fn new(keys: Option<Receiver<Key>>, asks: bool, interrupt: &Interrupt) -> Self {
        let input = match keys {
            Some(keys) => Input::Keys(keys),
            None if asks => Input::Lines(lines_of_stdin()),
            None => Input::Nobody,
        };
        Self {
            input,
            asks,
            interrupt: interrupt.clone(),
            heeded: 0,
        }
    }
}

/// Returns the lines of standard input, from a thread that ends with the process: a read cannot
/// be cancelled.
pub(crate) fn lines_of_stdin() -> Receiver<String> {
    let (sender, lines) = channel();
    let read = move || {
        let lines = std::io::stdin().lock().lines();
        // Ends with the input, or when the receiver is dropped.
        let _ = lines
            .map_while(Result::ok)
            .try_for_each(|line| sender.send(line));
    };
    let thread = std::thread::Builder::new().name(String::from("standard input"));
    if let Err(error) = thread.spawn(read) {
        tracing::warn!("nothing that is typed is read: {error}");
    }
    lines
}

impl Operator for AtTerminal {
    fn is_present(&self) -> bool {
        self.asks
    }

    fn forget_typed(&mut self) {
        match &self.input {
            Input::Lines(lines) => lines.try_iter().for_each(drop),
            Input::Keys(keys) => keys.try_iter().for_each(drop),
            Input::Nobody => {}
        }
    }

    /// Returns the answer; the end of the input means to quit.
    fn answer(&mut self) -> Option<Choice> {
        match &self.input {
            Input::Nobody => Some(Choice::Continue),
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

    /// Returns a request. The end of the input is not one, so a recording continues without it.
    fn wish(&mut self) -> Option<Wish> {
        match &self.input {
            Input::Nobody => None,
            Input::Keys(keys) => match keys.try_recv().ok()? {
                Key::Quit => Some(Wish::Stop),
                Key::Mark => Some(Wish::Mark(None)),
                Key::GoOn | Key::Repeat | Key::Skip => None,
            },
            Input::Lines(lines) => match lines.try_recv().ok()?.trim() {
                "q" => Some(Wish::Stop),
                "" => Some(Wish::Mark(None)),
                label => Some(Wish::Mark(Some(label.to_owned()))),
            },
        }
    }

    fn interrupted(&self) -> bool {
        self.interrupt.count() > self.heeded
    }

    fn heed_interrupt(&mut self) -> bool {
        self.heeded = self.interrupt.count();
        !self.interrupt.terminates()
    }
}
