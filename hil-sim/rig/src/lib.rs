//! The rig around the simulated board: IMU, cameras, phone, lidar, their clocks,
//! the motion that they share, and the ground truth about all of it.
//!
//! The board is [`wiring::board`], a [`stm32f4_sim::sim::Sim`] with the product's wiring;
//! a part of the rig that is wired to it is a [`stm32f4_sim::model::PinModel`] or an
//! [`stm32f4_sim::i2c::I2cTarget`].

pub mod ball;
pub mod depth_camera;
pub mod depth_link;
pub mod flash_log;
pub mod imu;
pub mod inertial_channel;
mod interrupt;
pub mod jumpers;
pub mod k4a_mkv;
pub mod lidar;
pub mod link_delay;
pub mod model_ranges;
pub mod motion;
pub mod oscillator;
mod owner_profile;
pub mod phone;
pub mod pin_log;
pub mod pty;
pub mod random;
pub mod rig_config;
pub mod rolling_shutter;
mod run_truth;
pub mod running_rig;
pub mod serve;
pub mod table;
pub mod true_clock;
pub mod video_writer;
pub mod virtual_rig;
pub mod wiring;
