//! The program `smartdepthsync`, as a library that tests can drive in their own process.
//!
//! - [`cli`], `commands`: the command line, one subcommand a file.
//! - [`context`], `options`: what every command is given, and options of several.
//! - [`outcome`]: exit codes; `advice`: what to do about the libraries' errors.
//! - `view`: a session or a board for the person who waits; `operator`: that person.
//! - `terminal`: what is printed does nothing to a terminal but to be read.
//! - `log`: where log lines go.
//! - `checks`: the checks of this computer and of the profile; checks in words.
//! - `rig_profile`, `recordings`: which profile and which recording a command is about.
//! - `decimal`: numbers of the command line as exact times.
//! - `fields`: the object of `--json` for people.
#![forbid(unsafe_code)]

mod advice;
mod checks;
pub mod cli;
mod commands;
pub mod context;
mod decimal;
mod fields;
mod log;
mod new_profile;
mod operator;
mod options;
pub mod outcome;
mod recordings;
mod rig_profile;
mod terminal;
mod view;
