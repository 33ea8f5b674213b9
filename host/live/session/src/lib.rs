//! A session, from the twist to an aligned recording.
//!
//! The session knows no command line and no terminal. Its devices are traits
//! ([`devices`]): on hardware a serial port, threads and processes; in a simulation models
//! on virtual time, in one thread. What it does is visible as a [`Phase`](event::Phase) and
//! as [`SessionEvent`](event::SessionEvent)s; what fails is a typed
//! [`SessionError`](error::SessionError). Exit codes and advice are the program's.
//!
//! Its steps, each of which can be repeated or left out: connect ([`connect`]), the
//! [`checks`], [`twist`], start the trigger and the phones' videos, align, confirm the
//! arrival, record ([`steps`]), stop, second twist, fetch the videos
//! ([`close`](mod@close)). From the connect on, all that the board sends is recorded, so the
//! twist is in the file too. However a session ends, it is closed in the same way: the
//! videos are stopped, the depth recorder is asked to stop, the trigger is stopped, the
//! files are finished.
//!
//! A lost link is waited for, and the session goes on with it. A board that was reset ends
//! the recording: its clock is another one.
//!
//! - [`run`](mod@run), [`session`], [`options`], [`devices`]: a session, what it is asked for, and with what.
//! - [`event`], [`error`], [`log`]: what happens, and where it is kept.
//! - [`link`], [`monitors`], [`watch`](mod@watch): the board and its messages.
//! - [`phones`], `videos`, `tracking`: the phones, their videos, the reference's clock.
//! - `auxiliary`, `housekeeping`: auxiliary outputs; disk and depth recorder.
//! - [`hardware`], [`recorder_process`]: devices on hardware.
//! - [`alignment`], [`learn`]: what the mathematics of [`clock`] takes from the profile, and what
//!   a recording adds to it.
#![forbid(unsafe_code)]

pub mod alignment;
mod auxiliary;
pub mod checks;
pub mod close;
pub mod connect;
pub mod devices;
pub mod error;
pub mod event;
pub mod hardware;
pub mod housekeeping;
pub mod learn;
pub mod link;
pub mod log;
pub mod monitors;
pub mod options;
pub mod phones;
pub mod recorder_process;
pub mod run;
pub mod session;
pub mod steps;
mod tracking;
pub mod twist;
mod videos;
pub mod watch;
