//! The live view of a session or of a board.
//!
//! - [`state`]: events are folded into a [`State`](state::State). Pure.
//! - [`facts`]: the words for a state; [`layout`]: their places on a screen of any size. Pure.
//! - [`sentences`]: the sentence about an event; [`plain`]: the state as one line, where there
//!   is not a terminal. Pure.
//! - [`screen`]: the thread that owns the terminal.
//!
//! The session never waits for the terminal: a separate thread copies the state ten times a
//! second and draws the copy. A slow terminal only delays the picture, and a closed one ends
//! that thread and nothing else.

mod facts;
mod layout;
pub(crate) mod plain;
pub(crate) mod screen;
mod sentences;
pub(crate) mod state;

use std::sync::mpsc::Receiver;

use protocol::{TICK_HZ, Ticks};
use session::event::{SessionEvent, Stamped};

use crate::context::{Context, write_stdout};
use crate::terminal::Shown;
use plain::line;
use screen::{Key, Screen, SharedState, lock};
use sentences::sentence;
use state::State;

/// Interval of the plain lines, ticks.
const LINE_TICKS: u64 = 10 * TICK_HZ as u64;

/// Their interval in a twist, ticks.
const TWIST_LINE_TICKS: u64 = 2 * TICK_HZ as u64;

/// The listener of a session: shows its events on the terminal or in plain lines, and prints
/// them as JSON if that is wanted.
pub(crate) struct View<'a> {
    context: &'a Context,
    state: SharedState,
    screen: Option<Screen>,
    /// True if events are printed.
    prints_events: bool,
    last_line: Ticks,
}

impl<'a> View<'a> {
    /// Opens the view of a session that begins: on the terminal, if there is one and
    /// `wants_screen`.
    pub(crate) fn open(
        context: &'a Context,
        state: State,
        wants_screen: bool,
        prints_events: bool,
    ) -> Self {
        let state = SharedState::new(state.into());
        let screen = wants_screen.then(|| Screen::open(&state, &context.interrupt));
        Self {
            context,
            state,
            screen: screen.flatten(),
            prints_events,
            last_line: Ticks::ZERO,
        }
    }

    /// Returns the keys of the screen, if there is one; once.
    pub(crate) fn take_keys(&mut self) -> Option<Receiver<Key>> {
        self.screen.as_mut().and_then(Screen::take_keys)
    }

    /// Shows an event.
    pub(crate) fn take(&mut self, stamped: &Stamped) {
        lock(&self.state).take(stamped);
        if self.prints_events {
            print(stamped);
        }
        if self.screen.is_none() {
            self.say(stamped);
        }
    }

    fn say(&mut self, Stamped { at, event }: &Stamped) {
        if let Some(mut text) = sentence(event, event.notice().as_ref()) {
            if let SessionEvent::RecordingStarted { .. } = event {
                text.push_str("; Enter sets a mark, Ctrl-C stops");
            }
            self.context.say(text);
        }
        let since = at.0.abs_diff(self.last_line.0);
        if since < TWIST_LINE_TICKS {
            return;
        }
        let state = lock(&self.state);
        if since >= LINE_TICKS || state.twist().is_some() {
            self.last_line = *at;
            self.context.say(line(&state));
        }
    }
}

/// Prints an event as one line of JSON. The board's messages are in the recording, and not
/// printed.
fn print(stamped: &Stamped) {
    if let SessionEvent::Board { .. } = stamped.event {
        return;
    }
    let printed = serde_json::to_string(stamped)
        .map_err(std::io::Error::from)
        .and_then(|text| write_stdout(&text, Shown::Json));
    if let Err(error) = printed {
        tracing::warn!("an event cannot be printed: {error}");
    }
}
