//! What the live view shows of a session, gathered as messages go by.
//!
//! Without a terminal a plain line is said every ten seconds of board time.

use std::path::Path;
use std::sync::mpsc::Receiver;
use std::time::Instant;

use protocol::{DeviceToHost, TICK_HZ, Ticks};

use super::rounds::free_space;
use crate::context::Context;
use crate::view::gauge::Gauge;
use crate::view::lines::line;
use crate::view::screen::{Key, Screen};
use crate::view::{Disk, Keys, PERIOD, Recording};
use board::imu::Scale;
use recording::session_file::Alignment;
use timebase::ClockModel;

/// How often a plain line is said, ticks.
const LINE_TICKS: u64 = 10 * TICK_HZ as u64;

/// How often the disk is looked at, ticks.
const DISK_TICKS: u64 = 2 * TICK_HZ as u64;

/// A recording's size is judged after so much of it, ticks.
const SIZE_TICKS: u64 = 5 * TICK_HZ as u64;

/// The step a session is in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    /// Before the twist, or between steps.
    Preparing,
    /// The twist with this number.
    Twist(usize),
    /// The trigger runs and is sent onto the phone's frames.
    Aligning,
    /// Recording, since this time.
    Recording(Ticks),
    /// Devices are stopped, files finished.
    Closing,
}

/// The view of a session.
pub struct Live {
    /// Gathers.
    pub(crate) gauge: Gauge,
    /// How long is to be recorded, ticks.
    pub(crate) length: Option<u64>,
    context: Context,
    screen: Option<Screen>,
    shown: Instant,
    said: Ticks,
    step: Step,
    looked: Ticks,
    begun: Option<(Ticks, u64)>,
}

impl Live {
    /// Takes the terminal, if there is one and nothing else is wanted.
    #[must_use]
    pub fn open(context: &Context, wanted: bool) -> Self {
        let screen = (wanted && !context.global.json)
            .then(|| Screen::open(&context.interrupt))
            .flatten();
        context.said.divert(screen.is_some());
        Self {
            gauge: Gauge::default(),
            length: None,
            context: context.clone(),
            screen,
            shown: Instant::now(),
            said: Ticks::ZERO,
            step: Step::Preparing,
            looked: Ticks::ZERO,
            begun: None,
        }
    }

    /// The keys of the view, if there is one; once.
    pub(crate) fn take_keys(&mut self) -> Option<Receiver<Key>> {
        self.screen.as_mut().and_then(Screen::take_keys)
    }

    /// A message of the board.
    pub(crate) fn take(&mut self, message: &DeviceToHost, scale: &Scale) {
        self.gauge.take(message, Some(scale));
    }

    /// The step the session is in now; `twist` is how long one is in s, and the
    /// 1-sigma in µs that is enough.
    pub(crate) fn step(&mut self, step: Step, twist: (f64, f64)) {
        if step == self.step {
            return;
        }
        match step {
            Step::Twist(_) => self.gauge.begin_twist(twist.0, twist.1),
            _ => self.gauge.end_twist(),
        }
        if matches!(step, Step::Recording(_)) {
            // As the session file does.
            self.gauge.start_counting();
        }
        self.step = step;
        self.gauge.latest.state = match step {
            Step::Preparing => String::from("preparing"),
            Step::Twist(number) => format!("twist {number}"),
            Step::Aligning => String::from("aligning"),
            Step::Recording(_) => String::from("recording"),
            Step::Closing => String::from("closing"),
        };
    }

    /// Shows the latest state, if it is time to.
    pub(crate) fn show(
        &mut self,
        now: Ticks,
        folder: &Path,
        clock: Option<&ClockModel>,
        alignment: Option<&Alignment>,
        asks: bool,
    ) {
        if self.shown.elapsed() < PERIOD {
            return;
        }
        self.shown = Instant::now();
        if now.0.abs_diff(self.looked.0) > DISK_TICKS {
            self.looked = now;
            self.look_at_disk(now, folder);
        }
        let line_is_due = now.0.abs_diff(self.said.0) >= LINE_TICKS;
        if self.screen.is_none() && !line_is_due {
            return;
        }
        let mut snapshot = self.gauge.snapshot(clock, alignment);
        if let Step::Recording(from) = self.step {
            snapshot.recording = Some(Recording {
                elapsed_s: now.0.saturating_sub(from.0) as f64 / f64::from(TICK_HZ),
                length_s: self.length.map(|ticks| ticks as f64 / f64::from(TICK_HZ)),
            });
        }
        snapshot.keys = match self.step {
            Step::Recording(_) => Keys::Record,
            _ if asks => Keys::Answer,
            _ => Keys::Look,
        };
        match &self.screen {
            Some(screen) => {
                snapshot.said = self.context.said.lines();
                screen.show(snapshot);
            }
            None if line_is_due => {
                self.said = now;
                self.context.say(line(&snapshot));
            }
            None => {}
        }
    }

    /// Free space, and how long it lasts at the rate at which the recording grows.
    fn look_at_disk(&mut self, now: Ticks, folder: &Path) {
        let Some(free) = free_space(folder) else {
            return;
        };
        let size =
            std::fs::metadata(folder.join(recording::MCAP_FILE)).map_or(0, |data| data.len());
        let (since, first) = *self.begun.get_or_insert((now, size));
        let time = now.0.saturating_sub(since.0);
        let grown = size.saturating_sub(first);
        let left_s = (time > SIZE_TICKS && grown > 0)
            .then(|| free as f64 / (grown as f64 / (time as f64 / f64::from(TICK_HZ))));
        self.gauge.latest.disk = Some(Disk { free, left_s });
    }
}

impl Drop for Live {
    /// Gives the terminal back before anything else is said on it.
    fn drop(&mut self) {
        self.screen = None;
        self.context.said.divert(false);
    }
}
