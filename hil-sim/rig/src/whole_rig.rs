//! The rig as a whole: its parts and their settings, its two ways to run, and the ground
//! truth of a run.

pub mod config;
mod ground_truth;
mod owner_profile;
pub mod pty;
pub mod running_rig;
pub mod virtual_rig;
