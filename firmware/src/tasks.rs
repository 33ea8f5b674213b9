//! The tasks. All run in thread mode on one executor; none may block.

pub(crate) mod commands;
pub(crate) mod gnss;
pub(crate) mod imu;
pub(crate) mod receive;
pub(crate) mod self_test;
pub(crate) mod status;
pub(crate) mod transmit;
pub(crate) mod unmute;
pub(crate) mod usb;
