//! A session, from the twist to an aligned recording, and the mathematics that it needs.
//!
//! The session knows no command line and no terminal. Its devices are traits
//! ([`devices`]): on hardware a serial port, threads and processes; in a simulation models
//! on virtual time, in one thread. What it does is visible as a [`Phase`](event::Phase) and
//! as [`SessionEvent`](event::SessionEvent)s; what fails is a typed
//! [`SessionError`](error::SessionError). Sentences for people, and exit codes, are made by
//! the program.
//!
//! - [`options`], [`devices`]: what a session is asked for, and with what.
//! - [`event`], [`error`], [`checks`], [`watch`](mod@watch): what it does and finds.
//! - [`train`]: the frames' period in the phone's clock, from their timestamps.
//! - [`learn`]: what a recording teaches about the phone, put into the rig profile.
//! - [`rates`]: how the rate of its clock goes on, at one supposed warming.
//! - [`twists`]: what the twists before a recording say of it together.
//! - [`alignment`]: where the trigger must be sent so that both cameras expose at the
//!   same instant.
//! - [`steering`]: how the trigger's period follows the phone's clock while it is tracked.
#![forbid(unsafe_code)]

pub mod alignment;
pub mod checks;
pub mod devices;
pub mod error;
pub mod event;
pub mod learn;
pub mod options;
pub mod rates;
pub mod steering;
pub mod train;
pub mod twists;
pub mod watch;
