//! The phone's frames against the trigger's grid.
//!
//! - [`train`]: the frames' period in the phone's clock, from their timestamps.
//! - [`learn`]: what a recording teaches about the phone, put into the rig profile.
//! - [`rates`]: how the rate of its clock goes on, at one supposed warming.
//! - [`twists`]: what the twists before a recording say of it together.
//! - [`alignment`]: where the trigger must be sent so that both cameras expose at the
//!   same instant.
//! - [`steering`]: how the trigger's period follows the phone's clock while it is tracked.
#![forbid(unsafe_code)]

pub mod alignment;
pub mod learn;
pub mod rates;
pub mod steering;
pub mod train;
pub mod twists;
