//! The program `smartdepthsync`, as a library that tests can drive in their own process.
//!
//! - [`cli`], `commands`: the command line, one subcommand a file.
//! - [`context`], `options`: what every command is given, and options of several.
//! - [`outcome`]: exit codes; `advice`: what to do about the libraries' errors.
//! - [`record`]: a session from the twist to the aligned recording.
//! - `view`, `tracked`: what the operator sees while a session runs.
//! - `terminal`: what is printed does nothing to a terminal but to be read.
//! - `log`: where log lines go.
//! - `arrival`: of a train on its grid, which a session and `trigger` wait for.
//! - `checks`: the checks of a rig and the verdict over a recording, in words.
//! - `rig_profile`, `recordings`: which profile and which recording a command is about.
//! - `decimal`: numbers of the command line as exact times.
//! - `fields`: the object of `--json` for people.
#![forbid(unsafe_code)]

mod advice;
mod arrival;
mod checks;
pub mod cli;
mod commands;
pub mod context;
mod decimal;
mod fields;
mod log;
mod new_profile;
mod options;
pub mod outcome;
pub mod record;
mod recordings;
pub mod rig_profile;
mod terminal;
mod tracked;
mod view;
