//! imu
