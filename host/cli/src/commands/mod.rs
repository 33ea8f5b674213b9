//! The subcommands of `smartdepthsync`, one a file.

pub(crate) mod board;
pub(crate) mod bring_up;
pub(crate) mod completions;
pub(crate) mod doctor;
pub(crate) mod evaluate;
pub(crate) mod extract;
pub(crate) mod gnss;
pub(crate) mod imu;
pub(crate) mod info;
pub(crate) mod man;
pub(crate) mod monitor;
pub(crate) mod phone;
pub(crate) mod ports;
pub(crate) mod profile;
pub(crate) mod record;
pub(crate) mod repair;
pub(crate) mod report;
pub(crate) mod setup;
pub(crate) mod trigger;
pub(crate) mod verify;
