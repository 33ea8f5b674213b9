//! Clocks of the rig's parts, and the delays of asking one for its time.

pub mod link_delay;
pub mod oscillator;
pub mod true_clock;
