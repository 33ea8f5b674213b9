//! The devices of a session, as traits: on hardware they are ports, threads and processes,
//! in a simulation models that run on virtual time in the caller's thread.
//!
//! A session never sleeps and never reads a clock but through these. It waits for the board
//! by [`Link::receive`](board::transport::Link::receive), whose link keeps the time of all
//! deadlines, and for anything else by [`Clock::wait`].

pub mod hardware;
pub mod recorder_process;

use std::path::Path;
use std::time::{Duration, SystemTime};

use board::transport::Link;
use jiff::Zoned;
use phone::PhoneError;
use phone::agent::PhoneExchange;
pub use phone::task::Phone;
use recording::profile::Depth;
use recording::writer::WallClock;
use serde::Serialize;

/// Opens links to the board, the first time and after a loss.
pub trait Connector {
    /// A link to the board; to the one with this ID, if it is given.
    ///
    /// # Errors
    ///
    /// It cannot be opened (now).
    fn connect(&mut self, board_id: Option<&str>) -> board::Result<Box<dyn Link>>;
}

/// Reads the phone's clock many times a second while the session runs.
pub trait PhoneClock {
    /// The phone's name in what reads it.
    fn device(&self) -> &str;
    /// Tells whether it is read through a network, and not by a cable.
    fn is_by_network(&self) -> bool;
    /// The readings since the last call. Their times are on the link's clock.
    fn exchanges(&mut self) -> Vec<PhoneExchange>;
}

/// Starts what reads the phone's clock.
pub trait PhoneClockStarter {
    /// Tells whether there is anything that could read it.
    fn is_possible(&self) -> bool;

    /// Starts it.
    ///
    /// # Errors
    ///
    /// It cannot be read.
    fn start(&mut self) -> Result<Box<dyn PhoneClock>, PhoneError>;
}

/// The program that records the depth camera.
pub trait DepthRecorder {
    /// Starts what the profile names; false if it names nothing.
    ///
    /// # Errors
    ///
    /// There is no such program, or it may not be run.
    fn start(&mut self, depth: &Depth, folder: &Path) -> Result<bool, RecorderError>;

    /// How it ended, once it has; `None` while it runs.
    fn poll(&mut self) -> Option<RecorderEnd>;

    /// Asks it to stop.
    fn ask_to_stop(&mut self);

    /// Ends it at once.
    fn kill(&mut self);
}

/// The depth recorder cannot be started.
#[derive(Debug, thiserror::Error)]
#[error("cannot start the depth recorder `{program}`: {source}")]
pub struct RecorderError {
    /// The command's first word.
    pub program: String,
    /// The system's reason.
    pub source: std::io::Error,
}

/// The end of a depth recorder.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RecorderEnd {
    /// Its program.
    pub program: String,
    /// How it ended, as the system says it.
    pub status: String,
    /// True if a program ends like this that was asked to stop.
    pub is_as_asked: bool,
}

/// The session's clocks and pauses.
pub trait Clock {
    /// Time since any fixed moment, as [`Link::now`].
    fn now(&self) -> Duration;
    /// The date and time of day.
    fn wall_clock(&self) -> Zoned;
    /// The time of day as the recording's files take it, on any thread.
    fn time_of_day(&self) -> WallClock {
        Box::new(SystemTime::now)
    }
    /// Lets this time pass.
    fn wait(&self, time: Duration);
}

/// The clocks of this computer.
#[derive(Clone, Copy, Debug, Default)]
pub struct SystemClock;

impl Clock for SystemClock {
    fn now(&self) -> Duration {
        board::transport::serial::program_time()
    }

    fn wall_clock(&self) -> Zoned {
        Zoned::now()
    }

    fn wait(&self, time: Duration) {
        std::thread::sleep(time);
    }
}

/// An answer to a prompt.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
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

/// A wish of the person while it records.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Wish {
    /// A mark now, with a label or a numbered one.
    Mark(Option<String>),
    /// The end of the recording.
    Stop,
}

/// The person at the rig. No method waits.
pub trait Operator {
    /// Tells whether somebody is there to be asked. Where nobody is, each prompt is answered with
    /// [`Choice::Continue`], and [`Self::answer`] is not called.
    fn is_present(&self) -> bool;

    /// Forgets what was typed before a prompt.
    fn forget_typed(&mut self);

    /// The answer to a prompt, once there is one.
    fn answer(&mut self) -> Option<Choice>;

    /// A wish while it records, if there is one.
    fn wish(&mut self) -> Option<Wish>;

    /// Tells whether the session is to end: Ctrl-C, or a termination signal.
    fn interrupted(&self) -> bool;
}

/// No depth recorder: the camera is recorded by hand, or not at all.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoRecorder;

impl DepthRecorder for NoRecorder {
    fn start(&mut self, _: &Depth, _: &Path) -> Result<bool, RecorderError> {
        Ok(false)
    }

    fn poll(&mut self) -> Option<RecorderEnd> {
        None
    }

    fn ask_to_stop(&mut self) {}

    fn kill(&mut self) {}
}
