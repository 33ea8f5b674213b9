//! Sessions on the simulated rig, judged by the ground truth: the demo, the fault
//! campaign and the whole chain. Test code, not a part of the simulator.

pub(crate) mod board_truth;
pub mod calibration;
pub mod campaign;
pub mod demo;
pub(crate) mod frame_phase;
pub mod judge;
pub mod programs;
pub mod study;
pub mod virtual_session;
pub mod whole_chain;
mod workers;
