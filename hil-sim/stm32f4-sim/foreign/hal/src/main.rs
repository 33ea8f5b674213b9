//! A foreign program for the tests of the simulator, on stm32f4xx-hal: 168 MHz from a
//! crystal of 25 MHz, a timer that blinks, and a USB serial port that answers.

#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod program;

/// There is no chip here.
#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("This program runs on the chip: `cargo xtask test` builds it.");
    std::process::exit(2);
}
