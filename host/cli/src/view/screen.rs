//! The thread that owns the terminal.

use std::io::{IsTerminal as _, Stderr, Write as _, stderr, stdin};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use ratatui::Terminal;
use ratatui::backend::CrosstermBackend;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use ratatui::crossterm::execute;
use ratatui::crossterm::terminal::{
    EnterAlternateScreen, LeaveAlternateScreen, disable_raw_mode, enable_raw_mode,
};

use super::layout::draw;
use super::state::{Keys, State};
use crate::context::Interrupt;
use crate::log;

/// Interval of the pictures.
pub(crate) const PERIOD: Duration = Duration::from_millis(100);

/// Longest wait for the terminal at the end; one that takes nothing must not
/// keep the program.
const PATIENCE: Duration = Duration::from_secs(1);

/// A key with a meaning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Key {
    /// Enter.
    GoOn,
    /// `r`.
    Repeat,
    /// `s`.
    Skip,
    /// `m`.
    Mark,
    /// `q` or Escape.
    Quit,
}

/// The state that the screen shows.
pub(crate) type SharedState = Arc<Mutex<State>>;

/// Locks the state.
pub(crate) fn lock(state: &SharedState) -> MutexGuard<'_, State> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The view while it is on the terminal. Dropping it restores the terminal.
pub(crate) struct Screen {
    stop: Arc<AtomicBool>,
    keys: Option<Receiver<Key>>,
    done: Receiver<()>,
    thread: Option<JoinHandle<()>>,
}

/// Returns true if there is a terminal that can show the view, with a person at its keys.
pub(crate) fn is_possible() -> bool {
    let dumb = std::env::var_os("TERM").is_none_or(|term| term == "dumb");
    // One that does not know its size, such as a serial console, takes plain lines.
    let has_size = rustix::termios::tcgetwinsize(stderr()).is_ok_and(|size| size.ws_col > 0);
    stderr().is_terminal() && stdin().is_terminal() && has_size && !dumb
}

impl Screen {
    /// Takes over the terminal. Returns `None` if it is not available. A Ctrl-C becomes an
    /// interrupt, as it does without the view.
    pub(crate) fn open(state: &SharedState, interrupt: &Interrupt) -> Option<Self> {
        if !is_possible() || enable_raw_mode().is_err() {
            return None;
        }
        let stop = Arc::new(AtomicBool::new(false));
        let (key_sender, keys) = channel();
        let (done_sender, done) = channel();
        let (their_stop, state) = (Arc::clone(&stop), Arc::clone(state));
        let interrupt = interrupt.clone();
        log::hold();
        let spawned = std::thread::Builder::new()
            .name(String::from("view"))
            .spawn(move || {
                // Only the view is lost: the recording goes on without it.
                if let Err(error) = show(&state, &their_stop, &key_sender, &interrupt) {
                    tracing::debug!("the view has ended: {error}");
                }
                let _ = disable_raw_mode();
                let _ = execute!(stderr(), LeaveAlternateScreen);
                log::release();
                let _ = done_sender.send(());
            });
        match spawned {
            Ok(thread) => Some(Self {
                stop,
                keys: Some(keys),
                done,
                thread: Some(thread),
            }),
            Err(_) => {
                let _ = disable_raw_mode();
                log::release();
                None
            }
        }
    }

    /// Returns the keys; once.
    pub(crate) const fn take_keys(&mut self) -> Option<Receiver<Key>> {
        self.keys.take()
    }

    /// Restores the terminal, if it still takes output.
    pub(crate) fn close(&mut self) {
        let Some(thread) = self.thread.take() else {
            return;
        };
        self.stop.store(true, Ordering::Relaxed);
        if self.done.recv_timeout(PATIENCE).is_ok() {
            // It has ended; there is nothing to be had from it.
            let _ = thread.join();
        }
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        self.close();
    }
}

fn show(
    state: &SharedState,
    stop: &AtomicBool,
    keys: &Sender<Key>,
    interrupt: &Interrupt,
) -> std::io::Result<()> {
    let mut out = stderr();
    execute!(out, EnterAlternateScreen)?;
    let mut terminal: Terminal<CrosstermBackend<Stderr>> =
        Terminal::new(CrosstermBackend::new(stderr()))?;
    terminal.clear()?;
    let mut help = false;
    while !stop.load(Ordering::Relaxed) {
        // Copied, so that the session never waits for a drawing.
        let copy = lock(state).clone();
        terminal.draw(|frame| draw(frame, &copy, help))?;
        let drawn = Instant::now();
        while let Some(left) = PERIOD.checked_sub(drawn.elapsed()) {
            if !event::poll(left)? {
                break;
            }
            let Event::Key(key) = event::read()? else {
                // A new size is taken by the next drawing.
                continue;
            };
            match act(key, lock(state).keys()) {
                Some(Act::Help) => {
                    help = !help;
                    break;
                }
                Some(Act::Stop) => interrupt.request(),
                // Fails if there is no operator, where the view is only shown.
                Some(Act::Press(key)) => drop(keys.send(key)),
                None => {}
            }
        }
    }
    terminal.show_cursor()?;
    out.flush()
}

/// An effect of a key.
#[derive(Debug, PartialEq, Eq)]
enum Act {
    Help,
    Stop,
    Press(Key),
}

/// Returns the effect of a key with the current meaning of keys.
fn act(key: KeyEvent, keys: Keys) -> Option<Act> {
    if key.kind == KeyEventKind::Release {
        return None;
    }
    Some(match key.code {
        KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => Act::Stop,
        KeyCode::Char('h' | '?') => Act::Help,
        KeyCode::Enter => Act::Press(Key::GoOn),
        KeyCode::Char('r') => Act::Press(Key::Repeat),
        KeyCode::Char('s') => Act::Press(Key::Skip),
        KeyCode::Char('m' | ' ') => Act::Press(Key::Mark),
        // Without a question keys have no receiver, and the last line says that this one stops.
        KeyCode::Char('q') | KeyCode::Esc if keys == Keys::Look => Act::Stop,
        KeyCode::Char('q') | KeyCode::Esc => Act::Press(Key::Quit),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::operator::AtTerminal;
    use crate::view::facts;
    use session::devices::{Choice, Operator as _, Wish};

    /// Whatever the last line offers to stop with stops it.
    #[test]
    fn q_stops_wherever_the_last_line_says_so() {
        let press = |letter| KeyEvent::new(KeyCode::Char(letter), KeyModifiers::NONE);
        for keys in [Keys::Look, Keys::Answer, Keys::Record] {
            assert!(facts::keys(keys).contains("q stop"));
            let (sender, receiver) = channel();
            let interrupt = Interrupt::default();
            let mut operator = AtTerminal::new(Some(receiver), true, &interrupt);
            match act(press('q'), keys) {
                Some(Act::Stop) => interrupt.request(),
                Some(Act::Press(key)) => sender.send(key).unwrap(),
                other => panic!("{keys:?}: {other:?}"),
            }
            let stops = match keys {
                Keys::Look => operator.interrupted(),
                Keys::Answer => operator.answer() == Some(Choice::Quit),
                Keys::Record => operator.wish() == Some(Wish::Stop),
            };
            assert!(stops, "{keys:?}");
        }
        assert_eq!(act(press('h'), Keys::Look), Some(Act::Help));
        assert_eq!(act(press('x'), Keys::Answer), None);
    }
}
