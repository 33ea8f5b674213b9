//! A foreign program for the tests of the simulator, on embassy-stm32: 84 MHz from the
//! internal oscillator, a blinking pin, a PWM, a UART and a button.

#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod program;

/// There is no chip here.
#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("This program runs on the chip: `cargo xtask test` builds it.");
    std::process::exit(2);
}
