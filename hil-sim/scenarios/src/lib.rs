//! Sessions on the simulated rig, judged by the truth: the demo, the fault campaign,
//! the hostile campaign, boards and phones that lie, the long run and the whole chain.
//! Test code, not a part of the simulator.

pub mod beliefs;
pub(crate) mod board_truth;
pub mod demo;
pub mod faults;
pub(crate) mod frame_phase;
pub mod hostile;
pub mod lies;
pub mod long_run;
pub mod phone_faults;
pub mod programs;
pub mod session;
pub mod tracking;
pub mod whole_chain;
mod workers;
