//! The firmware binary: starts the board and spawns the tasks.
//!
//! Everything that can be tested without a board lives in the library. The modules
//! form layers, each on those before it: `state` (what all share), `hardware` (the
//! drivers), `tasks`, and `start`, which wires them.

#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod hardware;
#[cfg(target_os = "none")]
mod start;
#[cfg(target_os = "none")]
mod state;
#[cfg(target_os = "none")]
mod tasks;

/// There is no board here.
#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("This program runs on the board: build it in the folder `firmware`.");
    std::process::exit(2);
}
