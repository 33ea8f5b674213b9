//! The simulated rig: an STM32F407 that runs the firmware's ELF, and what is wired to it.
//!
//! What another part of the rig needs to be attached to the board is
//! [`model::RigModel`] (pins) and [`i2c::I2cTarget`] (the I2C bus), both on
//! the board's virtual time, [`time::SimTime`].

mod backtrace;
pub mod board_link;
pub mod board_truth;
mod chip;
pub mod clock;
pub mod cpu;
pub mod demo;
pub mod depth_camera;
pub mod faults;
pub mod firmware;
pub mod flash_log;
pub mod frame_phase;
pub mod i2c;
pub mod i2c_bus;
pub mod inertial_channel;
pub mod k4a_mkv;
pub mod lidar;
pub mod long_run;
pub mod model;
pub mod motion;
pub mod mpu9150;
pub mod oscillator;
pub mod owner_profile;
pub mod phone;
pub mod pin;
pub mod pin_log;
pub mod pty;
pub mod random;
pub mod rig;
pub mod rig_config;
pub mod rolling_shutter;
pub mod rtt;
pub mod running_rig;
pub mod time;
pub mod true_clock;
pub mod truth;
pub mod truth_recorder;
pub mod usb;
pub mod vcd_trace;
pub mod video_writer;
pub mod whole_chain;

#[cfg(test)]
mod test_bench;
