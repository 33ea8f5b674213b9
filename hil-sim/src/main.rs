//! `hil-sim`: runs the firmware's ELF on a simulated board.
fn main() {}
