//! A session, from the twist to an aligned recording.
//!
//! The session knows no command line and no terminal. Its devices are traits
//! ([`devices`]): on hardware a serial port, threads and processes; in a simulation models
//! on virtual time, in one thread. Everything it does is visible as a [`Phase`](event::Phase)
//! and as [`SessionEvent`](event::SessionEvent)s; a failure is a typed
//! [`SessionError`](error::SessionError). Exit codes and advice belong to the program.
//!
//! Its [`steps`], each of which can be repeated or skipped: connect, the [`checks`],
//! [`twist`], start the trigger and the phones' videos, align, confirm the arrival, record,
//! stop, second twist, fetch the videos. Everything that the board sends after the connect
//! is recorded, including the twist. Every session is closed in the same way, even one that
//! failed: the videos are stopped, the depth recorder is asked to stop, the trigger is
//! stopped, the files are finished.
//!
//! A session waits for a lost link and continues when it returns. A reset of the board ends
//! the recording, because it restarts the board's clock.
//!
//! - [`run`](mod@run), [`session`], [`options`]: a session, its live parts, and its settings.
//! - [`steps`]: connect, record, close.
//! - [`event`], [`error`], [`log`]: what happens, and where it is kept.
//! - [`link`]: the board and its messages.
//! - [`phones`], `tracking`: the phones, their videos, the reference phone's clock.
//! - [`devices`]: the traits, and the devices on hardware.
//! - `auxiliary`, `housekeeping`: auxiliary outputs; disk and depth recorder.
//! - [`alignment`], [`learn`]: what the mathematics of [`clock`] takes from the profile, and what
//!   a recording adds to it.
#![forbid(unsafe_code)]

pub mod alignment;
mod auxiliary;
pub mod checks;
pub mod devices;
pub mod error;
pub mod event;
pub mod housekeeping;
pub mod learn;
pub mod link;
pub mod log;
pub mod options;
pub mod phones;
pub mod run;
pub mod session;
pub mod steps;
mod tracking;
pub mod twist;
