//! The rig with the firmware of the product, and its models alone.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod black_pill;
mod board;
mod board_host;
mod depth_camera;
mod gnss;
mod imu;
mod imu_bench;
mod linux_kernel;
mod model_ranges_page;
mod outputs;
mod phone_bench;
mod phone_rude;
mod trigger;
mod trigger_rig;
mod voltages;
