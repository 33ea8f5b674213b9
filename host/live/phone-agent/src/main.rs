//! The program on the phone: `smartdepthsync-phone-agent NAME SECONDS` returns the readings of the
//! phone's clocks on the abstract Unix socket NAME, one connection at a time.
//!
//! It removes the file from which it was started, opens nothing to the network, and exits by
//! itself after SECONDS without a question. So nothing is left on the phone, however the host
//! ends. It makes its system calls itself and needs no library: one file runs on any Android with
//! its instruction set.

#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod agent;
#[cfg(target_os = "none")]
mod start;
#[cfg(target_os = "none")]
mod syscalls;

/// Refuses to run on a computer.
#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("This program runs on a phone: `cargo xtask build` makes it.");
    std::process::exit(2);
}
