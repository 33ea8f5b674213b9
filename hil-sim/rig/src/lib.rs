//! The rig around the simulated board: IMU, cameras, phone, lidar, their clocks,
//! the motion that they share, and the ground truth about all of it.
//!
//! The board is [`wiring::board`], a [`stm32f4_sim::sim::Sim`] with the product's wiring;
//! a part of the rig that is wired to it is a [`stm32f4_sim::model::PinModel`] or an
//! [`stm32f4_sim::i2c::I2cTarget`].

pub mod clocks;
pub mod depth_camera;
pub mod imu;
mod interrupt;
pub mod led;
pub mod lidar;
pub mod model_ranges;
pub mod motion;
pub mod phone;
pub mod picture;
pub mod random;
pub mod serve;
pub mod whole_rig;
pub mod wiring;
