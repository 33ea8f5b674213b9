//! The phone's frames against the trigger's grid.
//!
//! - [`train`]: frames as a regular train in the phone's clock.
//! - [`learn`]: what a whole recording teaches about that train and the clocks.
//! - [`alignment`]: where the trigger must be sent so that both cameras expose at the
//!   same instant.
#![forbid(unsafe_code)]

pub mod alignment;
pub mod learn;
pub mod train;
