//! The devices of a session, as traits: on hardware they are ports, threads and processes,
//! in a simulation models that run on virtual time in the caller's thread.
//!
//! A session sleeps and reads clocks only through these. It waits for the board by
//! [`Link::receive`](board::transport::Link::receive), whose clock times all deadlines, and for
//! anything else by [`Clock::wait`].

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
    /// Opens a link to the board; to the one with the given ID, if there is one.
    ///
    /// # Errors
    ///
    /// The link cannot be opened now.
    fn connect(&mut self, board_id: Option<&str>) -> board::Result<Box<dyn Link>>;
}

/// Reads the phone's clock many times a second while the session runs.
pub trait PhoneClock {
    /// Returns the phone's name in the program that reads its clock.
    fn device(&self) -> &str;
    /// Returns true if the clock is read through a network, and not by a cable.
    fn is_by_network(&self) -> bool;
    /// Returns the readings since the last call. Their times are on the link's clock.
    fn exchanges(&mut self) -> Vec<PhoneExchange>;
}

/// Starts the reading of the phone's clock.
pub trait PhoneClockStarter {
    /// Returns true if there is a program that could read the clock.
    fn is_possible(&self) -> bool;

    /// Starts to read the clock.
    ///
    /// # Errors
    ///
    /// The clock cannot be read.
    fn start(&mut self) -> Result<Box<dyn PhoneClock>, PhoneError>;
}

/// The program that records the depth camera.
pub trait DepthRecorder {
    /// Starts the program that the profile names. Returns false if it names none.
    ///
    /// # Errors
    ///
    /// The program does not exist, or may not be run.
    fn start(&mut self, depth: &Depth, folder: &Path) -> Result<bool, RecorderError>;

    /// Returns the end of the program; `None` while it runs.
    fn poll(&mut self) -> Option<RecorderEnd>;

    /// Asks the program to stop.
    fn ask_to_stop(&mut self);

    /// Kills the program.
    fn kill(&mut self);
}

/// The error of a depth recorder that cannot be started.
#[derive(Debug, thiserror::Error)]
#[error("cannot start the depth recorder `{program}`: {source}")]
pub struct RecorderError {
    /// First word of its command.
    pub program: String,
    /// The error of the system.
    pub source: std::io::Error,
}

/// The end of a depth recorder.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RecorderEnd {
    /// First word of its command.
    pub program: String,
    /// Its exit status, in the words of the system.
    pub status: String,
    /// True if this is how a program ends that was asked to stop.
    pub is_as_asked: bool,
}

/// The session's clocks and pauses.
pub trait Clock {
    /// Returns the time since a fixed moment, as [`Link::now`] does.
    fn now(&self) -> Duration;
    /// Returns date and time of day.
    fn wall_clock(&self) -> Zoned;
    /// Returns a clock that gives the recording's files the time of day, on any thread.
    fn time_of_day(&self) -> WallClock {
        Box::new(SystemTime::now)
    }
    /// Sleeps for this time.
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
    /// Repeat the last step.
    Repeat,
    /// Skip the step.
    Skip,
    /// Stop cleanly.
    Quit,
}

/// A request of the operator during the recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Wish {
    /// Set a mark now, with this label or a numbered one.
    Mark(Option<String>),
    /// End the recording.
    Stop,
}

/// The person at the rig. No method blocks.
pub trait Operator {
    /// Returns true if somebody is present who can be asked. Otherwise each prompt is answered
    /// with [`Choice::Continue`], and [`Self::answer`] is not called.
    fn is_present(&self) -> bool;

    /// Discards keys that were typed before a prompt.
    fn forget_typed(&mut self);

    /// Returns the answer to a prompt, once there is one.
    fn answer(&mut self) -> Option<Choice>;

    /// Returns a request during the recording, if there is one.
    fn wish(&mut self) -> Option<Wish>;

    /// Returns true if Ctrl-C or a termination signal asked the session to end, since the last one
    /// that was heeded.
    fn interrupted(&self) -> bool;

    /// Takes note of an interrupt that has ended a recording. Returns true if there is time for what
    /// comes after it, until the next interrupt: after Ctrl-C, but not before the computer goes down.
    fn heed_interrupt(&mut self) -> bool {
        false
    }
}

/// No depth recorder: the camera is recorded by other means, or not at all.
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
