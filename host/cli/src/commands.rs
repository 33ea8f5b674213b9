//! The subcommands of `smartdepthsync`, one a file.

pub(crate) mod board;
mod calibration;
pub(crate) mod completions;
pub(crate) mod doctor;
pub(crate) mod evaluate;
pub(crate) mod extract;
pub(crate) mod man;
pub(crate) mod monitor;
pub(crate) mod phone;
pub(crate) mod profile;
pub(crate) mod record;
pub(crate) mod setup;
pub(crate) mod verify;
