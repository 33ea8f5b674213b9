//! The firmware binary: starts the board and spawns the tasks.
//!
//! Everything that can be tested without a board lives in the library. The modules
//! form layers, each on those before it: `state` (what all share), `hardware` (the
//! drivers), `tasks`, and `start`, which wires them.
//!
//! Built for a computer, the program flashes a board instead (`flash`).

#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod hardware;
#[cfg(target_os = "none")]
mod start;
#[cfg(target_os = "none")]
mod state;
#[cfg(target_os = "none")]
mod tasks;

#[cfg(not(target_os = "none"))]
mod flash;

#[cfg(not(target_os = "none"))]
fn main() -> std::process::ExitCode {
    flash::main()
}
