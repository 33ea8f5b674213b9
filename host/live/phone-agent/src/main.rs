//! The program on the phone: `smartdepthsync-phone-agent NAME SECONDS` answers on the abstract
//! Unix socket NAME what the phone's clocks read, one connection at a time.
//!
//! It is started from a file that it removes at once, opens nothing to the network, and ends
//! by itself once its host has asked nothing for SECONDS. So nothing is
//! left on the phone, whatever ends the host. It makes system calls itself and needs no
//! library: one file runs on any Android of its processor.

#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod agent;
#[cfg(target_os = "none")]
mod system;

/// There is no phone here.
#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("This program runs on a phone: `cargo xtask build` makes it.");
    std::process::exit(2);
}
