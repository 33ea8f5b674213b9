//! The tests of the program and of the libraries as it uses them, in one binary:
//! `cargo test -p smartdepthsync --test it verify_command` runs one module.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod board_flash;
mod connect;
mod documented_commands;
mod evaluate_command;
mod extract_command;
mod fuzz_smoke;
mod hostile_costs;
mod hostile_files;
mod killed;
mod phone_command;
mod report_browser;
mod sentences;
#[path = "../support/mod.rs"]
mod support;
mod trigger_imu;
mod verify_command;
mod verify_mutations;
